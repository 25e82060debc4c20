"""``plan``, ``render`` and ``trace`` on one of the effect scenes: what they print, refuse, and record of the plan."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from factory_command import ended, refused, run, shards
from prepared_scenes import EFFECT_SCENES as EFFECTS
from small_radar import write_small_radar

from datafactory.effects.catalogue import NAMES

pytestmark = pytest.mark.usefixtures("one_thread")

EXPECTED = json.loads((Path(__file__).parent / "expected.json").read_text(encoding="utf-8"))["scenes"]


@pytest.fixture
def scene_arguments() -> list[object]:
    return ["--scene", EFFECTS / "parked_car.usda", "--poses", EFFECTS / "parked_car.poses.json"]


def test_plan_prints_json_and_nothing_else(scene_arguments, tmp_path: Path) -> None:
    out = tmp_path / "plan"
    status, said, _ = ended("plan", *scene_arguments, "--json", "--no-times", "--out", out)
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
    _, said, _ = ended("plan", *scene_arguments, "--json", "--no-times", "--no-noise", "--error-budget", -5)
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


def made_with(folder: Path) -> list[str]:
    counts = manifest(folder)["counts"]
    return [effect for effect in NAMES if counts[f"frames_with_{effect}"]]


def test_effects_asked_for_are_rendered_and_recorded(small, tmp_path: Path) -> None:
    out = tmp_path / "data"
    run("render", *small, "--effects", "specular,diffuse,noise", "--out", out)
    assert made_with(out) == ["diffuse", "near_field", "noise"]  # the car has no mirror
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
    assert made_with(silent) == ["diffuse", "near_field"]
    document = manifest(traced)
    del document["arguments"]["effects"], document["sha256"]
    (traced / "manifest.json").write_text(json.dumps(document), encoding="utf-8")
    assert "effects" in refused(*from_paths, "--out", tmp_path / "old")
