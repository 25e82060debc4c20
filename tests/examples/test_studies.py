"""The studies among the examples, on data of seconds: who gains from more scenes, what a variant is worth."""

from __future__ import annotations

import json
import os
import runpy
import sys
from dataclasses import replace
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
sys.path.append(str(ROOT / "tests" / "trainer"))

from small_evaluation import RADAR, THIN, make_run, strong_frame  # noqa: E402
from tiny_radar import write_dataset  # noqa: E402

from trainer.run.configuration import FitConfig  # noqa: E402
from trainer.run.folder import Fingerprint, SceneRecord  # noqa: E402


def unseen(directory: Path, content: str = "m") -> Path:
    """Two test frames of a scene."""
    frames = [replace(strong_frame(index), kind="scene", scene="munich") for index in range(2)]
    data: Path = write_dataset(directory, {"test": frames}, RADAR)
    manifest = json.loads((data / "manifest.json").read_text())
    scenes = [{"name": "munich", "content_sha256": content}]
    (data / "manifest.json").write_text(json.dumps({**manifest, "scenes": scenes}))
    return data


def of_cities(directory: Path, count: int, content: str = "city") -> Path:
    """A run of some cities."""
    scenes = [SceneRecord(name=f"city-{n}", content_sha256=f"{content} {n}") for n in range(count)]
    seen = tuple(Fingerprint(name=s.name, sha256=s.name, frames={"train": 8}, scenes=(s,)) for s in scenes)
    run: Path = make_run(directory, THIN, datasets=seen)
    return run


def ran(monkeypatch: pytest.MonkeyPatch, name: str, *arguments: object, **environment: str) -> None:
    monkeypatch.setattr("sys.argv", [name, *map(str, arguments)])
    for variable, value in environment.items():
        monkeypatch.setitem(os.environ, f"EXAMPLES_{variable}", value)
    runpy.run_path(str(ROOT / "examples" / f"{name}.py"), run_name="__main__")


def test_networks_of_more_scenes_are_held_against_those_of_fewer(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "thin.toml").write_text("rx = [0, 1, 2, 5]\n")
    given = {"ARRAY": str(tmp_path / "thin.toml"), "OUT": str(tmp_path)}
    runs = [of_cities(tmp_path / f"of-{count}", count) for count in (2, 1)]
    ran(monkeypatch, "worlds", unseen(tmp_path / "data"), *runs, **given)
    lines = [line.split(" | ") for line in capsys.readouterr().out.splitlines()[2:]]
    assert [line[:2] for line in lines] == [["| 1", "bare"], ["| 2", "bare"]]
    # The weights are the same: nothing is gained.
    assert [line[3].split()[0] for line in lines] == ["+0.000"] * 2
    assert (tmp_path / "worlds/worlds.png").read_bytes()[:4] == b"\x89PNG"
    with pytest.raises(SystemExit, match="may have been trained on scene 'munich'"):
        ran(monkeypatch, "worlds", unseen(tmp_path / "seen", "city 0"), *runs, **given)


@pytest.mark.slow
def test_a_variant_is_trained_once_and_compared(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    places = {"train": range(2), "validation": (100,), "test": (200,)}
    splits = {split: [replace(strong_frame(n), kind="scene") for n in of_split] for split, of_split in places.items()}
    data = write_dataset(tmp_path / "data", splits, RADAR)
    for _ in range(2):
        ran(monkeypatch, "ablation", data, "spectral-unet", ARRAY="full", OUT=str(tmp_path), STEPS="1", TRIALS="2")
        assert "| unet | " in capsys.readouterr().out
    for changes in runpy.run_path(str(ROOT / "examples/ablation.py"))["VARIANTS"].values():
        FitConfig.model_validate(changes)
