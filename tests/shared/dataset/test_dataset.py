"""The dataset format: bit-for-bit round trips, readers that are not ours, and files that are not as they should be."""

import dataclasses
import hashlib
import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from shared.dataset import Box, Frame, Target, arrow_schema, description, row_bytes, to_record_batch
from shared.dataset.folder import open_dataset, verify
from shared.dataset.reading import radar_of, read_description, read_frame, read_frames
from shared.physics.errors import InputError
from shared.radar import ImageGrid, Radar, load_radar
from shared.radar.arrays import AntennaArray, line
from shared.radar.waveform import Waveform
from shared.signal.imaging import delay_and_sum

ROWS, BINS, CHIRPS, SAMPLES, PEAKS, RX = 6, 20, 4, 8, 3, 4
RADAR = Radar(
    waveform=Waveform(chirps=CHIRPS, samples=SAMPLES, range_bins=ROWS),
    array=AntennaArray(tx_m=line(np.array([0.0, 2e-3])), rx_m=line(4e-3 * np.arange(RX))),
    grid=ImageGrid(u_start=-0.5, u_stop=0.5, bins=BINS),
    virtual_sensor=AntennaArray(tx_m=line(np.zeros(1)), rx_m=line(2e-3 * np.arange(8))),
)
CHANNELS = RADAR.array.channels


def make_frame(frame_id: int, store: str = "range-channel") -> Frame:
    generator = np.random.default_rng(frame_id)

    def real(*shape: int) -> np.ndarray:
        return generator.standard_normal(shape).astype(np.float32)

    def signal(*shape: int) -> np.ndarray:
        return (real(*shape) + 1j * real(*shape)).astype(np.complex64)

    return Frame(
        frame_id=frame_id,
        kind="scene" if frame_id % 2 else "points",
        scene="street é",
        seed=2**62 + frame_id,
        sensor_position=(1.0, -2.0, 0.1),
        sensor_velocity=(10.0, 0.0, 1 / 3),
        sensor_orientation=(1.0, 0.0, 0.0, 0.0),
        range_channel=signal(PEAKS, ROWS, CHANNELS),
        velocity=real(PEAKS, ROWS),
        image=np.abs(real(ROWS, BINS)),
        image_peak=1e-7 / 3,
        noise_power=1e-16 / 3,
        targets=tuple(Target(float(k), 0.1 * k, -1.0 / 3, -90.0 - k, "car" * (k % 2)) for k in range(frame_id % 4)),
        boxes=tuple(
            Box((9.0, k / 3, 0.1), (4.5, 1.8, 1.5), -k / 3, (-1.0, 0.0, k / 7), "car", f"Größe {k}", 1e-15 * k)
            for k in range(frame_id % 3)
        ),
        range_doppler=np.abs(real(ROWS, CHIRPS)) if store == "range-doppler" else None,
        cube=signal(CHIRPS, SAMPLES, CHANNELS) if store == "cube" else None,
    )


def write(path: Path, frames: list[Frame], store: str = "range-channel", rows_per_group: int = 1, **extra) -> None:
    schema = arrow_schema(description(RADAR, PEAKS, store, extra))
    path.parent.mkdir(exist_ok=True, parents=True)
    table = pa.Table.from_batches([to_record_batch(frames, schema)])
    pq.write_table(table, path, row_group_size=rows_per_group)


def assert_same(left: Frame, right: Frame) -> None:
    for field in dataclasses.fields(Frame):
        one, other = getattr(left, field.name), getattr(right, field.name)
        if isinstance(one, np.ndarray):
            assert one.dtype == other.dtype, field.name
            assert one.shape == other.shape, field.name
            assert one.tobytes() == other.tobytes(), field.name
        else:
            assert one == other, field.name


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


FLOATS = st.floats(width=32, allow_nan=False, allow_infinity=False)


@settings(max_examples=30, deadline=None)
@given(data=st.data(), rows=st.integers(1, 4), bins=st.integers(1, 4), peaks=st.integers(1, 3), rx=st.integers(1, 3))
def test_any_finite_float_of_any_shape_survives(tmp_path_factory, data, rows, bins, peaks, rx):
    radar = Radar(
        waveform=Waveform(chirps=2, samples=4, range_bins=rows),
        array=AntennaArray(tx_m=line(np.zeros(1)), rx_m=line(2e-3 * np.arange(rx))),
        grid=ImageGrid(bins=bins),
    )
    pairs = data.draw(arrays(np.float32, (peaks, rows, rx, 2), elements=FLOATS))
    frame = dataclasses.replace(
        make_frame(3),
        range_channel=pairs.view(np.complex64)[..., 0],
        velocity=data.draw(arrays(np.float32, (peaks, rows), elements=FLOATS)),
        image=data.draw(arrays(np.float32, (rows, bins), elements=FLOATS)),
    )
    path = tmp_path_factory.mktemp("any") / "shard.parquet"
    schema = arrow_schema(description(radar, peaks, "range-channel"))
    pq.write_table(pa.Table.from_batches([to_record_batch([frame], schema)]), path)
    (back,) = read_frames(path)
    assert_same(frame, back)


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


