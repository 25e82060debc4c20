"""The frames' decisions proven right on ``scenes/effects``: what is on was needed, and what is left out was not.

Of each scene the set is written down beforehand, and every frame decides for it, whatever its rays. Then every effect
is toggled in that set, and the result is simulated again: it changes by more than the frame's limit where the effect
was on, and by less where it was off. What "changes" means is said in ``expected.json`` (``rules``): the power in a
resolution cell for added paths, the response over its peak for how echoes are formed. The latter is decided by
formulas, which ``tests/datafactory/frame/test_decision.py`` holds against slow sums. The scenes are the bytes that
their script writes.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from prepared_scenes import EFFECT_SCENES as EFFECTS
from prepared_scenes import prepared_scene

from datafactory.defaults import DEFAULT_BUDGET_DB
from datafactory.effects import proof
from datafactory.effects.catalogue import ALL, EffectSet
from datafactory.effects.plan import plan_of_frame
from datafactory.frame.chain import ChainSettings, SceneSource, illuminated
from datafactory.frame.deal import Deal, DealtFrame, PreparedScene
from datafactory.frame.measurement import Processing, measure
from datafactory.paths.cells import cell_power
from datafactory.paths.notice import Notice
from datafactory.paths.solver import TraceSettings
from datafactory.paths.table import DIFFUSE, SPECULAR, PathTable
from datafactory.scenes.materials.table import load_materials
from datafactory.scenes.poses import Pose, read_poses
from datafactory.scenes.readers.open import open_scene
from shared.dataset import Frame
from shared.physics.units import power_to_db
from shared.radar import Radar
from shared.radar.arrays import AntennaArray

pytestmark = pytest.mark.usefixtures("one_thread")

EXPECTED = json.loads((Path(__file__).parent / "expected.json").read_text(encoding="utf-8"))["scenes"]

QUICK = ("parked_car", "corner", "reflector_behind_pane")
SCENES = [name if name in QUICK else pytest.param(name, marks=pytest.mark.slow) for name in EXPECTED]
"""Of these every change is simulated; what a frame decides is asked of all."""
RAYS = 200_000
EVERYTHING = ALL.settings(ChainSettings(trace=TraceSettings(rays=RAYS)))
WINDOW = "taylor-30"
"""Of the truth, by default."""


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
        return EffectSet.of({*self.planned.names} ^ {name})

    def paths(self, effects: EffectSet, realisation: int = 0) -> PathTable:
        """Illuminated paths with these effects; the same rays for the same ``realisation``."""
        settings = effects.settings(ChainSettings(trace=TraceSettings(rays=RAYS)))
        frame = self.frame.with_rays(realisation)
        return illuminated(SceneSource(frame, self.scene, settings).traced(Radar()), settings, Radar())


def first_pose(name: str) -> Pose:
    return read_poses(EFFECTS / f"{name}.poses.json")[0]


@lru_cache(maxsize=1)
def case(name: str) -> Case:
    planned = EffectSet.of(EXPECTED[name]["effects"])
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
@pytest.mark.parametrize("name", SCENES)
def test_an_effect_on_paths_is_on_where_its_change_exceeds_the_limit(name: str, effect: str) -> None:
    now = case(name)
    changed = power_changed(now, effect)
    assert (effect in now.planned.names) == (changed > limit_w(now)), f"{changed:.2g} W, limit {limit_w(now):.2g} W"


@pytest.mark.parametrize(("effect", "kind"), [("specular", SPECULAR), ("diffuse", DIFFUSE)])
@pytest.mark.parametrize("name", EXPECTED)
def test_first_hits_and_single_mirrors_are_there_wherever_the_scene_has_them(name: str, effect: str, kind: int) -> None:
    now = case(name)
    paths = now.paths(now.planned)
    there = bool((np.concatenate([paths.scattered.kinds, paths.specular.kinds]) & kind).any())
    assert (effect in now.planned.names) == there


def radar_for(paths: PathTable) -> Radar:
    """The default radar, with a short frame where every chirp is the same; its truth, not looked at, of one element."""
    radar = Radar()
    waveform = radar.waveform if paths.moves() else radar.waveform.model_copy(update={"chirps": 8})
    element = AntennaArray(tx_m=((0.0, 0.0, 0.0),), rx_m=((0.0, 0.0, 0.0),))
    return radar.model_copy(update={"waveform": waveform, "virtual_sensor": element})


def measured(paths: PathTable, effects: EffectSet) -> Frame:
    """The frame that ``effects`` make of these paths."""
    processing = effects.settings(ChainSettings(processing=Processing(peaks=1))).processing
    return measure(Frame(0, "scene", "effects", 0), paths, radar_for(paths), processing).frame


@pytest.mark.parametrize("name", ["wall", "empty_field", "parked_car"])
def test_noise_fills_the_weakest_range_bin(name: str) -> None:
    """Everywhere on: without it, the power in that bin's Doppler cell is another, by more than the budget."""
    now = case(name)
    paths = now.paths(now.planned)
    noisy, clean = (measured(paths, effects) for effects in (now.planned, now.toggled("noise")))
    assert "noise" in now.planned.names
    assert noisy.noise_power > 0.0 == clean.noise_power
    power = [np.mean(np.abs(item.range_channel[0]) ** 2, axis=1) for item in (noisy, clean)]
    weakest = int(np.argmin(power[1]))
    change_db = power_to_db(abs(power[0][weakest] - power[1][weakest]) / power[0][weakest])
    assert change_db > DEFAULT_BUDGET_DB


