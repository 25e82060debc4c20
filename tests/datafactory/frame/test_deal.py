"""Which frame is frame i, of which sequence: every question has one answer, whoever asks."""

import math
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from prepared_scenes import SCENES
from town_scenes import BARE, box

from datafactory.frame.deal import Deal, StoredRow, dealt
from datafactory.frame.draws import drawn_scene, frame_seed, generator, parse_split_pattern, sequence_seed, split_of
from datafactory.frame.points import PointTargets
from datafactory.frame.remarks import NEIGHBOURS_M, remarks
from datafactory.run.preparation import Order
from datafactory.scenes.boxes import Movers
from datafactory.scenes.drives import Drives
from datafactory.scenes.ground import free_ground
from datafactory.scenes.motion import Track
from datafactory.scenes.poses import Pose, sample_pose
from datafactory.scenes.readers.open import open_scene
from datafactory.scenes.scene import Scene, SceneObject
from shared.physics.errors import InputError
from shared.radar import Radar


def test_every_eight_frames_are_six_one_one() -> None:
    splits = [split_of(index) for index in range(16)]
    assert splits == (["train"] * 6 + ["validation", "test"]) * 2
    assert {split_of(index, "1:0:0") for index in range(9)} == {"train"}
    assert [split_of(index, "0:2:1") for index in range(4)] == ["validation", "validation", "test", "validation"]


@pytest.mark.parametrize("pattern", ["6:1", "6:1:1:1", "0:0:0", "-1:1:1", "1.5:1:1", "", "²:1:1"])
def test_a_bad_split_pattern_is_refused(pattern: str) -> None:
    with pytest.raises(InputError, match=r"--split: .* expected train:validation:test as three whole numbers"):
        parse_split_pattern(pattern)


@pytest.mark.parametrize("scenes", [1, 3, 4, 6, 16])
@pytest.mark.parametrize("pattern", ["6:1:1", "13:2:1", "0:0:1", "1:1:1"])
def test_every_split_gets_every_scene_alike(scenes: int, pattern: str) -> None:
    """Over enough frames each scene has its share of each split; four scenes once gave all test frames to the last."""
    places = sum(map(int, pattern.split(":")))
    frames = math.lcm(scenes, places) * scenes
    counts = Counter((drawn_scene(index, scenes, pattern), split_of(index, pattern)) for index in range(frames))
    for split in {split_of(index, pattern) for index in range(places)}:
        assert len({counts[scene, split] for scene in range(scenes)}) == 1
    assert [drawn_scene(index, scenes, pattern) for index in range(scenes)] == list(range(scenes))


@pytest.mark.parametrize(("scenes", "pattern"), [(1, "6:1:1"), (4, "6:1:1"), (3, "3:1:0")])
def test_the_frames_of_all_scenes_are_all_frames_once(scenes: int, pattern: str) -> None:
    deal = Deal(split=pattern, scenes=scenes, frames=64, points=3)
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
    deal = Deal(scenes=2, stored=rows((1, -1), (1, -1), (0, -1)), points=1)
    assert [deal.frame(index).scene for index in range(3)] == [1, 1, 0]
    assert deal.frames_of(1) == (0, 1)
    assert deal.frame(0).pose is None
    assert (deal.frame(3).kind, deal.frame(3).scene) == ("points", -1)
    deal = Deal(split="1:0:1", scenes=1, stored=rows((0, 0), (0, 0), (0, 1), (0, -1)))
    assert deal.splits() == ("train", "train", "test", "test")
    assert [deal.frame(index).sequence for index in range(4)] == [0, 0, 1, -1]


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


def rows(*of_frames: tuple[int, int]) -> tuple[StoredRow, ...]:
    """Of frames by scene and sequence."""
    return tuple(StoredRow(Path("part-00000.parquet"), row, *said) for row, said in enumerate(of_frames))


def track(length: int, y: float = 0.0) -> tuple[Pose, ...]:
    return tuple(Pose((float(n), y, 0.5), time_s=0.1 * n) for n in range(length))


def test_frames_follow_their_tracks() -> None:
    tracks = (track(3), track(1), track(4))
    deal = Deal(scenes=2, tracks=tracks, track_scenes=(0, 1, 0), points=2)
    assert len(deal) == 10
    frames = [deal.frame(index) for index in range(8)]
    assert [frame.sequence for frame in frames] == [0, 0, 0, 1, 2, 2, 2, 2]
    assert [frame.pose for frame in frames] == [pose for each in tracks for pose in each] == list(deal.given)
    assert [frame.scene for frame in frames] == [0, 0, 0, 1, 0, 0, 0, 0]
    assert deal.frames_of(0) == (0, 1, 2, 4, 5, 6, 7)
    assert [deal.frame(index).sequence for index in (8, 9)] == [-1, -1]


