"""The examples that draw or follow: the pictures of docs/notes/targets.md, the truck, the newest frame of a file."""

from __future__ import annotations

import re
import runpy
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
import typer
from PIL import Image, ImageSequence
from typer.testing import CliRunner

from shared.radar import load_radar

EXAMPLES = Path(__file__).parents[2] / "examples"


def drawn(name: str, out: Path) -> str:
    """What an example prints as it draws its picture."""
    done = subprocess.run(
        [sys.executable, str(EXAMPLES / f"{name}.py"), str(out)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    with Image.open(out) as picture:
        assert min(picture.size) > 400
    return done.stdout


@pytest.mark.slow
def test_the_lobes_above_three_grounds_are_those_of_the_two_ray_model(tmp_path: Path) -> None:
    said = drawn("ground_bounce", tmp_path / "bounce.png")
    apart = [float(found) for found in re.findall(r"at most ([0-9.]+) dB apart", said)]
    assert len(apart) == 3
    assert max(apart) < 0.01


@pytest.mark.slow
def test_walker_and_car_are_drawn(tmp_path: Path) -> None:
    drawn("micro_doppler", tmp_path / "doppler.png")


TRUCK = Path(__file__).parents[2] / "examples" / "truck.py"


@pytest.mark.slow
def test_the_truck_is_seen_where_it_is_and_as_fast_as_it_is(tmp_path):
    out = tmp_path / "truck"
    command = [sys.executable, str(TRUCK), "--out", str(out), "--frames", "2", "--rays", "30000"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
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


FOLLOW = runpy.run_path(str(Path(__file__).parents[2] / "examples" / "follow.py"))


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
