"""The newest frame of a file that grows is imaged, each once; what was missed is counted."""

from __future__ import annotations

import runpy
from pathlib import Path

import numpy as np
import typer
from typer.testing import CliRunner

from shared.radar import load_radar

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