def test_frames_of_an_older_dataset_do_not_say_when_they_are(tmp_path):
    frame = dataclasses.replace(make_frame(1), time=2.5, sequence=7)
    write(tmp_path / "new.parquet", [frame])
    (back,) = read_frames(tmp_path / "new.parquet")
    assert (back.time, back.sequence) == (2.5, 7)
    table = pq.read_table(tmp_path / "new.parquet")
    pq.write_table(table.drop_columns(["time", "sequence"]), tmp_path / "old.parquet")
    (old,) = read_frames(tmp_path / "old.parquet")
    assert np.isnan(old.time)
    assert old.sequence == -1
    assert_same(dataclasses.replace(old, time=2.5, sequence=7), frame)


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


def test_a_shard_made_before_there_were_boxes_has_none(tmp_path):
    """The column came later, without a new version: everything else is read as it is."""
    frames, path = [make_frame(index) for index in range(3)], tmp_path / "shard.parquet"
    write(path, frames)
    table = pq.read_table(path)
    pq.write_table(table.drop_columns(["boxes"]), path, row_group_size=1)
    for back, frame in zip(read_frames(path), frames, strict=True):
        assert_same(back, dataclasses.replace(frame, boxes=()))
    assert read_frame(path, 2, columns=["image", "boxes"]).boxes == ()


def test_row_bytes_is_what_arrow_holds():
    frame = make_frame(0, "cube")
    assert frame.cube is not None
    expected = frame.range_channel.nbytes + frame.velocity.nbytes + frame.image.nbytes + frame.cube.nbytes
    shapes = description(RADAR, PEAKS, "cube")["shapes"]
    assert row_bytes(shapes) == expected
    assert row_bytes(shapes, ["image", "scene"]) == frame.image.nbytes


@pytest.mark.parametrize("radar", [RADAR, load_radar("avr-qdm-110"), load_radar("avr-qdm-110-virtual")], ids=str)
def test_the_radar_can_be_had_back_from_the_description(radar):
    assert radar_of(json.loads(json.dumps(description(radar, PEAKS, "range-channel")))) == radar


def test_description_keeps_what_is_added_but_lets_nothing_be_replaced(tmp_path):
    write(tmp_path / "shard.parquet", [make_frame(0)], truth_window="hann")
    assert read_description(tmp_path / "shard.parquet")["truth_window"] == "hann"
    with pytest.raises(ValueError, match="'radar'"):
        description(RADAR, PEAKS, "range-channel", {"radar": {}})
    with pytest.raises(InputError, match=r"--store: 'all'.*'cube'"):
        description(RADAR, PEAKS, "all")


def _polars(path):
    polars = pytest.importorskip("polars")
    column = polars.read_parquet(path)["range_channel"][0]
    return np.array(column), polars.read_parquet_metadata(path)["sparseradar"]


def _duckdb(path):
    with pytest.importorskip("duckdb").connect() as connection:
        ((column,),) = connection.execute(f"select range_channel from '{path}'").fetchall()
        query = f"select decode(value) from parquet_kv_metadata('{path}') where decode(key) = 'sparseradar'"
        ((text,),) = connection.execute(query).fetchall()
    return np.array(column), text


def _pandas(path):
    pandas = pytest.importorskip("pandas")
    return np.array(pandas.read_parquet(path)["range_channel"][0]), pq.read_schema(path).metadata[b"sparseradar"]


@pytest.mark.parametrize("reader", [_polars, _duckdb, _pandas])
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


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"image": np.zeros((ROWS, BINS + 1), np.float32)},
            r"frame 1: image is float32 \[6, 21\]; expected.*\[6, 20\]",
        ),
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


