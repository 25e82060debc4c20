"""What a frame says of its noise."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from datafactory import load_radar, render
from shared.dataset.folder import open_dataset
from shared.signal.spectrum import range_doppler

RADAR = """
[waveform]
samples = 256
chirps = 64
range_bins = 100
[front_end]
converter = { bits = 8, full_scale_dbm = -50 }
"""


@pytest.mark.parametrize("text", [RADAR, RADAR.partition("[front_end]")[0]], ids=["converter", "none"])
def test_the_noise_of_a_frame_is_that_of_its_cells(tmp_path: Path, text: str) -> None:
    """A converter whose step is 2.5 deviations of the receiver's noise; thousands of points were listed of it."""
    (tmp_path / "radar.toml").write_text(text, encoding="utf-8")
    radar = load_radar(str(tmp_path / "radar.toml"))
    render(None, tmp_path / "data", radar=radar, frames=0, points=1, split="0:0:1", store="cube")
    (frame,) = open_dataset(tmp_path / "data").frames("test")
    assert frame.cube is not None
    cells = np.abs(range_doppler(frame.cube, radar)) ** 2
    assert frame.noise_power == pytest.approx(np.median(cells) / np.log(2.0), rel=0.05, abs=0.0)
