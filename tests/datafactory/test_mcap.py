"""MCAP files for Foxglove, read back by the mcap package: every topic, its values, and times that rise."""

import io
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from boxed_frames import RADAR, box, frame, write
from factory_command import run
from matplotlib.image import imread
from mcap import reader
from mcap_protobuf import decoder

from datafactory import InputError, convert
from datafactory.api.making import Converted

OTHER_COLOUR = (0.5, 0.5, 0.5)
"""Of what has no class with a colour."""

TOPICS = {
    "/tf": "foxglove.FrameTransform",
    "/truth": "foxglove.CompressedImage",
    "/input": "foxglove.CompressedImage",
    "/targets": "foxglove.PointCloud",
    "/boxes": "foxglove.SceneUpdate",
}


Messages = dict[str, list[tuple[int, Any]]]


def messages(path: Path) -> Messages:
    """(time [ns], message) by topic, in the order of the file; the schema of each topic checked."""
    found: Messages = {topic: [] for topic in TOPICS}
    with path.open("rb") as handle:
        for item in reader.make_reader(handle, decoder_factories=[decoder.DecoderFactory()]).iter_decoded_messages():
            assert item.schema is not None
            assert item.schema.name == TOPICS[item.channel.topic]
            found[item.channel.topic].append((item.message.log_time, item.decoded_message))
    return found


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    boxes = [box(10.0, 4.0, "pedestrian", speed=-2.0), box(18.0, -6.0, "car", yaw=0.5), box(30.0, 2.0, "bicycle")]
    frames = [frame(0, boxes, "range-channel"), frame(1, boxes[:1], "range-channel"), frame(2, [], "range-channel")]
    return write(tmp_path_factory.mktemp("mcap") / "data", frames, ["train", "train", "test"], "range-channel")


@pytest.fixture(scope="module")
def converted(source: Path) -> Converted:
    return convert(source, source.parent / "out", to="mcap")


@pytest.fixture(scope="module")
def train(converted: Converted) -> Messages:
    """Messages of the two frames of training."""
    return messages(converted.directory / "train.mcap")


def test_every_topic_holds_every_frame_at_rising_times(converted: Converted, train: Messages) -> None:
    assert converted.frames == 3
    assert sorted(path.name for path in converted.directory.iterdir()) == ["test.mcap", "train.mcap"]
    for rows in train.values():
        assert [time for time, _ in rows] == [0, 1_000_000_000]  # frames of drawn poses are all at time 0
    assert "1 frames follow the one before after 1 s, whatever their times" in converted.notes


def test_the_times_are_those_of_the_frames(tmp_path: Path) -> None:
    """Two drives, the second from the start of the scene again; three frames of their own at the end, the last of which
    is of much later traffic."""
    known = [(0, 2.0), (0, 2.5), (1, 0.0), (1, 0.5), (-1, 0.0), (-1, 0.4), (-1, 170.0)]
    frames = [replace(frame(i, [], "range-channel"), sequence=s, time=t) for i, (s, t) in enumerate(known)]
    source = write(tmp_path / "data", frames, ["train"] * 7, "range-channel")
    assert convert(source, tmp_path / "out", to="mcap").notes[0].startswith("3 frames follow")
    times = [time for time, _ in messages(tmp_path / "out" / "train.mcap")["/tf"]]
    assert times == [round(1e9 * time) for time in (2.0, 2.5, 3.5, 4.0, 5.0, 5.4, 6.4)]


def test_the_radar_stands_where_the_frame_says(train: Messages) -> None:
    (_, first), (_, second) = train["/tf"]
    assert (first.parent_frame_id, first.child_frame_id) == ("world", "radar")
    where, turn = second.translation, second.rotation
    assert (where.x, where.y, where.z) == (10.0, 1.0, 0.5)
    assert (turn.w, turn.x, turn.y, turn.z) == (0.0, 0.0, 0.0, 1.0)  # half a turn, from w first to w last


