"""The planner proven right on ``scenes/effects``: what it switches on was needed, and what it leaves out was not.

For each scene the plan is the set written down beforehand. Then every effect is toggled in that set, and the result is
simulated again: it changes by more than the error budget where the effect was on, and by less where it was off. What
"changes" means is said in ``expected.json`` (``rules``); the budget bounds the power in a resolution
cell averaged over realisations for added paths, and the response over its peak for how echoes are formed.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from oracles import cube_with_frozen_ranges, cube_with_plane_waves
from prepared_scenes import EFFECT_SCENES as EFFECTS
from prepared_scenes import prepared_scene

from datafactory.effects.catalogue import PATH_EFFECTS, EffectSet
from datafactory.effects.plan import OCCUPIED_SHARE, EffectPlan
from datafactory.frame.chain import ChainSettings, SceneSource, illuminated
from datafactory.frame.deal import Deal
from datafactory.frame.defaults import DEFAULT_BUDGET_DB
from datafactory.frame.measurement import FrameIdentity, Measurement, Processing, measure
from datafactory.frame.prepared import PreparedScene
from datafactory.paths.density import cell_power
from datafactory.paths.solver import TraceSettings
from datafactory.paths.table import DIFFUSE, PathTable, ScatteredPaths
from datafactory.run.order import Order
from datafactory.run.preparation import prepare
from datafactory.scenes.materials.table import load_materials
from datafactory.scenes.poses import Pose, read_poses
from shared.physics.units import amplitude_to_db, power_to_db
from shared.radar import Radar
from shared.radar.arrays import AntennaArray
from shared.signal.imaging import delay_and_sum
from shared.signal.spectrum import range_doppler
from shared.signal.windows import cell_noise_power

pytestmark = pytest.mark.usefixtures("own_cache", "one_thread")

EXPECTED = json.loads((Path(__file__).parent / "expected.json").read_text(encoding="utf-8"))["scenes"]

RAYS = 100_000
FANS = 4
"""Ray fans over which diffuse power is averaged: with one, a cell at 80 m holds one or two rays."""
NOTHING_DB = -300.0
WINDOW = "taylor-30"
"""Of the truth, by default."""

Real = NDArray[np.float64]
Complex = NDArray[np.complex64]


@dataclass(frozen=True, eq=False)
class Case:
    """One scene at its first pose."""

    scene: PreparedScene
    pose: Pose
    planned: EffectSet

    def toggled(self, name: str) -> EffectSet:
        return self.planned.without(name) if getattr(self.planned, name) else self.planned.with_also(name)

    def paths(self, effects: EffectSet, realisation: int = 0) -> PathTable:
        """Illuminated paths with these effects; the same rays for the same ``realisation``."""
        settings = effects.settings(ChainSettings(trace=TraceSettings(rays=RAYS)))
        frame = Deal(scenes=1, poses=(self.pose,)).frame(0).with_rays(realisation)
        return illuminated(SceneSource(frame, self.scene, settings).traced(Radar()), settings, Radar())


def first_pose(name: str) -> Pose:
    return read_poses(EFFECTS / f"{name}.poses.json")[0]


@lru_cache(maxsize=1)
def case(name: str) -> Case:
    planned = EffectSet.of(set(EXPECTED[name]["effects"]))
    return Case(prepared_scene(EFFECTS / f"{name}.usda"), first_pose(name), planned)


def plan_of(name: str, seed: int = 0) -> EffectPlan:
    poses = read_poses(EFFECTS / f"{name}.poses.json")
    order = Order(radar=Radar(), scenes=(str(EFFECTS / f"{name}.usda"),), poses=poses, seed=seed)
    return prepare(order, load_materials()).plans[0]


@pytest.mark.parametrize("name", EXPECTED)
def test_the_plan_is_the_set_written_down_beforehand(name: str) -> None:
    plan = plan_of(name)
    assert plan.effects.names == tuple(EXPECTED[name]["effects"])
    assert plan.budget_db == DEFAULT_BUDGET_DB


@pytest.mark.parametrize("seed", [1, 5])
def test_the_plan_does_not_hang_on_the_rays(seed: int) -> None:
    """The scene whose rough surface, at 80 m, has the fewest rays in a cell; these seeds once said otherwise."""
    assert plan_of("reflector_behind_pane", seed).effects.names == tuple(EXPECTED["reflector_behind_pane"]["effects"])


# Paths: power in a resolution cell of the truth


def largest_over_peak(difference: Real, planned: Real) -> float:
    """10 log10 of the largest power of ``difference`` over the peak of ``planned``."""
    return float(power_to_db(np.abs(difference).max() / planned.max(), NOTHING_DB))


def not_purely_diffuse(table: PathTable) -> PathTable:
    return replace(table, scattered=table.scattered.take(table.scattered.kinds != DIFFUSE))


def change_of_paths(now: Case, name: str) -> float:
    """What toggling an effect changes in the cells' power [dB of the planned peak].

    Mirrors change which rays scatter, not their mean power (:func:`test_mirrors_leave_diffuse_power_as_it_is`): where
    mirrors are toggled, purely diffuse paths are left out of the difference. Where diffuse paths are, it is averaged
    over ray fans. Else the rays and the solver's draws are the same, and what the effect does not touch cancels.
    """
    planned, difference = [], []
    for fan in range(FANS if name == "diffuse" else 1):
        tables = [now.paths(effects, fan) for effects in (now.planned, now.toggled(name))]
        planned.append(cell_power(tables[0], Radar(), WINDOW))
        if name == "specular":
            tables = [not_purely_diffuse(table) for table in tables]
        before, after = (cell_power(table, Radar(), WINDOW) for table in tables)
        difference.append(after - before)
    return largest_over_peak(np.mean(difference, axis=0), np.mean(planned, axis=0))


def occupied_cells_changed(now: Case, name: str) -> float:
    """Share of the cells above the noise whose power changes by more than half a decibel."""
    tables = [now.paths(effects) for effects in (now.planned, now.toggled(name))]
    powers = [cell_power(table, Radar(), WINDOW) for table in tables]
    if name == "specular":
        powers = [cell_power(not_purely_diffuse(table), Radar(), WINDOW) for table in tables]
    both = np.maximum(*powers)
    occupied = np.maximum(*(cell_power(table, Radar(), WINDOW) for table in tables)) > cell_noise_power(Radar()) / 48.0
    return float(np.mean(np.abs(powers[1] - powers[0])[occupied] > 0.12 * both[occupied])) if occupied.any() else 0.0


def change_by_pattern(now: Case) -> float:
    """What the gain of boresight everywhere changes: power of the paths' differences in amplitude, as above."""
    planned, other = (now.paths(effects) for effects in (now.planned, now.toggled("antenna_pattern")))
    difference = replace(
        planned,
        scattered=replace(planned.scattered, amplitude=other.scattered.amplitude - planned.scattered.amplitude),
        specular=replace(planned.specular, amplitude=other.specular.amplitude - planned.specular.amplitude),
    )
    return largest_over_peak(cell_power(difference, Radar(), WINDOW), cell_power(planned, Radar(), WINDOW))


