"""Columns and descriptions: frames come back bit for bit, types are the contract, what does not fit is refused."""

import dataclasses

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from small_dataset import BINS, CHANNELS, CHIRPS, PEAKS, RADAR, ROWS, SAMPLES, assert_same, make_frame, write

from shared.dataset import Box, Target, arrow_schema, description, row_bytes, to_record_batch
from shared.dataset.reading import read_description, read_frame, read_frames
from shared.physics.errors import InputError


@pytest.mark.parametrize("store", ["range-channel", "range-doppler", "cube"])
@pytest.mark.parametrize("rows_per_group", [1, 2, 5])
def test_frames_come_back_bit_for_bit(tmp_path, store, rows_per_group):
    frames = [make_frame(index, store) for index in range(5)]
    write(tmp_path / "shard.parquet", frames, store, rows_per_group)
    back = list(read_frames(tmp_path / "shard.parquet"))
    assert len(back) == len(frames)
    for index, frame in enumerate(frames):
        assert_same(frame, back[index])
        assert_same(frame, read_frame(tmp_path / "shard.parquet", index))


def test_column_types_are_the_contract(tmp_path):
    write(tmp_path / "shard.parquet", [make_frame(0, "cube")], "cube")
    schema = pq.read_schema(tmp_path / "shard.parquet")
    sizes = {"range_channel": PEAKS * ROWS * CHANNELS * 2, "velocity": PEAKS * ROWS, "image": ROWS * BINS}
    sizes["cube"] = CHIRPS * SAMPLES * CHANNELS * 2
    for name, size in sizes.items():
        kind = schema.field(name).type
        assert (kind.value_type, kind.list_size) == (pa.float32(), size)
    for name, size in {"sensor_position": 3, "sensor_velocity": 3, "sensor_orientation": 4}.items():
        kind = schema.field(name).type
        assert (kind.value_type, kind.list_size) == (pa.float64(), size)
    scalars = {"frame_id": pa.int64(), "seed": pa.int64(), "kind": pa.string(), "scene": pa.string()}
    scalars |= {"image_peak": pa.float64(), "noise_power": pa.float64(), "time": pa.float64(), "sequence": pa.int64()}
    assert {name: schema.field(name).type for name in scalars} == scalars
    assert [field.name for field in schema.field("targets").type.value_type] == [
        "range", "u", "velocity", "amplitude_db", "object",
    ]  # fmt: skip
    box = {field.name: field.type for field in schema.field("boxes").type.value_type}
    assert list(box) == ["center", "size", "yaw", "velocity", "class", "object", "power"]
    for name in ("center", "size", "velocity"):
        assert (box[name].value_type, box[name].list_size) == (pa.float64(), 3)
    assert schema.names.index("boxes") == schema.names.index("targets") + 1
    assert "range_doppler" not in schema.names


def test_row_bytes_is_what_arrow_holds():
    frame = make_frame(0, "cube")
    assert frame.cube is not None
    expected = frame.range_channel.nbytes + frame.velocity.nbytes + frame.image.nbytes + frame.cube.nbytes
    shapes = description(RADAR, PEAKS, "cube")["shapes"]
    assert row_bytes(shapes) == expected
    assert row_bytes(shapes, ["image", "scene"]) == frame.image.nbytes


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"image": np.zeros((ROWS, BINS + 1), np.float32)}, r"frame 1: image is float32 \[6, 21\]; expected.*\[6, 20"),
        ({"image": np.zeros((ROWS, BINS))}, "frame 1: image is float64"),
        ({"image": np.full((ROWS, BINS), np.nan, np.float32)}, "frame 1: image has 120 values that are not finite"),
        ({"range_channel": None}, "frame 1: range_channel is None; expected complex64"),
        ({"kind": "street"}, "frame 1: kind = 'street'; expected one of"),
        ({"sensor_orientation": (1.0, 0.0, 0.0)}, "frame 1: sensor_orientation = .*; expected 4 finite numbers"),
        ({"sensor_velocity": (1.0, 0.0, np.inf)}, "frame 1: sensor_velocity"),
        ({"noise_power": -1.0}, r"frame 1: noise_power = -1\.0"),
        ({"time": np.nan}, "frame 1: time = nan; expected a finite number"),
        ({"targets": (Target(1.0, 0.0, 0.0, -np.inf),)}, "frame 1: Target"),
        ({"boxes": (Box((np.nan, 0.0, 0.0), (1.0, 1.0, 1.0), 0.0, (0.0, 0.0, 0.0), "car", "a"),)}, "frame 1: Box"),
        ({"boxes": (Box((9.0, 0.0, 0.0), (1.0, 1.0, -1.0), 0.0, (0.0, 0.0, 0.0), "car", "a"),)}, "frame 1: Box"),
    ],
)
def test_a_frame_that_does_not_fit_is_refused_by_name(change, message):
    schema = arrow_schema(description(RADAR, PEAKS, "range-channel"))
    with pytest.raises(InputError, match=message):
        to_record_batch([dataclasses.replace(make_frame(1), **change)], schema)


def test_description_keeps_what_is_added_but_lets_nothing_be_replaced(tmp_path):
    write(tmp_path / "shard.parquet", [make_frame(0)], truth_window="hann")
    assert read_description(tmp_path / "shard.parquet")["truth_window"] == "hann"
    with pytest.raises(ValueError, match="'radar'"):
        description(RADAR, PEAKS, "range-channel", {"radar": {}})
    with pytest.raises(InputError, match=r"--store: 'all'.*'cube'"):
        description(RADAR, PEAKS, "all")
