"""The notebooks of the examples run as scripts, with small numbers, and say what they should."""

import re
from pathlib import Path

from examples_run import example


def said(name: str, out: Path, pictures: int = 1, **small: str) -> str:
    """What an example prints, and nothing beside it; its pictures are in its folder."""
    done = example(name, OUT=str(out), **small)
    assert (done.returncode, done.stderr) == (0, ""), done.stderr
    assert len(list((out / name).glob("*.png"))) == pictures
    return done.stdout


def test_the_tour_ends_at_moving_cars(tmp_path: Path) -> None:
    """The network sees more of the truth than delay-and-sum of the same receivers; a car comes on the left."""
    printed = said("tour", tmp_path, pictures=8, RAYS="4000")
    assert "cube [chirp, sample, channel]: (128, 1024, 48)" in printed
    errors = dict(re.findall(r"^(.*): error ([0-9.]+)$", printed, re.M))
    assert float(errors["network, 6 receivers"]) < 0.8 * float(errors["6 receivers"])
    found = [tuple(map(float, row)) for row in re.findall(r"x +(\S+) m, y +(\S+) m, +(\S+) m/s", printed)]
    assert any(6.0 < x < 12.0 and 2.0 < y < 5.0 and velocity < -7.0 for x, y, velocity in found)


def test_a_scene_of_ones_own_becomes_a_dataset(tmp_path: Path) -> None:
    printed = said("own_scene", tmp_path, RAYS="4000")
    assert "4 meshes, 48 triangles, 1 target" in printed
    assert re.search(r"^on +rcs_targets ", printed, re.M)
    assert "3 frames in" in printed


def test_targets_stand_where_they_were_put(tmp_path: Path) -> None:
    """Angles of a board of eight elements, velocities of cells of 0.2 m/s."""
    printed = said("own_radar", tmp_path)
    assert "2 TX x 4 RX, tdm" in printed
    found = re.findall(r"u = (\S+) \(stated (\S+)\), (\S+) m/s \(stated (\S+)\)", printed)
    assert len(found) == 3
    for u, stated_u, velocity, stated_velocity in (map(float, row) for row in found):
        assert abs(u - stated_u) < 0.03
        assert abs(velocity - stated_velocity) < 0.3


def test_a_network_learns(tmp_path: Path) -> None:
    printed = said("own_network", tmp_path, pictures=0, FRAMES="16", EPOCHS="4")
    assert "18 channels" in printed
    scores = dict(re.findall(r"(network|delay-and-sum): NMSE ([0-9.]+)", printed))
    assert set(scores) == {"network", "delay-and-sum"}
    assert 0.0 < float(scores["network"]) < 0.8 * float(scores["delay-and-sum"])


def test_the_plain_steps_are_the_librarys(tmp_path: Path) -> None:
    printed = said("cube_to_points", tmp_path)
    difference = re.search(r"\(630, 128, 48\), (\S+) from", printed)
    assert difference is not None
    assert float(difference[1]) < 1e-5
    found = [tuple(map(float, row)) for row in re.findall(r"x +(\S+) m, y +(\S+) m, +(\S+) m/s", printed)]
    for place in ((20.0, 0.4), (20.0, -0.4), (12.0, 4.0), (30.0, -9.0), (45.0, 10.0)):
        assert any(abs(x - place[0]) < 0.2 and abs(y - place[1]) < 0.2 for x, y, _ in found), place


def test_more_rays_are_dearer(tmp_path: Path) -> None:
    printed = said("accuracy_and_time", tmp_path, RAYS="1000,4000")
    rows = re.findall(r"(\d+) rays: +(\S+) s, median error (\S+) dB, (\d+) of (\d+) cells lost", printed)
    assert [int(row[0]) for row in rows] == [1000, 4000]
    assert float(rows[0][2]) > 0.0 == float(rows[1][2])