@pytest.mark.parametrize("pattern", ["6:1:1", "1:1:1", "0:0:1"])
def test_no_track_is_cut_between_splits(pattern: str) -> None:
    tracks = tuple(track(5) for _ in range(9))
    deal = Deal(split=pattern, scenes=1, tracks=tracks, track_scenes=(0,) * 9, points=8)
    splits = deal.splits()
    for number in range(9):
        assert set(splits[5 * number : 5 * number + 5]) == {split_of(number, pattern)}
    assert splits[45:] == tuple(split_of(frame_id, pattern) for frame_id in range(45, 53))
    places = [deal.place_of(frame_id) for frame_id in range(len(deal))]
    for split in set(splits):
        assert [row for name, row in places if name == split] == list(range(splits.count(split)))


def test_frames_of_a_track_share_rays_and_cycles_and_have_noise_of_their_own() -> None:
    deal = Deal(seed=4, scenes=1, tracks=(track(2), track(2)), track_scenes=(0, 0))
    one, two, other, _ = (deal.frame(index) for index in range(4))
    assert one.rays() == two.rays() != other.rays()
    assert one.target_seed() == two.target_seed() != other.target_seed()
    assert [one.seed, two.seed] == [frame_seed(4, 0), frame_seed(4, 1)]
    assert one.with_rays(1).rays() == two.with_rays(1).rays() != one.rays()
    # A sequence's seed is no frame's.
    assert not {sequence_seed(0, n) for n in range(200)} & {frame_seed(0, n) for n in range(200)}
    assert sequence_seed(0, 1) != sequence_seed(1, 1)


def order(**values: object) -> Order:
    return Order(radar=Radar(), scenes=(BARE,), **values)  # type: ignore[arg-type]


def test_drives_are_dealt_to_scenes_and_splits_and_the_last_is_cut() -> None:
    drives = Drives(speed_mps=4.0, seconds=0.5, rate_hz=10.0)
    asked = order(frames=38, drives=drives, seed=2)
    deal = dealt(asked, (BARE, BARE))
    assert [len(each) for each in deal.tracks] == [5] * 7 + [3]
    assert deal.track_scenes == tuple(drawn_scene(number, 2) for number in range(8))
    assert deal.splits().count("test") == 3
    assert deal.splits().count("validation") == 5
    shorter = dealt(order(frames=12, drives=drives, seed=2), (BARE, BARE))
    assert shorter.tracks[:2] == deal.tracks[:2]  # how many follow changes nothing
    assert dealt(order(frames=12, drives=drives, seed=3), (BARE, BARE)).tracks[0] != deal.tracks[0]


def test_asked_speeds_are_those_of_poses_and_of_drives() -> None:
    poses = dealt(order(frames=8, speed_mps=(10.0, 12.0)), (BARE,))
    speeds = [math.hypot(*poses.frame(index).where.velocity[:2]) for index in range(8)]
    assert 10.0 <= min(speeds) < max(speeds) <= 12.0
    drives = dealt(order(frames=10, drives=Drives(seconds=0.5), speed_mps=(1.0, 2.0)), (BARE,))
    assert 0.0 < max(math.hypot(*pose.velocity) for track in drives.tracks for pose in track) <= 2.0 * (1.0 + 1e-6)


def test_tracks_of_different_splits_that_meet_are_told() -> None:
    near, far = 0.5 * NEIGHBOURS_M, 2.0 * NEIGHBOURS_M
    deal = Deal(split="1:0:1", scenes=1, tracks=(track(5), track(5, near), track(5, far)), track_scenes=(0, 0, 0))
    assert remarks(deal) == ["sequences 0 (train) and 1 (test) come within 5.0 m of each other"]
    assert remarks(Deal(split="1:0:0", scenes=1, tracks=deal.tracks, track_scenes=(0, 0, 0))) == []
    assert remarks(Deal(split="1:0:1", scenes=2, tracks=deal.tracks, track_scenes=(0, 1, 0))) == []


