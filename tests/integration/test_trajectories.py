"""``render --trajectory``: sequences from files and drawn drives, the same by any number of workers and from paths."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from factory_command import frames_of, run, shards
from numpy.typing import NDArray
from prepared_scenes import EFFECT_SCENES, TINY
from small_radar import write_small_radar

from datafactory import Pose, render
from shared.dataset import Frame
from shared.dataset.folder import read_manifest
from shared.physics.errors import InputError

ROWS = "time,x,y,z,yaw_deg\n0,-10,0,0.5,0\n0.2,-9,0,0.5,0\n0.4,-8,0,0.5,5\n"
EFFECTS = "specular,diffuse,doppler,rcs_targets,noise"
FEW = ("--rays", "500", "--effects", EFFECTS, "--workers", "1")


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("trajectories")
    write_small_radar(folder)
    (folder / "track.csv").write_text(ROWS, encoding="utf-8")
    return folder


def test_a_file_is_a_sequence_at_the_rate_that_is_asked_for(files: Path, tmp_path: Path) -> None:
    run("render", TINY, "--trajectory", files / "track.csv", "--frame-rate", 20, "--radar", files / "small.toml",
        *FEW, "--out", tmp_path / "data")  # fmt: skip
    frames = frames_of(tmp_path / "data")
    assert len(frames) == 9
    assert {split for split, _ in frames.values()} == {"train"}
    assert {frame.sequence for _, frame in frames.values()} == {0}
    np.testing.assert_allclose([frame.time for _, frame in frames.values()], np.arange(9) / 20.0)
    for _, frame in frames.values():
        assert frame.sensor_position[0] == pytest.approx(-10.0 + 5.0 * frame.time)
        assert frame.sensor_velocity == pytest.approx((5.0, 0.0, 0.0))
    manifest = read_manifest(tmp_path / "data")
    assert manifest["counts"]["frames_empty"] == 0
    assert len(manifest["arguments"]["tracks"][0]) == 9


def test_whole_tracks_are_dealt_to_splits(files: Path, tmp_path: Path) -> None:
    two = ("--trajectory", files / "track.csv") * 2
    said = run("render", TINY, *two, "--split", "1:0:1", "--radar", files / "small.toml", *FEW, "--points", 1,
               "--out", tmp_path / "data")  # fmt: skip
    assert "sequences 0 (train) and 1 (test) come within 0.0 m of each other" in said
    found = [(split, frame.sequence, frame.kind) for split, frame in frames_of(tmp_path / "data").values()]
    assert sorted(found) == sorted([("train", 0, "scene")] * 3 + [("test", 1, "scene")] * 3 + [("train", -1, "points")])


def test_drives_have_the_same_bytes_from_traced_paths(files: Path, tmp_path: Path) -> None:
    drive = ("--trajectory", "drive:speed=5,seconds=0.2", "--frames", 5, "--split", "1:1:1", "--seed", 5)
    common = ("--radar", files / "small.toml", *FEW)
    run("render", TINY, *drive, *common, "--out", tmp_path / "once")
    run("trace", TINY, *drive, *common, "--out", tmp_path / "traced")
    run("render", "--paths", tmp_path / "traced", *common[:2], "--effects", EFFECTS, "--seed", 5, "--workers", 1,
        "--out", tmp_path / "later")  # fmt: skip
    once = shards(tmp_path / "once")
    assert sorted({Path(name).parent.name for name in once}) == ["test", "train", "validation"]
    assert shards(tmp_path / "later") == once
    frames = frames_of(tmp_path / "once")
    assert [frames[n][1].sequence for n in range(5)] == [0, 0, 1, 1, 2]
    for number in range(3):
        own = [frame for _, frame in frames.values() if frame.sequence == number]
        assert len({split for split, frame in frames.values() if frame.sequence == number}) == 1
        np.testing.assert_allclose(np.diff([frame.time for frame in own]), 0.1)


@pytest.mark.parametrize(
    ("times", "said"),
    [
        ((), "a track without poses; expected one or more"),
        ((2.0, 1.0), "pose 1, time = 1 after 2; expected times that rise"),
    ],
)
def test_poses_that_are_no_track_are_refused(times: tuple[float, ...], said: str, tmp_path: Path) -> None:
    track = [Pose((-10.0, 0.0, 0.5), time_s=time) for time in times]
    with pytest.raises(InputError, match=f"--trajectory: {said}"):
        render(TINY, tmp_path / "data", trajectory=[track])


def test_what_stands_gives_the_same_image_again_and_a_small_step_a_nearly_equal_one(
    files: Path, tmp_path: Path
) -> None:
    """Speckle belongs to the place. 0.2 mm ahead, an echo at angle a turns by 4 pi 0.2 mm cos(a) / lambda = 37 deg.

    Without noise and traffic: at the same pose at another time the signal is the same to the bit. After the step the
    truth's magnitudes differ by less than 1 % (L2, relative), the signal by |exp(j 37 deg) - 1| = 0.64 of it or less.
    Frames that are no sequence have rays of their own: their truths differ by more than four times as much.
    """
    here = Pose((40.0, 0.0, 0.5))
    track = [here, Pose((40.0002, 0.0, 0.5), time_s=0.1), Pose((40.0, 0.0, 0.5), time_s=7.0)]
    asked: dict[str, Any] = {"radar": files / "small.toml", "rays": 4000, "effects": "all", "noise": False}
    wall, stopped = str(EFFECT_SCENES / "wall.usda"), tmp_path / "stopped.json"
    entries = [{"time": pose.time_s, "position": pose.position, "velocity": [0.0, 0.0, 0.0]} for pose in track]
    stopped.write_text(json.dumps(entries), encoding="utf-8")
    render(wall, tmp_path / "sequence", trajectory=stopped, **asked)
    render(wall, tmp_path / "alone", poses=track, **asked, split="1:0:0")
    first, moved, again = (frame for _, frame in frames_of(tmp_path / "sequence").values())
    alone, alone_moved, _ = (frame for _, frame in frames_of(tmp_path / "alone").values())

    np.testing.assert_array_equal(again.range_channel, first.range_channel)
    np.testing.assert_array_equal(again.image, first.image)
    assert again.image_peak == first.image_peak

    def apart(one: NDArray[Any], other: NDArray[Any]) -> float:
        return float(np.linalg.norm(one - other) / np.linalg.norm(other))

    def truth(frame: Frame) -> NDArray[np.float32]:
        return frame.image * frame.image_peak

    assert apart(truth(moved), truth(first)) < 0.01
    turned = 4.0 * np.pi * 0.2e-3 / 3.87e-3
    assert 0.8 * 2.0 * np.sin(turned / 2.0) < apart(moved.range_channel[0], first.range_channel[0]) < 1.02 * turned
    assert apart(truth(alone_moved), truth(alone)) > 4.0 * apart(truth(moved), truth(first))


def test_traffic_moves_on_from_frame_to_frame(files: Path, tmp_path: Path) -> None:
    """A parked sensor: the car of the tiny scene comes or goes by what it drives in the time between."""
    track = [Pose((-10.0, 0.0, 0.5), time_s=0.25 * n) for n in range(4)]
    render(TINY, tmp_path / "data", trajectory=[track], radar=files / "small.toml", rays=500, effects=EFFECTS)
    frames = [frame for _, frame in frames_of(tmp_path / "data").values()]
    assert len({frame.sensor_position for frame in frames}) == 1
    assert not np.array_equal(frames[0].image, frames[3].image)


def test_speeds_stand_in_the_manifest_where_they_were_asked_for(files: Path, tmp_path: Path) -> None:
    few = ("--radar", files / "small.toml", *FEW, "--frames", 2, "--split", "1:0:0")
    arguments = {}
    for name, speed in (("usual", ()), ("fast", ("--speed", "15:20"))):
        run("render", TINY, *few, *speed, "--out", tmp_path / name)
        arguments[name] = read_manifest(tmp_path / name)["arguments"]
    assert arguments["fast"] == {**arguments["usual"], "speed_mps": [15.0, 20.0]}
    run("render", TINY, *few, "--speed", "15:20", "--out", tmp_path / "fast", "--resume")
    speeds = [np.hypot(*frame.sensor_velocity[:2]) for _, frame in frames_of(tmp_path / "fast").values()]
    assert 15.0 <= min(speeds) < max(speeds) <= 20.0
