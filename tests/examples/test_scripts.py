"""The examples in small versions: a moving scene, pictures of targets, a file that grows, studies."""

import json
import os
import re
import runpy
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
import typer
from examples_run import EXAMPLES, example
from manual import ROOT
from PIL import Image, ImageSequence
from typer.testing import CliRunner

from shared.radar import load_radar


def test_the_truck_is_seen_where_it_is_and_as_fast_as_it_is(tmp_path):
    out = tmp_path / "truck"
    done = example("truck", "--out", out, "--frames", 2, "--rays", 30_000)
    assert done.returncode == 0, done.stderr
    found = re.search(r"detected in 2 of 2 frames, velocity off by ([0-9.]+) m/s rms", done.stdout)
    assert found is not None, done.stdout
    assert float(found[1]) < 0.25  # a Doppler cell has 0.19 m/s
    with Image.open(out / "images/animation.gif") as film:
        assert len(ImageSequence.all_frames(film)) == 2
    assert (out / "velocity.png").is_file()
    # Up to three Doppler peaks a range bin: what stands and what moves, at different velocities of one image.
    velocity = pq.read_table(out / "images/images.parquet", columns=["velocity"])["velocity"][0].values
    assert {0, -8} <= set(np.round(np.asarray(velocity)).astype(int).tolist())


def drawn(name: str, out: Path) -> str:
    """What an example prints as it draws its picture."""
    done = example(name, out)
    assert done.returncode == 0, done.stderr
    with Image.open(out) as picture:
        assert min(picture.size) > 400
    return done.stdout


def test_the_lobes_above_three_grounds_are_those_of_the_two_ray_model(tmp_path: Path) -> None:
    said = drawn("ground_bounce", tmp_path / "bounce.png")
    apart = [float(found) for found in re.findall(r"at most ([0-9.]+) dB apart", said)]
    assert len(apart) == 3
    assert max(apart) < 0.01


def test_walker_and_car_are_drawn(tmp_path: Path) -> None:
    drawn("micro_doppler", tmp_path / "doppler.png")


FOLLOW = runpy.run_path(str(EXAMPLES / "follow.py"))


def test_a_target_that_walks_away_is_followed(tmp_path: Path) -> None:
    app = typer.Typer()
    app.command()(FOLLOW["main"])
    radar = load_radar("avr-qdm-110")
    FOLLOW["play"](tmp_path / "two.c64", radar, 2, 1000.0)
    command = ["--file", str(tmp_path / "two.c64"), "--model", "das", "--patience", "0.5"]
    result = CliRunner().invoke(app, command, catch_exceptions=False)
    (line,) = result.output.splitlines()
    assert line.startswith("frame   1:")
    assert "strongest at  12." in line


def test_each_frame_is_read_once_when_it_is_whole(tmp_path: Path) -> None:
    radar = load_radar("avr-qdm-110")
    shape = radar.waveform.chirps, radar.waveform.samples, radar.array.channels
    frames = [np.full(shape, value, np.complex64) for value in (1, 2, 3)]
    file = tmp_path / "growing.c64"
    file.write_bytes(frames[0].tobytes())
    found = []
    for number, cube, _ in FOLLOW["growing"](file, radar, 0.3):
        found.append((number, complex(cube[0, 0, 0])))
        if number == 0:
            # Two more and a half: the newest whole one is taken.
            with file.open("ab") as handle:
                handle.write(frames[1].tobytes() + frames[2].tobytes() + frames[0].tobytes()[: 8 * 1000])
    assert found == [(0, 1), (2, 3)]


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
    runpy.run_path(f"{EXAMPLES / name}.py", run_name="__main__")


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


def test_a_variant_is_trained_once_and_compared(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    places = {"train": range(2), "validation": (100,), "test": (200,)}
    splits = {split: [replace(strong_frame(n), kind="scene") for n in of_split] for split, of_split in places.items()}
    data = write_dataset(tmp_path / "data", splits, RADAR)
    for _ in range(2):
        ran(monkeypatch, "ablation", data, "spectral-unet", ARRAY="full", OUT=str(tmp_path), STEPS="1", TRIALS="2")
        assert "| unet | " in capsys.readouterr().out
    for changes in runpy.run_path(str(EXAMPLES / "ablation.py"))["VARIANTS"].values():
        FitConfig.model_validate(changes)
