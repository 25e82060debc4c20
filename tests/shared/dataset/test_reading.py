"""Shards read back: in part, by readers that are not ours, of older and newer versions, and damaged."""

import dataclasses
import json

import numpy as np
import pyarrow.parquet as pq
import pytest
from small_dataset import BINS, CHANNELS, PEAKS, RADAR, ROWS, assert_same, make_frame, write

from shared.dataset import description
from shared.dataset.reading import radar_of, read_frame, read_frames
from shared.physics.errors import InputError
from shared.radar import load_radar
from shared.signal.imaging import delay_and_sum


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
