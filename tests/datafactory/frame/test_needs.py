"""What a frame calls for: the quick decision against all sums, and what it must never leave out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from path_tables import a_table

from datafactory.effects.catalogue import ALL, NAMES, PATH_EFFECTS, EffectSet
from datafactory.frame import changes
from datafactory.frame.chain import ChainSettings
from datafactory.frame.needs import FRAME_EFFECTS, cells_of, curved_share, effects_called_for
from datafactory.paths.density import cell_power
from datafactory.paths.table import PathTable, ScatteredPaths
from shared.physics.units import db_to_power
from shared.radar import Radar
from shared.signal.windows import cell_noise_power

RADAR = Radar()
WINDOW = "taylor-30"


def a_street(generator: np.random.Generator, speed_mps: float, nearest_m: float) -> PathTable:
    """Two thousand echoes from near to 80 m, as strong as distance makes them, and a dozen with mirrors."""
    count = 2000
    range_m = generator.uniform(nearest_m, 80.0, count)
    u = generator.uniform(-0.8, 0.8, count)
    point = range_m[:, None] * np.stack([np.sqrt(1.0 - u**2), u, np.zeros(count)], axis=1)
    amplitude = 1e-3 * range_m**-2 * generator.normal(size=count)
    scattered = ScatteredPaths.of_points(point, np.tile([-speed_mps, 0.0, 0.0], (count, 1)), amplitude)
    mirrors = a_table(generator).specular
    strength = 1e-4 * generator.uniform(size=len(mirrors)) / mirrors.range_m() ** 2
    still = np.zeros((len(mirrors), 3)) if speed_mps == 0.0 else mirrors.image_velocity
    return PathTable(scattered, replace(mirrors, amplitude=strength.astype(complex), image_velocity=still))


def called_for_by_all_sums(paths: PathTable, budget_db: float) -> set[str]:
    """The rule spelt out: every path's exact change, summed in every cell."""
    waveform = RADAR.waveform
    rates = changes.range_rates_mps(paths, waveform)
    change = {
        "doppler": changes.doppler_change(rates, waveform),
        "range_migration": changes.migration_change(rates, waveform),
        "intra_chirp_motion": changes.intra_chirp_change(rates, waveform),
        "near_field": changes.plane_wave_change(paths, RADAR.array, waveform.wavelength_m),
        "antenna_pattern": changes.pattern_change(paths, RADAR),
    }
    total, noise = cell_power(paths, RADAR, WINDOW), cell_noise_power(RADAR)
    occupied = total > noise / 48
    found = {"noise"} if np.any(total.max(axis=1) < 1000.0 * noise) else set()
    for name, amplitude in change.items():
        changed = cell_power(paths, RADAR, WINDOW, amplitude**2)
        share = np.mean(changed[occupied] > 0.12 * total[occupied])
        if changed.max() > 10.0 ** (budget_db / 10.0) * total.max() or share > 0.1:
            found.add(name)
    return found if "doppler" in found else found - {"range_migration", "intra_chirp_motion"}


@pytest.mark.parametrize("budget_db", [-10.0, -30.0, -50.0])
@pytest.mark.parametrize("nearest_m", [0.7, 5.0, 40.0])
@pytest.mark.parametrize("speed_mps", [0.0, 0.01, 0.1, 1.0, 10.0])
def test_the_quick_decision_is_that_of_all_sums(speed_mps: float, nearest_m: float, budget_db: float) -> None:
    paths = a_street(np.random.default_rng([int(100 * speed_mps), int(nearest_m)]), speed_mps, nearest_m)
    assert effects_called_for(paths, RADAR, WINDOW, budget_db) == called_for_by_all_sums(paths, budget_db)


@pytest.mark.parametrize("nearest_m", [0.7, 5.0, 40.0])
def test_the_share_that_curves_is_that_of_all_exact_phases(nearest_m: float) -> None:
    paths = a_street(np.random.default_rng(5), 0.0, nearest_m)
    cells = cells_of(paths, RADAR, WINDOW)
    exact = changes.plane_wave_change(paths, RADAR.array, RADAR.waveform.wavelength_m) ** 2
    share = curved_share(paths, cells, RADAR)
    assert (share >= exact * (1.0 - 1e-12)).all()
    power = cells.where.power
    assert power @ share == pytest.approx(power @ exact, rel=1e-3)


def test_the_cases_above_decide_both_ways() -> None:
    """Otherwise the comparison says nothing."""
    far = PathTable(a_street(np.random.default_rng(3), 0.0, 40.0).scattered)
    assert called_for_by_all_sums(far, -10.0) <= {"antenna_pattern", "noise"}
    near = a_street(np.random.default_rng(3), 10.0, 0.7)
    assert called_for_by_all_sums(near, -50.0) == set(FRAME_EFFECTS)


@pytest.mark.parametrize("budget_db", [-1.0, -30.0, -120.0])
def test_a_standing_frame_is_standing_whatever_the_budget(budget_db: float, generator) -> None:
    paths = a_street(generator, 0.0, 2.0)
    motion = {"doppler", "range_migration", "intra_chirp_motion"}
    assert not effects_called_for(paths, RADAR, WINDOW, budget_db) & motion


def test_one_moving_echo_among_many_calls_for_doppler_by_its_power(generator) -> None:
    """20 dB under the strongest cell it counts, 40 dB under it does not, at a budget of -30 dB."""
    street = a_street(generator, 0.0, 30.0).scattered
    peak = float(np.sqrt(cell_power(PathTable(street), RADAR, WINDOW).max()))
    for level_db, expected in ((-20.0, True), (-40.0, False)):
        amplitude = np.array([peak * np.sqrt(float(db_to_power(level_db)))])
        echo = ScatteredPaths.of_points(np.array([[50.0, 0.0, 0.0]]), np.array([[-5.0, 0.0, 0.0]]), amplitude)
        paths = PathTable(ScatteredPaths.concatenate([street, echo]))
        assert ("doppler" in effects_called_for(paths, RADAR, WINDOW, -30.0)) == expected


def test_an_empty_frame_holds_noise_alone() -> None:
    nothing = PathTable(ScatteredPaths.of_points(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0)))
    assert effects_called_for(nothing, RADAR, WINDOW, -30.0) == {"noise"}


def test_every_effect_is_decided_in_one_place() -> None:
    assert sorted((*PATH_EFFECTS, *FRAME_EFFECTS)) == sorted(NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_settings_say_which_effects_they_have(name: str) -> None:
    """The way back from :meth:`EffectSet.settings`."""
    for effects in (ALL, ALL.without(name), EffectSet.of({name})):
        settings = effects.settings(ChainSettings())
        on = {each for each, value in (settings.path_effects() | settings.frame_effects()).items() if value}
        assert on == {*effects.names, "range_migration", "intra_chirp_motion", "near_field"}
