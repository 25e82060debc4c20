"""Shards: bit for bit, of the contract's types, by other readers, older, newer, damaged; folders and their manifest."""

import dataclasses
import hashlib
import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from small_dataset import (
    BINS,
    CHANNELS,
    CHIRPS,
    PEAKS,
    RADAR,
    ROWS,
    SAMPLES,
    assert_same,
    make_dataset,
    make_frame,
    make_traced,
    write,
)

from shared.dataset import Box, Target, arrow_schema, description, row_bytes, to_record_batch
from shared.dataset.folder import open_dataset, verify
from shared.dataset.reading import radar_of, read_description, read_frame, read_frames
from shared.physics.errors import InputError
from shared.radar import load_radar
from shared.signal.imaging import delay_and_sum


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


@pytest.mark.parametrize(
    ("column", "at", "value", "message"),
    [
        ("image", 7, np.nan, "frame 1: image has 1 values that are not finite; expected finite values"),
        ("range_channel", 0, -np.inf, "frame 1: range_channel has 1 values"),
        ("sensor_velocity", 2, np.inf, "frame 1: sensor_velocity has 1 values"),
        ("noise_power", 0, -1.0, r"frame 1: noise_power = -1\.0; expected a finite number of at least 0"),
        ("time", 0, np.nan, "frame 1: time = nan; expected a finite number"),
    ],
)
def test_a_shard_of_another_writer_with_values_that_are_not_finite_is_refused_by_frame(
    tmp_path, column, at, value, message
):
    path = tmp_path / "shard.parquet"
    write(path, [make_frame(0), make_frame(1), make_frame(2)])
    table = pq.read_table(path)
    place = table.schema.get_field_index(column)
    kind = table.schema.field(place)
    rows = np.array(table.column(place).to_pylist(), np.float64).reshape(3, -1)
    rows[1, at] = value
    values = rows.ravel().astype(kind.type.value_type.to_pandas_dtype() if rows.shape[1] > 1 else np.float64)
    array = pa.array(values)
    array = pa.FixedSizeListArray.from_arrays(array, type=kind.type) if rows.shape[1] > 1 else array
    pq.write_table(table.set_column(place, kind, array), path)
    with pytest.raises(InputError, match=f"shard.parquet: {message}"):
        list(read_frames(path))
    with pytest.raises(InputError, match=f"shard.parquet: {message}"):
        read_frame(path, 1)
    assert read_frame(path, 0).frame_id == 0


def test_description_keeps_what_is_added_but_lets_nothing_be_replaced(tmp_path):
    write(tmp_path / "shard.parquet", [make_frame(0)], truth_window="hann")
    assert read_description(tmp_path / "shard.parquet")["truth_window"] == "hann"
    with pytest.raises(ValueError, match="'radar'"):
        description(RADAR, PEAKS, "range-channel", {"radar": {}})
    with pytest.raises(InputError, match=r"--store: 'all'.*'cube'"):
        description(RADAR, PEAKS, "all")


def test_columns_left_out_are_empty_and_the_rest_is_whole(tmp_path):
    frame = make_frame(3, "cube")
    write(tmp_path / "shard.parquet", [frame], "cube")
    (back,) = read_frames(tmp_path / "shard.parquet", columns=["image"])
    assert back.range_channel.shape == (0, ROWS, CHANNELS)
    assert back.cube is None
    assert back.targets == back.boxes == ()
    left_out = ("range_channel", "velocity", "cube", "targets", "boxes")
    whole = dataclasses.replace(back, **{name: getattr(frame, name) for name in left_out})
    assert_same(whole, frame)
    with pytest.raises(InputError, match=r"shard\.parquet: no column 'range_doppler'"):
        list(read_frames(tmp_path / "shard.parquet", columns=["range_doppler"]))


def _polars(path):
    import polars

    column = polars.read_parquet(path)["range_channel"][0]
    return np.array(column), polars.read_parquet_metadata(path)["sparseradar"]


def _duckdb(path):
    import duckdb

    with duckdb.connect() as connection:
        ((column,),) = connection.execute(f"select range_channel from '{path}'").fetchall()
        query = f"select decode(value) from parquet_kv_metadata('{path}') where decode(key) = 'sparseradar'"
        ((text,),) = connection.execute(query).fetchall()
    return np.array(column), text