def make_dataset(folder: Path) -> Path:
    shards = []
    for name, ids in {"train/part-00000": (0, 1), "train/part-00001": (2,), "test/part-00000": (3,)}.items():
        path = folder / f"{name}.parquet"
        write(path, [make_frame(index) for index in ids])
        content = path.read_bytes()
        digest = hashlib.sha256(content).hexdigest()
        shards.append({"path": f"{name}.parquet", "rows": len(ids), "bytes": len(content), "sha256": digest})
    (folder / "manifest.json").write_text(json.dumps({"version": 1, "shards": shards}))
    return folder


def make_traced(folder: Path) -> Path:
    """What ``datafactory trace`` leaves: shards of paths and no frames."""
    path = folder / "paths" / "part-00000.parquet"
    path.parent.mkdir(parents=True)
    pq.write_table(pa.table({"frame_id": [0, 1]}), path)
    content = path.read_bytes()
    digest = hashlib.sha256(content).hexdigest()
    shards = [{"path": "paths/part-00000.parquet", "rows": 2, "bytes": len(content), "sha256": digest}]
    (folder / "manifest.json").write_text(json.dumps({"version": 1, "shards": shards}))
    return folder


def edit_manifest(folder: Path, **changes) -> None:
    manifest = json.loads((folder / "manifest.json").read_text()) | changes
    (folder / "manifest.json").write_text(json.dumps(manifest))


def test_a_folder_of_traced_paths_is_verified_and_says_that_it_holds_no_frames(tmp_path):
    dataset = open_dataset(make_traced(tmp_path))
    assert dataset.splits == {}
    assert verify(dataset) == []
    expected = "holds traced paths and no frames; expected a dataset, as made by datafactory render --paths"
    for ask in (dataset.description, lambda: dataset.shards("test"), lambda: dataset.rows("train")):
        with pytest.raises(InputError, match=expected):
            ask()


def test_a_dataset_is_read_split_by_split(tmp_path):
    dataset = open_dataset(make_dataset(tmp_path))
    assert [frame.frame_id for frame in dataset.frames("train")] == [0, 1, 2]
    assert [read_frame(*place).frame_id for place in dataset.rows("train")] == [0, 1, 2]
    assert list(dataset.splits) == ["train", "test"]
    assert verify(dataset) == []
    with pytest.raises(InputError, match=r"no frames in split 'validation'; expected one of \['train', 'test'\]"):
        next(dataset.frames("validation"))


def test_verify_finds_one_flipped_bit_anywhere(tmp_path):
    shard = make_dataset(tmp_path) / "train/part-00001.parquet"
    content = shard.read_bytes()
    for place in np.linspace(0, len(content) - 1, 9).astype(int):
        damaged = bytearray(content)
        damaged[place] ^= 1
        shard.write_bytes(damaged)
        (fault,) = verify(open_dataset(tmp_path))
        assert fault.startswith("train/part-00001.parquet: sha256 is ")


def test_a_truncated_or_missing_shard_is_named(tmp_path):
    shard = make_dataset(tmp_path) / "train/part-00001.parquet"
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
    make_dataset(tmp_path)
    (tmp_path / "train/part-00009.parquet").write_bytes(b"")
    other = tmp_path / "test/part-00000.parquet"
    write(other, [make_frame(3)], note="from another run")
    manifest = json.loads((tmp_path / "manifest.json").read_text())
    digest = hashlib.sha256(other.read_bytes()).hexdigest()
    manifest["shards"][2] |= {"bytes": other.stat().st_size, "sha256": digest}
    manifest["shards"][0]["rows"] = 5
    edit_manifest(tmp_path, **manifest)
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
        (
            '{"version": 1, "shards": [{"path": "../x.parquet", "rows": 1, "bytes": 1, "sha256": ""}]}',
            r"shards\.0\.path",
        ),
    ],
)
def test_a_manifest_that_is_not_right_is_refused_in_one_line(tmp_path, text, message):
    if text is not None:
        (tmp_path / "manifest.json").write_text(text)
    with pytest.raises(InputError, match=message) as caught:
        open_dataset(tmp_path)
    assert "manifest.json" in str(caught.value)
    assert "\n" not in str(caught.value)


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


def test_radar_of_something_else_is_refused():
    about = description(RADAR, PEAKS, "range-channel")
    with pytest.raises(InputError, match=r"x\.parquet: no whole radar in the metadata: KeyError\('axes'\)"):
        radar_of({"radar": about["radar"]}, "x.parquet")
    with pytest.raises(InputError, match=r"x\.parquet: waveform\.chirps = 0"):
        radar_of(about | {"radar": about["radar"] | {"chirps": 0}}, "x.parquet")
