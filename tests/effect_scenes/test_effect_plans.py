"""The frames' decisions proven right on ``scenes/effects``: what is on was needed, and what is left out was not.

Of each scene the set is written down beforehand. Then every effect is toggled in that set, and the result is simulated
again: it changes by more than the frame's limit where the effect was on, and by less where it was off. What "changes"
means is said in ``expected.json`` (``rules``): the power in a resolution cell for added paths, the response over its
peak for how echoes are formed. The latter is decided by formulas, which ``tests/datafactory/frame/test_changes.py``
holds against slow sums; here a moving and a near scene are made without range migration and without near field.
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

from datafactory.defaults import DEFAULT_BUDGET_DB
from datafactory.effects.catalogue import ALL, EffectSet
from datafactory.frame.chain import ChainSettings, SceneSource, illuminated
from datafactory.frame.deal import Deal, DealtFrame, PreparedScene
from datafactory.frame.measurement import FrameIdentity, Measurement, Processing, measure
from datafactory.paths.density import cell_power
from datafactory.paths.notice import Notice
from datafactory.paths.solver import TraceSettings
from datafactory.paths.table import DIFFUSE, SPECULAR, PathTable, ScatteredPaths
from datafactory.scenes.poses import Pose, read_poses
from shared.physics.units import amplitude_to_db, power_to_db
from shared.radar import Radar
from shared.radar.arrays import AntennaArray
from shared.signal.imaging import delay_and_sum
from shared.signal.spectrum import range_doppler

pytestmark = pytest.mark.usefixtures("one_thread")

EXPECTED = json.loads((Path(__file__).parent / "expected.json").read_text(encoding="utf-8"))["scenes"]

RAYS = 200_000
EVERYTHING = ALL.settings(ChainSettings(trace=TraceSettings(rays=RAYS)))
NOTHING_DB = -300.0
WINDOW = "taylor-30"
"""Of the truth, by default."""

Complex = NDArray[np.complex64]


@dataclass(frozen=True, eq=False)
class Case:
    """One scene at its first pose."""

    scene: PreparedScene
    pose: Pose
    planned: EffectSet

    @property
    def frame(self) -> DealtFrame:
        """At this pose."""
        return Deal(scenes=1, poses=(self.pose,)).frame(0)

    def toggled(self, name: str) -> EffectSet:
        return self.planned.without(name) if getattr(self.planned, name) else self.planned.with_also(name)

    def paths(self, effects: EffectSet, realisation: int = 0) -> PathTable:
        """Illuminated paths with these effects; the same rays for the same ``realisation``."""
        settings = effects.settings(ChainSettings(trace=TraceSettings(rays=RAYS)))
        frame = self.frame.with_rays(realisation)
        return illuminated(SceneSource(frame, self.scene, settings).traced(Radar()), settings, Radar())


def first_pose(name: str) -> Pose:
    return read_poses(EFFECTS / f"{name}.poses.json")[0]


@lru_cache(maxsize=1)
def case(name: str) -> Case:
    planned = EffectSet.of(set(EXPECTED[name]["effects"]))
    return Case(prepared_scene(EFFECTS / f"{name}.usda"), first_pose(name), planned)


# Paths: power in a resolution cell of the truth


def power_changed(now: Case, name: str) -> float:
    """The largest power of a cell that toggling an effect changes [W].

    The rays and the draws of directions are the same, and what the effect does not touch cancels.
    """
    before, after = (cell_power(now.paths(effects), Radar(), WINDOW) for effects in (now.planned, now.toggled(name)))
    return float(np.abs(after - before).max())


def limit_w(now: Case) -> float:
    """What the frame may leave out of a cell [W]."""
    complete = SceneSource(now.frame, now.scene, EVERYTHING).traced(Radar())
    return Notice(Radar(), DEFAULT_BUDGET_DB).limit_w(complete.table)


@pytest.mark.parametrize("effect", ["multi_bounce", "refraction", "diffraction", "corners", "rcs_targets"])
@pytest.mark.parametrize("name", EXPECTED)
def test_an_effect_on_paths_is_on_where_its_change_exceeds_the_limit(name: str, effect: str) -> None:
    now = case(name)
    changed = power_changed(now, effect)
    assert getattr(now.planned, effect) == (changed > limit_w(now)), f"{changed:.2g} W, limit {limit_w(now):.2g} W"


@pytest.mark.parametrize(("effect", "kind"), [("specular", SPECULAR), ("diffuse", DIFFUSE)])
@pytest.mark.parametrize("name", EXPECTED)
def test_first_hits_and_single_mirrors_are_there_wherever_the_scene_has_them(name: str, effect: str, kind: int) -> None:
    now = case(name)
    paths = now.paths(now.planned)
    there = bool((np.concatenate([paths.scattered.kinds, paths.specular.kinds]) & kind).any())
    assert getattr(now.planned, effect) == there


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
    return measure(FrameIdentity(0, "scene", "effects", 0), paths, (), radar, processing)


def spectra_of(paths: PathTable, effects: EffectSet, radar: Radar, **fields: Any) -> Complex:
    """[R, chirps, C] noise-free range-Doppler spectra."""
    cube = measured(paths, effects, radar, noise=False, **fields).cube
    assert cube is not None
    return range_doppler(cube, radar)


def response_change(planned: Complex, other: Complex) -> float:
    """20 log10 of the largest difference over the peak, [R, ...]; a phase common to a range bin changes no image."""
    rows = (len(planned), -1)
    product = np.sum(np.conj(other.reshape(rows)) * planned.reshape(rows), axis=1)
    magnitude = np.abs(product)
    phase = np.where(magnitude > 0.0, product, 1.0) / np.where(magnitude > 0.0, magnitude, 1.0)
    difference = planned - other * phase.reshape(-1, *[1] * (planned.ndim - 1))
    return float(amplitude_to_db(np.abs(difference).max() / np.abs(planned).max(), NOTHING_DB))


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
    "range_migration": change_by_migration,
    "near_field": change_by_near_field,
}
"""By effect of the signal, what leaving it out changes in range-Doppler spectra or images [dB of the peak]."""


@pytest.mark.parametrize("effect", CHANGES)
@pytest.mark.parametrize("name", [pytest.param("moving_ego", marks=pytest.mark.slow), "target_1m"])
def test_an_effect_on_signals_changes_what_was_written_down(name: str, effect: str) -> None:
    """On the same side of the budget."""
    change_db, expected_db = CHANGES[effect](name), EXPECTED[name]["reasons"][effect]["change_db"]
    expected = expected_db is not None and expected_db > DEFAULT_BUDGET_DB
    assert (change_db > DEFAULT_BUDGET_DB) == expected, f"{change_db:.1f} dB"


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