@pytest.mark.parametrize("reader", [_polars, _duckdb])
def test_another_reader_can_draw_the_image_from_one_shard_alone(tmp_path, reader):
    path = tmp_path / "shard.parquet"
    write(path, [make_frame(1)])
    column, text = reader(path)

    # From here on nothing of ours: metadata and NumPy.
    about = json.loads(text)
    pairs = np.asarray(column, dtype=np.float32).reshape(about["shapes"]["range_channel"])
    signal = pairs[0, ..., 0] + 1j * pairs[0, ..., 1]
    frequency = about["radar"]["carrier_hz"] + about["radar"]["bandwidth_hz"] / 2
    y_tx, y_rx = (np.array(about["array"][name])[:, 1] for name in ("tx_m", "rx_m"))
    y = (y_rx[:, None] + y_tx[None, :]).reshape(-1)  # rx-major
    axis = about["axes"]["u"]
    u = axis["start"] + axis["step"] * np.arange(axis["bins"])
    image = signal @ np.exp(2j * np.pi * frequency / 299_792_458.0 * np.outer(y, u)) / len(y)

    np.testing.assert_allclose(image, delay_and_sum(make_frame(1).range_channel[0], RADAR), rtol=1e-4, atol=1e-6)


def test_a_shard_of_a_newer_version_or_of_something_else_is_refused(tmp_path):
    path = tmp_path / "shard.parquet"
    write(path, [make_frame(0)])
    table = pq.read_table(path)
    about = json.loads(table.schema.metadata[b"sparseradar"])

    def rewrite(**changes) -> None:
        metadata = {"sparseradar": json.dumps(about | changes)}
        pq.write_table(table.replace_schema_metadata(metadata), path)

    rewrite(version=2)
    with pytest.raises(InputError, match="made by a newer version: version 2"):
        next(read_frames(path))
    rewrite(shapes=about["shapes"] | {"image": [ROWS, BINS + 1]})
    with pytest.raises(InputError, match=r"image is fixed_size_list.*\[120\].*expected.* 126"):
        next(read_frames(path))
    pq.write_table(table.drop_columns(["seed"]), path)
    with pytest.raises(InputError, match="'seed'"):
        next(read_frames(path))
    pq.write_table(table.replace_schema_metadata(None), path)
    with pytest.raises(InputError, match="no metadata 'sparseradar'"):
        next(read_frames(path))


def test_damage_inside_a_column_is_one_line(tmp_path):
    path = tmp_path / "shard.parquet"
    write(path, [make_frame(0)])
    chunk = pq.read_metadata(path).row_group(0)
    image = next(c for c in map(chunk.column, range(chunk.num_columns)) if c.path_in_schema.startswith("image."))
    start = image.dictionary_page_offset or image.data_page_offset
    content = bytearray(path.read_bytes())
    content[start : start + 16] = b"\xff" * 16  # the page header
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"shard\.parquet: damaged: "):
        list(read_frames(path))
    with pytest.raises(InputError, match=r"shard\.parquet: damaged: "):
        read_frame(path, 0)


@pytest.mark.parametrize("radar", [RADAR, load_radar("avr-qdm-110"), load_radar("avr-qdm-110-virtual")], ids=str)
def test_the_radar_can_be_had_back_from_the_description(radar):
    assert radar_of(json.loads(json.dumps(description(radar, PEAKS, "range-channel")))) == radar


def test_radar_of_something_else_is_refused():
    about = description(RADAR, PEAKS, "range-channel")
    with pytest.raises(InputError, match=r"x\.parquet: no whole radar in the metadata: KeyError\('axes'\)"):
        radar_of({"radar": about["radar"]}, "x.parquet")
    with pytest.raises(InputError, match=r"x\.parquet: waveform\.chirps = 0"):
        radar_of(about | {"radar": about["radar"] | {"chirps": 0}}, "x.parquet")


SHARDS = {"train/part-00000": (0, 1), "train/part-00001": (2,), "test/part-00000": (3,)}