def test_images_have_far_up_and_left_on_the_left(train: Messages) -> None:
    """The truth's one bright cell, row 20 of 80 and column 10 of 40; the input's echo at the pedestrian."""
    truth, measured = (imread(io.BytesIO(train[topic][1][1].data)) for topic in ("/truth", "/input"))
    assert truth.shape == measured.shape == (80, 40, 4)
    bright = truth[..., 0]  # the red of the colour map is largest at its top
    assert np.unravel_index(bright.argmax(), bright.shape) == (79 - 20, 39 - 10)
    row, column = np.unravel_index(measured[..., 0].argmax(), (80, 40))
    range_m = float(np.hypot(10.0, 4.0))
    assert RADAR.waveform.ranges_m[79 - row] == pytest.approx(range_m, abs=RADAR.waveform.range_step_m)
    assert RADAR.grid.u[39 - column] == pytest.approx(4.0 / range_m, abs=2 * RADAR.grid.step)


def test_points_are_the_targets(train: Messages) -> None:
    (_, cloud), _ = train["/targets"]
    names = [field.name for field in cloud.fields]
    assert names == ["x", "y", "z", "velocity", "amplitude_db"]
    values = np.frombuffer(cloud.data, np.float32).reshape(-1, cloud.point_stride // 4)
    expected = frame(0, [box(10.0, 4.0, "pedestrian", speed=-2.0), box(18.0, -6.0, "car"), box(30.0, 2.0)]).targets
    for row, target in zip(values, expected, strict=True):
        assert np.hypot(row[0], row[1]) == pytest.approx(target.range_m, rel=1e-6)
        assert row[1] == pytest.approx(target.range_m * target.u, rel=1e-5)
        assert tuple(row[2:]) == pytest.approx((0.0, target.velocity_mps, target.amplitude_db), rel=1e-6)


def test_boxes_replace_those_of_the_frame_before(train: Messages) -> None:
    (_, first), (_, second) = train["/boxes"]
    assert [entity.id for entity in first.entities] == ["/pedestrian at 10", "/car at 18", "/bicycle at 30"]
    assert [entity.id for entity in second.entities] == ["/pedestrian at 10"]
    assert [item.type for item in second.deletions] == [1]  # ALL
    car = first.entities[1]
    assert car.frame_id == "radar"
    assert {pair.key: pair.value for pair in car.metadata}["class"] == "car"
    colours = [entity.cubes[0].color for entity in first.entities]
    assert len({(colour.r, colour.g, colour.b) for colour in colours} - {OTHER_COLOUR}) == 3
    (cube,) = car.cubes
    assert (cube.pose.position.x, cube.pose.position.y, cube.size.x, cube.size.y) == (18.0, -6.0, 4.0, 2.0)
    assert 2.0 * np.arctan2(cube.pose.orientation.z, cube.pose.orientation.w) == pytest.approx(0.5)


def test_equal_datasets_give_equal_files(source: Path, converted: Converted, tmp_path: Path) -> None:
    again = convert(source, tmp_path / "again", to="mcap")
    one, other = ({path.name: path.read_bytes() for path in made.directory.iterdir()} for made in (converted, again))
    assert one == other


def test_a_missing_package_is_one_line(source: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "datafactory.conversion", raising=False)
    monkeypatch.setitem(sys.modules, "foxglove", None)
    with pytest.raises(InputError, match=r"--to mcap: needs the package foxglove-sdk.*pip install .*\[convert\]"):
        convert(source, tmp_path / "out", to="mcap")
    assert not (tmp_path / "out").exists()


def test_the_command_says_what_it_wrote_and_writes_over_nothing(source: Path, tmp_path: Path) -> None:
    said = run("convert", source, "--to", "mcap", "--out", tmp_path / "out")
    assert "3 frames in" in said
    assert "targets have no height" in said
    with pytest.raises(InputError, match="is there already"):
        run("convert", source, "--to", "mcap", "--out", tmp_path / "out")
    with pytest.raises(InputError, match="--to: 'mpac'; expected mcap"):
        run("convert", source, "--to", "mpac", "--out", tmp_path / "new")
