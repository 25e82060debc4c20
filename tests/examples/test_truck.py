"""The moving scene of the examples, in a small version: two frames, few rays."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from PIL import Image, ImageSequence

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
