"""What a frame is made with: Doppler by sums over cells, the rows that stay, the effects that they show."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from path_tables import a_table

from datafactory.effects.catalogue import ALL, NAMES, NO_CHOICE, PATH_EFFECTS, SIGNAL_EFFECTS, EffectSet
from datafactory.frame import changes
from datafactory.frame.chain import ChainSettings
from datafactory.frame.decision import Decided, doppler_called_for, path_effects
from datafactory.paths.candidates import EDGE, PANE, TWICE, Candidates
from datafactory.paths.density import cell_power
from datafactory.paths.table import DIFFRACTED, DIFFUSE, REFRACTED, PathTable, ScatteredPaths
from shared.radar import Radar

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


@pytest.mark.parametrize("below_db", [-10.0, -30.0, -50.0])
@pytest.mark.parametrize("nearest_m", [0.7, 40.0])
@pytest.mark.parametrize("speed_mps", [0.01, 0.1, 1.0, 10.0])
def test_doppler_is_called_for_by_the_sum_over_a_cell(speed_mps: float, nearest_m: float, below_db: float) -> None:
    """The rule spelt out: every path's change by its range rate, summed in every cell."""
    paths = a_street(np.random.default_rng([int(100 * speed_mps), int(nearest_m)]), speed_mps, nearest_m)
    limit = 10.0 ** (below_db / 10.0) * float(cell_power(paths, RADAR, WINDOW).max())
    share = changes.doppler_change(changes.range_rates_mps(paths, RADAR.waveform), RADAR.waveform) ** 2
    expected = bool((cell_power(paths, RADAR, WINDOW, share) > limit).any())
    assert doppler_called_for(paths, RADAR, WINDOW, limit) == expected


def test_the_cases_above_decide_both_ways() -> None:
    """Otherwise the comparison says nothing."""
    slow, fast = (a_street(np.random.default_rng(3), speed, 40.0) for speed in (0.01, 10.0))
    slow = PathTable(slow.scattered)
    limit = 0.1 * float(cell_power(slow, RADAR, WINDOW).max())
    assert not doppler_called_for(slow, RADAR, WINDOW, limit)
    assert doppler_called_for(slow, RADAR, WINDOW, 0.0)
    assert doppler_called_for(fast, RADAR, WINDOW, limit)


@pytest.mark.parametrize("limit_w", [0.0, 1e-12])
def test_a_standing_frame_is_standing_whatever_the_limit(limit_w: float, generator: np.random.Generator) -> None:
    assert not doppler_called_for(a_street(generator, 0.0, 2.0), RADAR, WINDOW, limit_w)
    one_chirp = RADAR.model_copy(update={"waveform": RADAR.waveform.model_copy(update={"chirps": 1})})
    assert not doppler_called_for(a_street(generator, 5.0, 2.0), one_chirp, WINDOW, limit_w)


def test_rows_stay_with_their_candidates_and_panes_take_with_them_what_they_let_through() -> None:
    place = np.array([[20.0, 0.0, 0.0]])
    groups = [Candidates.group(family, Candidates.of(family, place, np.ones(1))) for family in (PANE, TWICE)]
    candidates = Candidates.joined([Candidates.of(EDGE, np.tile(place, (2, 1)), np.ones(2)), *groups])
    rows = ScatteredPaths.of_points(np.tile(place, (6, 1)), np.zeros((6, 3)), np.ones(6))
    kinds = np.array([DIFFUSE, DIFFRACTED, DIFFRACTED, DIFFUSE | REFRACTED, DIFFUSE, DIFFUSE | REFRACTED], np.uint8)
    rows = replace(
        rows, kinds=kinds, candidate=np.array([-1, 0, 1, 2, 4, -1], np.int32), object_index=np.arange(6, dtype=np.int32)
    )
    table = PathTable(rows, candidates=candidates)

    def kept(*worth: bool) -> list[int]:
        return Decided(1.0, np.array(worth)).kept(table).scattered.object_index.tolist()

    assert kept(True, True, True, True, True, True) == [0, 1, 2, 3, 4, 5]
    assert kept(False, True, True, True, False, False) == [0, 2, 3, 5]
    assert kept(True, False, False, False, True, True) == [0, 1, 4]  # what passed panes goes, whoever's row it is


def test_a_frame_has_an_effect_where_a_path_of_it_is_left() -> None:
    place = np.array([[20.0, 0.0, 0.0]])
    rough = replace(ScatteredPaths.of_points(place, 0.0 * place, np.ones(1)), kinds=np.array([DIFFUSE], np.uint8))
    assert {name for name, on in path_effects(PathTable(rough)).items() if on} == {"diffuse"}
    twice = replace(rough, depth=np.array([2], np.int8))
    assert {name for name, on in path_effects(PathTable(twice)).items() if on} == {"diffuse", "multi_bounce"}
    assert not any(path_effects(PathTable(ScatteredPaths.none())).values())


def test_every_effect_is_decided_in_one_place() -> None:
    assert sorted((*PATH_EFFECTS, *SIGNAL_EFFECTS)) == sorted(NAMES)
    assert sorted(path_effects(PathTable(ScatteredPaths.none()))) == sorted(PATH_EFFECTS)


@pytest.mark.parametrize("name", SIGNAL_EFFECTS)
def test_settings_say_which_effects_of_the_signal_they_have(name: str) -> None:
    """The way back from :meth:`EffectSet.settings`; what comes with Doppler goes with it."""
    for effects in (ALL, ALL.without(name), EffectSet.of({name})):
        on = {each for each, value in effects.settings(ChainSettings()).signal_effects(RADAR).items() if value}
        expected = {"near_field", *({"doppler", *NO_CHOICE} if effects.doppler else ())}
        assert on == expected | {each for each in ("antenna_pattern", "noise") if getattr(effects, each)}