RADAR = Radar()
SETTINGS = replace(ALL.settings(ChainSettings(trace=TraceSettings())), budget_db=DEFAULT_BUDGET_DB)


def made_with(name: str, seed: int = 0) -> list[list[str]]:
    """The effects of every frame of a scene."""
    scene = prepared_scene(EFFECTS / f"{name}.usda")
    deal = Deal(seed=seed, scenes=1, poses=read_poses(EFFECTS / f"{name}.poses.json"))
    plans = [plan_of_frame(SceneSource(deal.frame(index), scene, SETTINGS), RADAR) for index in range(len(deal))]
    return [sorted(effect for effect, on in plan.effects.items() if on) for plan in plans]


@pytest.mark.parametrize("name", EXPECTED)
def test_every_frame_has_what_was_written_down(name: str) -> None:
    expected = sorted(EXPECTED[name]["effects"])
    assert made_with(name) == [expected] * len(read_poses(EFFECTS / f"{name}.poses.json"))


@pytest.mark.parametrize("seed", [1, 5])
def test_the_decision_does_not_hang_on_the_rays(seed: int) -> None:
    """The scene whose rough surface, at 80 m, has the fewest rays in a cell."""
    (one, *others) = made_with("reflector_behind_pane", seed)
    assert one == sorted(EXPECTED["reflector_behind_pane"]["effects"])
    assert all(other == one for other in others)


@pytest.mark.parametrize("name", SCENES)
def test_what_is_left_out_is_within_the_budget(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Input image, truth image and power in cells against the same frame with every effect, nothing pruned."""
    monkeypatch.setattr(proof, "frame_seconds", lambda *of: 0.0)
    scene = prepared_scene(EFFECTS / f"{name}.usda")
    frame = Deal(scenes=1, poses=read_poses(EFFECTS / f"{name}.poses.json")).frame(0)
    assert proof.prove(SceneSource(frame, scene, SETTINGS), RADAR).worst_db < DEFAULT_BUDGET_DB


@pytest.fixture(scope="module")
def make_effects() -> Iterator[ModuleType]:
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(EFFECTS.parent))
        import make_effects

        yield make_effects


def test_the_committed_files_are_what_the_script_writes(make_effects: ModuleType, tmp_path: Path) -> None:
    make_effects.write_effects(tmp_path)
    written = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    committed = {path.name: path.read_bytes() for path in EFFECTS.iterdir()}
    assert written.keys() == committed.keys()
    assert [name for name in written if written[name] != committed[name]] == []


def test_the_scenes_are_those_written_down(make_effects: ModuleType) -> None:
    shows = {name: said["shows"] for name, said in EXPECTED.items()}
    assert list(shows.items()) == [(scene.name, scene.shows) for scene in make_effects.scenes()]


@pytest.mark.parametrize("name", EXPECTED)
def test_a_scene_opens_as_it_was_meant(name: str) -> None:
    """Without a remark but that pictures of point targets are not traced, its materials by their own names."""
    scene, table = open_scene(str(EFFECTS / f"{name}.usda")), load_materials()
    assert {table.lookup(item.material)[1] for item in scene.objects} <= {"name"}
    pictures = [warning for warning in scene.warnings if "a point target (radar:rcs_dbsm) stands for them" in warning]
    assert list(scene.warnings) == pictures
    assert len(pictures) == (name in ("trihedral", "target_behind_pane", "moving_car"))