def test_a_folder_of_traced_paths_is_verified_and_says_that_it_holds_no_frames(tmp_path):
    dataset = open_dataset(make_traced(tmp_path))
    assert dataset.splits == {}
    assert verify(dataset) == []
    expected = "holds traced paths and no frames; expected a dataset, as made by datafactory render --paths"
    for ask in (dataset.description, lambda: dataset.shards("test"), lambda: dataset.rows("train")):
        with pytest.raises(InputError, match=expected):
            ask()


def test_a_dataset_is_read_split_by_split(tmp_path):
    dataset = open_dataset(make_dataset(tmp_path, SHARDS))
    assert [frame.frame_id for frame in dataset.frames("train")] == [0, 1, 2]
    assert [read_frame(*place).frame_id for place in dataset.rows("train")] == [0, 1, 2]
    assert list(dataset.splits) == ["train", "test"]
    assert verify(dataset) == []
    with pytest.raises(InputError, match=r"no frames in split 'validation'; expected one of \['train', 'test'\]"):
        next(dataset.frames("validation"))


def test_a_truncated_or_missing_shard_is_named(tmp_path):
    shard = make_dataset(tmp_path, SHARDS) / "train/part-00001.parquet"
    size = shard.stat().st_size
    shard.write_bytes(shard.read_bytes()[:-7])
    with pytest.raises(InputError, match=rf"part-00001\.parquet: {size - 7} bytes; the manifest says {size}"):
        open_dataset(tmp_path)
    assert len(verify(open_dataset(tmp_path, check_sizes=False))) == 1
    with pytest.raises(InputError, match=rf"part-00001\.parquet: {size - 7} bytes; the manifest says {size}"):
        list(read_frames(shard))
    alone = tmp_path / "alone.parquet"
    alone.write_bytes(shard.read_bytes())
    with pytest.raises(InputError, match=r"alone\.parquet: not readable as Parquet"):
        list(read_frames(alone))
    shard.unlink()
    with pytest.raises(InputError, match=r"part-00001\.parquet: missing"):
        open_dataset(tmp_path)
    assert verify(open_dataset(tmp_path, check_sizes=False)) == [
        "train/part-00001.parquet: missing; the manifest names it"
    ]


def test_verify_finds_strangers_and_other_schemas(tmp_path):
    make_dataset(tmp_path, SHARDS)
    (tmp_path / "train/part-00009.parquet").write_bytes(b"")
    other = tmp_path / "test/part-00000.parquet"
    write(other, [make_frame(3)], note="from another run")
    manifest = json.loads((tmp_path / "manifest.json").read_text())
    digest = hashlib.sha256(other.read_bytes()).hexdigest()
    manifest["shards"][2] |= {"bytes": other.stat().st_size, "sha256": digest}
    manifest["shards"][0]["rows"] = 5
    (tmp_path / "manifest.json").write_text(json.dumps(manifest))
    assert verify(open_dataset(tmp_path)) == [
        "train/part-00000.parquet: 2 rows; the manifest says 5",
        "test/part-00000.parquet: its schema differs from that of the first shard",
        "train/part-00009.parquet: not in the manifest",
    ]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (None, "no such file"),
        ("{", "not readable as JSON"),
        ("[1]", "version = None"),
        ('{"version": 2}', "made by a newer version: version 2; this reads up to 1; upgrade"),
        ('{"version": "1"}', "version = '1'"),
        ('{"version": 1}', "no list of shards"),
        ('{"version": 1, "shards": [{"path": "../x", "rows": 1, "bytes": 1, "sha256": ""}]}', r"shards\.0\.path"),
    ],
)
def test_a_manifest_that_is_not_right_is_refused_in_one_line(tmp_path, text, message):
    if text is not None:
        (tmp_path / "manifest.json").write_text(text)
    with pytest.raises(InputError, match=message) as caught:
        open_dataset(tmp_path)
    assert "manifest.json" in str(caught.value)


def test_a_file_in_place_of_a_dataset_is_said_to_be_one(tmp_path):
    (tmp_path / "data.parquet").write_bytes(b"")
    with pytest.raises(InputError, match=r"data\.parquet: is a file; expected the folder of a finished dataset"):
        open_dataset(tmp_path / "data.parquet")
