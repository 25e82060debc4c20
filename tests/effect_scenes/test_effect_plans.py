"""The frames' decisions proven right on ``scenes/effects``: what is on was needed, and what is left out was not.

Of each scene the set is written down beforehand, and every frame decides for it, whatever its rays. Then every effect
is toggled in that set, and the result is simulated again: it changes by more than the frame's limit where the effect
was on, and by less where it was off. What "changes" means is said in ``expected.json`` (``rules``): the power in a
resolution cell for added paths, the response over its peak for how echoes are formed. The latter is decided by
formulas, which ``tests/datafactory/frame/test_decision.py`` holds against slow sums. The scenes are the bytes that
their script writes.
"""

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from command_line import ended
from factory_command import refused, run, shards
from prepared_scenes import EFFECT_SCENES as EFFECTS
from prepared_scenes import prepared_scene
from small_radar import write_small_radar

from datafactory.accuracy import proof
from datafactory.defaults import DEFAULT_BUDGET_DB
from datafactory.effects.catalogue import ALL, NAMES, EffectSet
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


@lru_cache(maxsize=1)
def case(name: str) -> Case:
    planned = EffectSet.of(EXPECTED[name]["effects"])
    return Case(prepared_scene(EFFECTS / f"{name}.usda"), read_poses(EFFECTS / f"{name}.poses.json")[0], planned)


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
    there = bool((paths.every("kinds") & kind).any())
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


@pytest.fixture
def scene_arguments() -> list[object]:
    return ["--scene", EFFECTS / "parked_car.usda", "--poses", EFFECTS / "parked_car.poses.json"]


def test_plan_prints_json_and_nothing_else(scene_arguments, tmp_path: Path) -> None:
    out = tmp_path / "plan"
    status, said, _ = ended("datafactory", "plan", *scene_arguments, "--json", "--no-times", "--out", out)
    assert status == 0
    printed = json.loads(said)
    assert printed["scene"] == "parked_car"
    assert [item["effect"] for item in printed["effects"]] == list(NAMES)
    assert all(
        set(item) == {"effect", "on", "reason", "evidence", "cost_seconds", "loss_db"} for item in printed["effects"]
    )
    assert [item["effect"] for item in printed["effects"] if item["on"]] == EXPECTED["parked_car"]["effects"]
    assert {item["cost_seconds"] for item in printed["effects"]} == {None}
    assert json.loads((out / "plan.json").read_text(encoding="utf-8")) == printed
    assert (out / "plan.png").read_bytes().startswith(b"\x89PNG")


def test_plan_prints_a_table(scene_arguments) -> None:
    printed = run("plan", *scene_arguments, "--no-times", "--error-budget", -5)
    rows = [line.split("│")[1:7] for line in printed.splitlines() if line.count("│") > 5]
    shown = {effect.strip(): state.strip() for effect, state, *_ in rows if effect.strip()}
    assert list(shown) == list(NAMES)
    assert {cost.strip() for *_, cost, _ in rows} == {""}  # not measured
    # At -5 dB the edges' echoes, 10 dB below the rough rear, still stand above the noise.
    assert [name for name, state in shown.items() if state == "on"] == EXPECTED["parked_car"]["effects"]
    assert "the limit is the receiver's noise" in " ".join(" ".join(why.strip() for _, _, why, *_ in rows).split())


def test_plan_tells_the_decision_of_a_run_without_noise(scene_arguments) -> None:
    """Where the budget counts alone, the edges of the test before are left out."""
    _, said, _ = ended(
        "datafactory", "plan", *scene_arguments, "--json", "--no-times", "--no-noise", "--error-budget", -5
    )
    reasons = {item["effect"]: item["reason"] for item in json.loads(said)["effects"] if not item["on"]}
    assert "below the error budget" in reasons["diffraction"]
    assert reasons["noise"] == "receiver noise is not asked for"


@pytest.fixture
def small(scene_arguments, tmp_path: Path) -> list[object]:
    """One frame of the parked car on a small radar."""
    pose = json.loads((EFFECTS / "parked_car.poses.json").read_text(encoding="utf-8"))[:1]
    (tmp_path / "pose.json").write_text(json.dumps(pose), encoding="utf-8")
    return [*scene_arguments[:2], "--poses", tmp_path / "pose.json", "--radar", write_small_radar(tmp_path),
            "--rays", 20_000, "--workers", 1]  # fmt: skip


def manifest(folder: Path) -> dict:
    return json.loads((folder / "manifest.json").read_text(encoding="utf-8"))


def effects_made(folder: Path) -> list[str]:
    counts = manifest(folder)["counts"]
    return [effect for effect in NAMES if counts[f"frames_with_{effect}"]]


def test_effects_asked_for_are_rendered_and_recorded(small, tmp_path: Path) -> None:
    out = tmp_path / "data"
    run("render", *small, "--effects", "specular,diffuse,noise", "--out", out)
    assert effects_made(out) == ["diffuse", "near_field", "noise"]  # the car has no mirror
    assert manifest(out)["arguments"]["effects"] == ["specular", "diffuse", "noise"]
    assert manifest(out)["arguments"]["budget_db"] is None
    assert {"trace", "cube", "truth", "image"} <= set(manifest(out)["made"]["step_seconds"])


def test_effects_that_are_no_choice_are_told_so(small, tmp_path: Path) -> None:
    said = run("render", *small, "--effects", "diffuse,near_field,noise", "--out", tmp_path / "data")
    assert "near_field made no difference" in " ".join(said.split())
    assert "made no difference" not in run("render", *small, "--effects", "diffuse,noise", "--out", tmp_path / "other")
    assert shards(tmp_path / "data") == shards(tmp_path / "other") != {}


def test_traced_paths_cannot_get_other_paths_afterwards(small, tmp_path: Path) -> None:
    """What works on the signal may be asked for anew; what decides which paths there are may not."""
    traced, silent = tmp_path / "traced", tmp_path / "silent"
    radar = small[small.index("--radar") : small.index("--radar") + 2]
    run("trace", *small, "--effects", "diffuse,noise", "--out", traced)
    from_paths = ["render", "--paths", traced, *radar, "--workers", 1]
    assert "traced without specular" in refused(*from_paths, "--effects", "all", "--out", tmp_path / "other")
    said = run(*from_paths, "--effects", "diffuse,near_field", "--out", silent)
    assert "near_field made no difference" in " ".join(said.split())
    assert effects_made(silent) == ["diffuse", "near_field"]
    document = manifest(traced)
    del document["arguments"]["effects"], document["sha256"]
    (traced / "manifest.json").write_text(json.dumps(document), encoding="utf-8")
    assert "effects" in refused(*from_paths, "--out", tmp_path / "old")