@pytest.mark.parametrize("effect", [*PATH_EFFECTS, "antenna_pattern"])
@pytest.mark.parametrize("name", EXPECTED)
def test_an_effect_on_paths_is_on_where_its_change_exceeds_the_budget(name: str, effect: str) -> None:
    now = case(name)
    change_db = change_by_pattern(now) if effect == "antenna_pattern" else change_of_paths(now, effect)
    cells = 0.0 if effect == "antenna_pattern" else occupied_cells_changed(now, effect)
    needed = change_db > DEFAULT_BUDGET_DB or cells > OCCUPIED_SHARE
    assert getattr(now.planned, effect) == needed, f"{change_db:.1f} dB, {100.0 * cells:.1f} % of the cells"


def by_place(paths: ScatteredPaths) -> dict[tuple[float, ...], float]:
    """Power of purely diffuse single bounces by their point, in micrometres."""
    singles = paths.take((paths.kinds == DIFFUSE) & (paths.depth == 1))
    places = np.rint(singles.rx_point * 1e6)
    return {tuple(place): float(power) for place, power in zip(places, np.abs(singles.amplitude) ** 2, strict=True)}


@pytest.mark.parametrize("name", ["parked_car", "corner", "empty_field"])
def test_mirrors_leave_diffuse_power_as_it_is(name: str) -> None:
    """Every ray scatters where it arrives, with mirrors and without: the same paths, each of the same power."""
    now = case(name)
    rough = EffectSet.of({"diffuse"})
    alone, beside = (by_place(now.paths(effects).scattered) for effects in (rough, rough.with_also("specular")))
    assert beside
    assert beside.keys() == alone.keys()
    np.testing.assert_allclose([beside[place] / alone[place] for place in alone], 1.0, rtol=1e-4)


# Signals: response over its peak


@lru_cache(maxsize=1)
def few_paths(name: str) -> PathTable:
    return case(name).paths(case(name).planned)


def radar_for(paths: PathTable, array: AntennaArray = Radar().array) -> Radar:
    """The default radar, with a short frame where every chirp is the same; its truth, not looked at, of one element."""
    radar = Radar()
    waveform = radar.waveform if paths.moves() else radar.waveform.model_copy(update={"chirps": 8})
    element = AntennaArray(tx_m=((0.0, 0.0, 0.0),), rx_m=((0.0, 0.0, 0.0),))
    return radar.model_copy(update={"waveform": waveform, "array": array, "virtual_sensor": element})