def test_drawn_drives_that_are_slow_or_alike_are_said() -> None:
    tracks = tuple(
        tuple(replace(pose, velocity=(speed, 0.0, 0.0)) for pose in track(5, y))
        for y, speed in ((0.0, 10.0), (0.1, 9.0), (9.0, 4.0))
    )
    deal = Deal(split="1:0:0", scenes=1, tracks=tracks, track_scenes=(0, 0, 0), drives=Drives(speed_mps=10.0))
    slow = "1 of 3 drives have less than 5 of 10 m/s: their streets are short"
    alike = "1 of 3 drives go the way of an earlier one, perhaps at another time"
    assert remarks(deal) == remarks(replace(deal, drives=Drives(), speed_mps=(10.0, 14.0))) == [slow, alike]
    assert remarks(replace(deal, drives=Drives())) == [alike]
    assert remarks(replace(deal, drives=None)) == []


def test_poses_under_the_ground_are_said() -> None:
    low = Pose((0.0, 0.0, -0.5))
    for given in ({"poses": (low, POSES[0])}, {"tracks": ((low, POSES[0]),), "track_scenes": (0,)}):
        deal = Deal(scenes=1, traffic=(Movers(BARE),), **given)
        assert remarks(deal, [BARE]) == ["town: 1 of 2 poses are under the ground or inside something"]


def test_splits_of_one_scene_alone_are_said() -> None:
    """Two scenes in turn, eight splits in turn: every test frame would be of one scene."""
    traffic = tuple(Movers(Scene(name, (CAR,))) for name in "abc")
    alone = ["all validation frames stand in a", "all test frames stand in b"]
    poses = tuple(POSES[0] for _ in range(16))
    assert remarks(Deal(scenes=2, poses=poses, traffic=traffic[:2], split="6:1:1")) == alone
    assert remarks(Deal(scenes=3, poses=poses, traffic=traffic, split="6:1:1")) == []
    assert remarks(Deal(scenes=1, poses=poses, traffic=traffic[:1], split="6:1:1")) == []
    tracks = tuple((pose,) for pose in poses)
    said = remarks(Deal(scenes=2, traffic=traffic[:2], split="6:1:1", tracks=tracks, track_scenes=(0, 1) * 8))
    assert [line for line in said if "all" in line] == alone


def test_scenes_without_a_frame_are_said() -> None:
    traffic = tuple(Movers(Scene(name, (CAR,))) for name in "abc")
    rest = "2 of 3 scenes have no frame: b, c"
    assert remarks(Deal(scenes=3, poses=POSES[:1], traffic=traffic)) == [rest]
    assert remarks(Deal(scenes=3, tracks=(track(5),), track_scenes=(0,), traffic=traffic)) == [rest]
    assert remarks(Deal(scenes=3, frames=1, traffic=traffic)) == [rest]
    assert remarks(Deal(scenes=3, frames=3, traffic=traffic)) == []


CAR = box("car", (5.0, 0.0, 0.0), (9.0, 2.0, 1.5), "metal")
TRACK = Track((0.0, 2.0), ((0.0, 0.0, 0.0), (6.0, 0.0, 0.0)), ((3.0, 0.0, 0.0), (0.0, 0.0, 0.0)))
POSES = tuple(Pose((0.0, 0.0, 0.5), time_s=time) for time in (0.0, 1.9, 2.0, 7.0))


def test_poses_after_the_last_sample_are_counted() -> None:
    driven = SceneObject("driven", CAR.vertices, CAR.triangles, "metal", motion=TRACK).as_it_moves()

    def said(car: SceneObject, poses: tuple[Pose, ...] = POSES) -> list[str]:
        return remarks(Deal(scenes=1, poses=poses, traffic=(Movers(Scene("street", (CAR, car))),)))

    assert said(driven) == ["street: 2 of 4 poses are not before 2 s, from when on what has samples rests"]
    assert said(driven, POSES[:2]) == []
    before = replace(POSES[0], time_s=-1.0)
    assert said(driven, (before, POSES[0])) == [
        "street: 1 of 2 poses are before 0 s, until when what has samples rests"
    ]
    # A pose of another scene's frame is none of this one's.
    two = Movers(Scene("street", (CAR, driven))), Movers(Scene("yard", (CAR,)))
    assert remarks(Deal(scenes=2, poses=(POSES[0], POSES[3]), traffic=two)) == []
    # What goes straight on never ends.
    assert said(replace(CAR, velocity=(1.0, 0.0, 0.0))) == []
