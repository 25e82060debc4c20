"""Sequences: a whole track is one split and one scene; its frames share what stands still, and nothing else."""

from __future__ import annotations

import pytest
from town_scenes import BUILDINGS, PLATE

from datafactory.frame.deal import Deal, drawn_scene, split_of
from datafactory.frame.seeds import frame_seed, sequence_seed
from datafactory.run.order import Order
from datafactory.run.preparation import NEIGHBOURS_M, close_tracks, deal_of
from datafactory.scenes.drives import Drives
from datafactory.scenes.poses import Pose
from datafactory.scenes.scene import Scene
from shared.radar import Radar

TOWN = Scene("town", (PLATE, *BUILDINGS))


def track(length: int, y: float = 0.0) -> tuple[Pose, ...]:
    return tuple(Pose((float(n), y, 0.5), time_s=0.1 * n) for n in range(length))


def test_frames_follow_their_tracks() -> None:
    tracks = (track(3), track(1), track(4))
    deal = Deal(scenes=2, tracks=tracks, track_scenes=(0, 1, 0), points=2)
    assert len(deal) == 10
    frames = [deal.frame(index) for index in range(8)]
    assert [frame.sequence for frame in frames] == [0, 0, 0, 1, 2, 2, 2, 2]
    assert [frame.pose for frame in frames] == [pose for each in tracks for pose in each]
    assert [frame.scene for frame in frames] == [0, 0, 0, 1, 0, 0, 0, 0]
    assert deal.frames_of(0) == (0, 1, 2, 4, 5, 6, 7)
    assert [deal.frame(index).sequence for index in (8, 9)] == [-1, -1]


@pytest.mark.parametrize("pattern", ["6:1:1", "1:1:1", "0:0:1"])
def test_no_track_is_cut_between_splits(pattern: str) -> None:
    tracks = tuple(track(5) for _ in range(9))
    deal = Deal(pattern=pattern, scenes=1, tracks=tracks, track_scenes=(0,) * 9, points=8)
    splits = deal.splits()
    for number in range(9):
        assert set(splits[5 * number : 5 * number + 5]) == {split_of(number, pattern)}
    assert splits[45:] == tuple(split_of(frame_id, pattern) for frame_id in range(45, 53))
    rows = [deal.place_of(frame_id) for frame_id in range(len(deal))]
    for split in set(splits):
        assert [row for name, row in rows if name == split] == list(range(splits.count(split)))


def test_frames_of_a_track_share_rays_and_cycles_and_have_noise_of_their_own() -> None:
    deal = Deal(seed=4, scenes=1, tracks=(track(2), track(2)), track_scenes=(0, 0))
    one, two, other, _ = (deal.frame(index) for index in range(4))
    assert one.rays() == two.rays() != other.rays()
    assert one.target_seed() == two.target_seed() != other.target_seed()
    assert [one.seed, two.seed] == [frame_seed(4, 0), frame_seed(4, 1)]
    assert one.with_rays(1).rays() == two.with_rays(1).rays() != one.rays()


def test_a_sequence_s_seed_is_no_frame_s() -> None:
    assert not {sequence_seed(0, n) for n in range(200)} & {frame_seed(0, n) for n in range(200)}
    assert sequence_seed(0, 1) != sequence_seed(1, 1)


def test_stored_rows_say_their_sequence() -> None:
    deal = Deal(pattern="1:0:1", scenes=1, traced=(0, 0, 0, 0), traced_sequences=(0, 0, 1, -1))
    assert deal.splits() == ("train", "train", "test", "test")
    assert [deal.frame(index).sequence for index in range(4)] == [0, 0, 1, -1]


def order(**values: object) -> Order:
    return Order(radar=Radar(), scenes=(TOWN,), **values)  # type: ignore[arg-type]


def test_drives_are_dealt_to_scenes_and_splits_and_the_last_is_cut() -> None:
    drives = Drives(speed_mps=4.0, seconds=0.5, rate_hz=10.0)
    asked = order(frames=38, drives=drives, seed=2)
    deal = deal_of(asked, (TOWN, TOWN))
    assert [len(each) for each in deal.tracks] == [5] * 7 + [3]
    assert deal.track_scenes == tuple(drawn_scene(number, 2) for number in range(8))
    assert deal.splits().count("test") == 3
    assert deal.splits().count("validation") == 5
    shorter = deal_of(order(frames=12, drives=drives, seed=2), (TOWN, TOWN))
    assert shorter.tracks[:2] == deal.tracks[:2]  # how many follow changes nothing
    assert deal_of(order(frames=12, drives=drives, seed=3), (TOWN, TOWN)).tracks[0] != deal.tracks[0]


def test_tracks_of_different_splits_that_meet_are_told() -> None:
    near, far = 0.5 * NEIGHBOURS_M, 2.0 * NEIGHBOURS_M
    deal = Deal(pattern="1:0:1", scenes=1, tracks=(track(5), track(5, near), track(5, far)), track_scenes=(0, 0, 0))
    assert close_tracks(deal) == ["sequences 0 (train) and 1 (test) come within 5.0 m of each other"]
    assert close_tracks(Deal(pattern="1:0:0", scenes=1, tracks=deal.tracks, track_scenes=(0, 0, 0))) == []


def test_the_order_knows_its_frames() -> None:
    assert order(frames=4).scene_frames == 4
    assert order(tracks=(track(3), track(2))).scene_frames == 5
    assert order(tracks=(track(3), track(2))).given == (*track(3), *track(2))