def measured(paths: PathTable, effects: EffectSet, radar: Radar, **fields: Any) -> Measurement:
    """The frame that ``effects`` make of these paths; fields of its processing."""
    settings = effects.settings(ChainSettings(processing=Processing(peaks=1, store="cube")))
    processing = replace(settings.processing, **fields)
    generator = np.random.default_rng(0)
    return measure(FrameIdentity(0, "scene", "effects", 0), paths, (), radar, processing, generator)


def spectra_of(paths: PathTable, effects: EffectSet, radar: Radar, **fields: Any) -> Complex:
    """[R, chirps, C] noise-free range-Doppler spectra."""
    cube = measured(paths, effects, radar, noise=False, **fields).cube
    assert cube is not None
    return range_doppler(cube, radar)


@lru_cache(maxsize=1)
def planned_spectra(name: str) -> Complex:
    return spectra_of(few_paths(name), case(name).planned, radar_for(few_paths(name)))


def response_change(planned: Complex, other: Complex) -> float:
    """20 log10 of the largest difference over the peak, [R, ...]; a phase common to a range bin changes no image."""
    rows = (len(planned), -1)
    product = np.sum(np.conj(other.reshape(rows)) * planned.reshape(rows), axis=1)
    magnitude = np.abs(product)
    phase = np.where(magnitude > 0.0, product, 1.0) / np.where(magnitude > 0.0, magnitude, 1.0)
    difference = planned - other * phase.reshape(-1, *[1] * (planned.ndim - 1))
    return float(amplitude_to_db(np.abs(difference).max() / np.abs(planned).max(), NOTHING_DB))


def change_by_doppler(name: str) -> float:
    paths, toggled = few_paths(name), case(name).toggled("doppler")
    return response_change(planned_spectra(name), spectra_of(paths, toggled, radar_for(paths)))


def change_by_motion_within_the_chirp(name: str) -> float:
    paths = few_paths(name)
    other = spectra_of(paths, case(name).planned, radar_for(paths), intra_chirp_motion=False)
    return response_change(planned_spectra(name), other)


def change_by_migration(name: str) -> float:
    """By a sum over echoes kept at their ranges of mid-frame, in two channels 72 mm apart."""
    paths, array = few_paths(name), Radar().array
    radar = radar_for(paths, AntennaArray(tx_m=array.tx_m[:1], rx_m=array.rx_m[::12]))
    other = range_doppler(cube_with_frozen_ranges(paths, radar).astype(np.complex64), radar)
    return response_change(spectra_of(paths, case(name).planned, radar), other)


def change_by_near_field(name: str) -> float:
    """By a sum over plane waves, in the scene as it stands at mid-frame: what it changes in delay-and-sum images."""
    paths = few_paths(name).at_rest(Radar().waveform.mid_frame_s)
    radar = radar_for(paths)
    curved = spectra_of(paths, case(name).planned, radar)
    plane = range_doppler(cube_with_plane_waves(paths, radar).astype(np.complex64), radar)
    at_rest = radar.waveform.chirps // 2
    return response_change(*(delay_and_sum(spectra[:, at_rest], radar) for spectra in (curved, plane)))


CHANGES = {
    "doppler": change_by_doppler,
    "range_migration": change_by_migration,
    "intra_chirp_motion": change_by_motion_within_the_chirp,
    "near_field": change_by_near_field,
}
"""By effect of the signal, what leaving it out changes in range-Doppler spectra or images [dB of the peak]."""


@pytest.mark.parametrize("effect", CHANGES)
@pytest.mark.parametrize("name", EXPECTED)
def test_an_effect_on_signals_is_on_where_its_change_exceeds_the_budget(name: str, effect: str) -> None:
    change_db = CHANGES[effect](name)
    assert getattr(case(name).planned, effect) == (change_db > DEFAULT_BUDGET_DB), f"{change_db:.1f} dB"


@pytest.mark.parametrize("name", EXPECTED)
def test_noise_fills_the_weakest_range_bin(name: str) -> None:
    """Everywhere on: without it, the power in that bin's Doppler cell is another, by more than the budget."""
    now, paths = case(name), few_paths(name)
    noisy, clean = (measured(paths, effects, radar_for(paths)) for effects in (now.planned, now.toggled("noise")))
    assert now.planned.noise
    assert noisy.noise_power > 0.0 == clean.noise_power
    power = [np.mean(np.abs(item.range_channel[0]) ** 2, axis=1) for item in (noisy, clean)]
    weakest = int(np.argmin(power[1]))
    change_db = power_to_db(abs(power[0][weakest] - power[1][weakest]) / power[0][weakest])
    assert change_db > DEFAULT_BUDGET_DB
