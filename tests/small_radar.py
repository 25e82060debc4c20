"""The radar of tests that run whole commands: so few samples that a frame takes no time, as the commands take it."""

from pathlib import Path

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
    path = folder / "small.toml"
    path.write_text(SMALL_RADAR, encoding="utf-8")
    return path
