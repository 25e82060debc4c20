"""Radar files: that of tests which run whole commands, with few samples, so that a frame takes no time; and others."""

from pathlib import Path

import pytest

from shared.physics.errors import InputError
from shared.radar import load_radar

SMALL_RADAR = """
[waveform]
chirps = 8
samples = 128
range_bins = 100
bandwidth_hz = 400e6
[grid]
bins = 24
"""


def write_small_radar(folder: Path) -> Path:
    """The file, in this folder."""
    return Path(write_radar(folder, SMALL_RADAR, "small.toml"))


def write_radar(folder: Path, text: str, name: str = "radar.toml") -> str:
    (folder / name).write_text(text, encoding="utf-8")
    return str(folder / name)


def refusal(folder: Path, text: str, name: str = "radar.toml") -> str:
    """The line with which such a file is refused, which begins with its folder or with what the file names."""
    with pytest.raises(InputError) as caught:
        load_radar(write_radar(folder, text, name))
    return str(caught.value)
