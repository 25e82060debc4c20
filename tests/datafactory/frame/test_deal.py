"""Which frame is frame i: every question has one answer, whoever asks."""

from __future__ import annotations

import math
from collections import Counter

import numpy as np
import pytest
from prepared_scenes import SCENES

from datafactory.frame.deal import Deal, drawn_scene, first_middle_last, parse_split_pattern, split_of
from datafactory.frame.points import PointTargets
from datafactory.frame.seeds import frame_seed, generator
from datafactory.scenes.ground import free_ground
from datafactory.scenes.poses import Pose, sample_pose
from datafactory.scenes.readers.open import open_scene
from shared.dataset.folder import SPLITS
from shared.physics.errors import InputError


def test_every_eight_frames_are_six_one_one() -> None:
    splits = [split_of(index) for index in range(16)]
    assert splits == (["train"] * 6 + ["validation", "test"]) * 2
    assert {split_of(index, "1:0:0") for index in range(9)} == {"train"}
    assert [split_of(index, "0:2:1") for index in range(4)] == ["validation", "validation", "test", "validation"]


@pytest.mark.parametrize("pattern", ["6:1", "6:1:1:1", "0:0:0", "-1:1:1", "a:b:c", "1.5:1:1", "", "²:1:1"])
def test_a_bad_split_pattern_is_refused(pattern: str) -> None:
    with pytest.raises(InputError, match=r"--split: .* expected train:validation:test as three whole numbers"):
        parse_split_pattern(pattern)


@pytest.mark.parametrize("scenes", [1, 2, 3, 4, 5, 6, 8, 12, 16])
@pytest.mark.parametrize("pattern", ["6:1:1", "13:2:1", "0:0:1", "1:1:1"])
def test_every_split_gets_every_scene_alike(scenes: int, pattern: str) -> None:
    """Over enough frames each scene has its share of each split; four scenes once gave all test frames to the last."""
    places = sum(map(int, pattern.split(":")))
    frames = math.lcm(scenes, places) * scenes
    counts = Counter((drawn_scene(index, scenes, pattern), split_of(index, pattern)) for index in range(frames))
    for split in {split_of(index, pattern) for index in range(places)}:
        assert len({counts[scene, split] for scene in range(scenes)}) == 1
    assert [drawn_scene(index, scenes, pattern) for index in range(scenes)] == list(range(scenes))


@pytest.mark.parametrize("scenes", [1, 2, 3, 4, 5])
@pytest.mark.parametrize("pattern", ["6:1:1", "3:1:0"])
def test_the_frames_of_all_scenes_are_all_frames_once(scenes: int, pattern: str) -> None:
    deal = Deal(pattern=pattern, scenes=scenes, frames=64, points=3)
    frames = [frame_id for scene in range(scenes) for frame_id in deal.frames_of(scene)]
    assert sorted(frames) == list(range(64))
    assert all(deal.scene_of(frame_id) == scene for scene in range(scenes) for frame_id in deal.frames_of(scene))
    assert deal.splits() == tuple(split_of(frame_id, pattern) for frame_id in range(67))


def test_given_poses_go_to_the_scenes_in_turn() -> None:
    poses = tuple(Pose((float(x), 0.0, 0.5)) for x in range(9))
    deal = Deal(scenes=4, poses=poses)
    assert len(deal) == 9
    assert [deal.frame(index).scene for index in range(9)] == [0, 1, 2, 3, 0, 1, 2, 3, 0]
    assert [deal.frame(index).pose for index in range(9)] == list(poses)


def test_a_stored_row_is_believed() -> None:
    deal = Deal(scenes=2, traced=(1, 1, 0), points=1)
    assert [deal.frame(index).scene for index in range(3)] == [1, 1, 0]
    assert deal.frames_of(1) == (0, 1)
    assert deal.frame(0).pose is None
    assert (deal.frame(3).kind, deal.frame(3).scene) == ("points", -1)


def test_a_drawn_pose_is_of_its_scene_split_and_seed() -> None:
    grounds = tuple(free_ground(open_scene(str(SCENES / name))) for name in ("tiny.usda", "street.xml"))
    deal = Deal(seed=5, scenes=2, frames=16, grounds=grounds)
    for frame_id in (0, 1, 6, 7, 15):
        frame = deal.frame(frame_id)
        assert frame.seed == frame_seed(5, frame_id)
        assert frame.split == split_of(frame_id)
        assert frame.where == sample_pose(grounds[frame.scene], frame.split, generator(frame.seed, "pose"))
        assert deal.frame(frame_id) == frame


def test_other_rays_are_other_rays_and_number_zero_the_run_s_own() -> None:
    frame = Deal(seed=2, scenes=1, poses=(Pose((0.0, 0.0, 0.5)),)).frame(0)
    stream = generator(frame.seed, "rays")
    rays = frame.rays()
    assert rays.offset == (stream.random(), stream.random())
    assert rays.solver_seed == stream.integers(2**31)
    assert frame.with_rays(0).rays() == rays
    others = {frame.with_rays(number).rays().offset for number in range(1, 9)}
    assert len(others) == 8
    assert rays.offset not in others


def test_point_frames_follow_the_scene_frames() -> None:
    targets = tuple(PointTargets(np.ones((1, 3)), np.zeros((1, 3)), np.zeros(1), np.zeros(1)) for _ in range(2))
    deal = Deal(scenes=1, frames=6, targets=targets)
    assert [deal.frame(6 + number).targets is targets[number] for number in range(2)] == [True, True]
    with pytest.raises(IndexError, match="expected 0 to 7"):
        deal.frame(8)
    with pytest.raises(ValueError, match="a points frame; expected a scene frame"):
        _ = deal.frame(6).where


def test_the_place_of_a_frame_is_its_row_in_its_split() -> None:
    deal = Deal(pattern="2:1:1", scenes=1, frames=11)
    rows: dict[str, list[int]] = {split: [] for split in SPLITS}
    for frame_id, split in enumerate(deal.splits()):
        assert deal.place_of(frame_id) == (split, len(rows[split]))
        rows[split].append(frame_id)


@pytest.mark.parametrize(
    ("own", "chosen"),
    [
        (range(0), ()),
        (range(5, 6), (5,)),
        (range(2), (0, 1)),
        (range(1, 100, 3), (1, 49, 97)),
        (range(9), (0, 4, 8)),
    ],
)
def test_frames_that_are_looked_at_are_spread_over_the_run(own: range, chosen: tuple[int, ...]) -> None:
    assert first_middle_last(own) == chosen
