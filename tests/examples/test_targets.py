"""The pictures of docs/notes/targets.md can be made, and show what the page says."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest
from PIL import Image

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
