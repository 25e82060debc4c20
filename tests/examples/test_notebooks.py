"""The notebooks of the examples run as scripts, with small numbers, and say what they should."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SMALL = {
    "tour": {"EXAMPLES_RAYS": "4000"},
    "own_scene": {"EXAMPLES_RAYS": "4000"},
    "own_radar": {},
    "own_network": {"EXAMPLES_FRAMES": "16", "EXAMPLES_EPOCHS": "4"},
    "cube_to_points": {},
    "accuracy_and_time": {"EXAMPLES_RAYS": "1000,4000"},
}


@pytest.fixture
def said(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """What an example prints."""
    name = request.param
    environment = {**os.environ, **SMALL[name], "EXAMPLES_OUT": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, "-W", "error::UserWarning:__main__", f"examples/{name}.py"],
        capture_output=True, text=True, check=False, cwd=ROOT, env=environment,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stderr == "", done.stderr
    assert len(list((tmp_path / name).glob("*.png"))) == {"tour": 8, "own_network": 0}.get(name, 1)
    return done.stdout


@pytest.mark.slow
@pytest.mark.parametrize("said", ["tour"], indirect=True)
def test_the_tour_ends_at_moving_cars(said: str) -> None:
    """The network sees more of the truth than delay-and-sum of the same receivers; a car comes on the left."""
    assert "cube [chirp, sample, channel]: (128, 1024, 48)" in said
    errors = dict(re.findall(r"^(.*): error ([0-9.]+)$", said, re.M))
    assert float(errors["network, 6 receivers"]) < 0.8 * float(errors["6 receivers"])
    found = [tuple(map(float, row)) for row in re.findall(r"x +(\S+) m, y +(\S+) m, +(\S+) m/s", said)]
    assert any(6.0 < x < 12.0 and 2.0 < y < 5.0 and velocity < -7.0 for x, y, velocity in found)


@pytest.mark.slow
@pytest.mark.parametrize("said", ["own_scene"], indirect=True)
def test_a_scene_of_ones_own_becomes_a_dataset(said: str) -> None:
    assert "4 meshes, 48 triangles, 1 target" in said
    assert re.search(r"^on +rcs_targets ", said, re.M)
    assert "3 frames in" in said


@pytest.mark.slow
@pytest.mark.parametrize("said", ["own_radar"], indirect=True)
def test_targets_stand_where_they_were_put(said: str) -> None:
    """Angles of a board of eight elements, velocities of cells of 0.2 m/s."""
    assert "2 TX x 4 RX, tdm" in said
    found = re.findall(r"u = (\S+) \(stated (\S+)\), (\S+) m/s \(stated (\S+)\)", said)
    assert len(found) == 3
    for u, stated_u, velocity, stated_velocity in (map(float, row) for row in found):
        assert abs(u - stated_u) < 0.03
        assert abs(velocity - stated_velocity) < 0.3


@pytest.mark.slow
@pytest.mark.parametrize("said", ["own_network"], indirect=True)
def test_a_network_learns(said: str) -> None:
    assert "18 channels" in said
    scores = dict(re.findall(r"(network|delay-and-sum): NMSE ([0-9.]+)", said))
    assert set(scores) == {"network", "delay-and-sum"}
    assert 0.0 < float(scores["network"]) < 0.8 * float(scores["delay-and-sum"])


@pytest.mark.slow
@pytest.mark.parametrize("said", ["cube_to_points"], indirect=True)
def test_the_plain_steps_are_the_librarys(said: str) -> None:
    difference = re.search(r"\(630, 128, 48\), (\S+) from", said)
    assert difference is not None
    assert float(difference[1]) < 1e-5
    found = [tuple(map(float, row)) for row in re.findall(r"x +(\S+) m, y +(\S+) m, +(\S+) m/s", said)]
    for place in ((20.0, 0.4), (20.0, -0.4), (12.0, 4.0), (30.0, -9.0), (45.0, 10.0)):
        assert any(abs(x - place[0]) < 0.2 and abs(y - place[1]) < 0.2 for x, y, _ in found), place


@pytest.mark.slow
@pytest.mark.parametrize("said", ["accuracy_and_time"], indirect=True)
def test_more_rays_are_dearer(said: str) -> None:
    rows = re.findall(r"(\d+) rays: +(\S+) s, median error (\S+) dB, (\d+) of (\d+) cells lost", said)
    assert [int(row[0]) for row in rows] == [1000, 4000]
    assert float(rows[0][2]) > 0.0 == float(rows[1][2])
