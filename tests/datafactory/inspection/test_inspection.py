"""``datafactory inspect``: the numbers are the dataset's, pictures show targets where they are, sequences are films."""

import dataclasses
import json
from itertools import pairwise
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from matplotlib.collections import QuadMesh
from matplotlib.image import imread
from PIL import Image
from s3_server import SECRET
from typer.testing import CliRunner

from datafactory.cli.app import app
from datafactory.frame.draws import split_of
from datafactory.inspection import pictures as made
from datafactory.inspection.dataset import summarise
from datafactory.inspection.pictures import LARGEST_BYTES, draw_frame, sequences_of, write_animations, write_pictures
from datafactory.run.shards import plan_shards, write_shard, write_tables
from shared.dataset import VERSION, Box, Frame, Target, arrow_schema, description
from shared.dataset.folder import Dataset, open_dataset
from shared.dataset.manifest import write_manifest
from shared.physics.errors import InputError
from shared.pictures import SPAN_DB
from shared.radar import ImageGrid, Radar, load_radar
from shared.radar.arrays import avr_qdm_110
from shared.radar.waveform import Waveform
from shared.signal.imaging import steering_matrix

RADAR = Radar(
    name="small", waveform=Waveform(chirps=2, samples=32, range_bins=24), array=avr_qdm_110(), grid=ImageGrid(bins=64)
)
ROW, COLUMN, AMPLITUDE = 15, 40, 1e-6


def make_frame(frame_id: int, targets: bool = True) -> Frame:
    """One target in the middle of a cell; its input has the phases of eq. (2) for plane waves."""
    range_m, u = float(RADAR.waveform.ranges_m[ROW]), float(RADAR.grid.u[COLUMN])
    signal = np.full((1, 24, 48), 1e-12, np.complex64)
    signal[0, ROW] = AMPLITUDE * steering_matrix(RADAR, RADAR.array)[:, COLUMN].conj()
    image = np.zeros((24, 64), np.float32)
    image[ROW, COLUMN] = 1.0
    return Frame(
        frame_id, "scene" if frame_id % 2 else "points", f"street [{frame_id % 3}]", 1,
        (0.0, 0.0, 0.0), (3.0, 4.0, 0.0), (1.0, 0.0, 0.0, 0.0),
        range_channel=signal,
        velocity=np.zeros((1, 24), np.float32),
        image=image if targets else 0.0 * image,
        image_peak=AMPLITUDE if targets else 0.0,
        noise_power=0.0,
        targets=(Target(range_m, u, 0.0, -120.0, "car"), Target(2.0, -0.5, 0.0, -150.0)) if targets else (),
    )  # fmt: skip


def written(folder, splits, make, **manifest):
    """A dataset of these frames in shards of four."""
    schema = arrow_schema(description(RADAR, 1, "range-channel"))
    plans = plan_shards(splits, frames_per_shard=4)
    shards = [write_shard(folder / plan.path, map(make, plan.frame_ids), schema) for plan in plans]
    write_manifest(folder, {"version": VERSION, **manifest, "shards": [record.model_dump() for record in shards]})
    return folder


@pytest.fixture
def directory(tmp_path):
    splits = [split_of(index) for index in range(9)]
    return written(tmp_path / "data", splits, make_frame, counts={"targets left out [dB]": 7})


def run(*arguments):
    return CliRunner().invoke(app, ["inspect", *map(str, arguments)])


def test_the_summary_counts_every_frame_once(directory):
    summary = summarise(open_dataset(directory))
    assert summary.frames == {"train": {"points": 4, "scene": 3}, "validation": {"points": 1}, "test": {"scene": 1}}
    assert summary.scenes == {"street [0]": 3, "street [1]": 3, "street [2]": 3}
    assert (summary.radar, summary.shards) == ("small", 4)
    assert summary.bytes == sum(path.stat().st_size for path in directory.rglob("*.parquet"))
    assert summary.counts == {"targets left out [dB]": 7}


def panels(figure):
    """Title to level of the image panels, without the top view and the colour bar."""
    return {axis.get_title(): axis.images[0] for axis in figure.axes if axis.images}


def test_every_array_and_the_truth_peak_at_the_target():
    images = panels(draw_frame(make_frame(1), RADAR))
    assert list(images) == ["16 RX", "6 RX (sparse6)", "4 RX (sparse4)", "truth"]
    for image in images.values():
        level = image.get_array()[:, ::-1]
        assert np.unravel_index(level.argmax(), level.shape) == (ROW, COLUMN)
        # One scale for all: the target reads the same, 0 dB, in each.
        assert level.max() == pytest.approx(0.0, abs=1e-4)
        assert (image.norm.vmin, image.norm.vmax) == (-SPAN_DB, 0.0)


def test_the_view_from_above_has_the_truth_and_a_ring_round_the_object():
    frame = make_frame(1)
    (axis,) = (axis for axis in draw_frame(frame, RADAR).axes if axis.get_title().endswith("from above"))
    truth, objects = axis.collections
    assert isinstance(truth, QuadMesh)
    ((y, x),) = np.asarray(objects.get_offsets(), dtype=float)
    assert (np.hypot(x, y), y) == pytest.approx(
        (frame.targets[0].range_m, frame.targets[0].range_m * frame.targets[0].u)
    )
    ((row, column),) = np.argwhere(np.asarray(truth.get_array()) > -1.0)
    corners = np.asarray(truth.get_coordinates())[row : row + 2, column : column + 2].reshape(4, 2)
    np.testing.assert_allclose(corners.mean(axis=0), (y, x), atol=0.02)


def test_boxes_are_drawn_over_every_image_and_from_above():
    """At the places of their corners; dotted where the radar does not see the object."""
    range_m, u = float(RADAR.waveform.ranges_m[ROW]), 0.2
    x, y = range_m * np.sqrt(1.0 - u**2), range_m * u
    seen = Box((x, y, 0.0), (0.8, 0.4, 1.0), 0.0, (0.0, 0.0, 0.0), "car", "a", 1e-12)
    hidden = dataclasses.replace(seen, center=(x, -y, 0.0), object="b", power=0.0)
    figure = draw_frame(dataclasses.replace(make_frame(1), boxes=(seen, hidden)), RADAR)
    corner = np.array([x + 0.4, y + 0.2])
    for axis in (axis for axis in figure.axes if axis.images and len(axis.lines)):
        first, second = axis.lines
        assert (first.get_linestyle(), second.get_linestyle()) == ("-", ":")
        place = np.array([corner[1] / np.hypot(*corner), np.hypot(*corner)])
        drawn = np.asarray(first.get_xydata(), dtype=float)
        np.testing.assert_allclose(drawn[[0, -1]], [place, place], rtol=1e-12)
    assert sum(len(axis.lines) == 2 for axis in figure.axes) == 4
    (above,) = (axis for axis in figure.axes if axis.get_title().endswith("from above"))
    assert [patch.get_linestyle() for patch in above.patches] == ["-", ":"]
    np.testing.assert_allclose(np.asarray(above.patches[0].get_path().vertices, dtype=float)[0], corner[::-1])


def test_an_array_that_is_not_the_papers_is_drawn_without_thinned_ones():
    radar = load_radar("avr-qdm-110-virtual").model_copy(
        update={"waveform": RADAR.waveform, "grid": RADAR.grid},
    )
    frame = dataclasses.replace(make_frame(1), range_channel=np.ones((1, 24, 256), np.complex64))
    assert list(panels(draw_frame(frame, radar))) == ["256 RX", "truth"]


def test_an_empty_frame_can_be_drawn(tmp_path):
    draw_frame(make_frame(1, targets=False), RADAR).savefig(tmp_path / "empty.png")
    assert imread(tmp_path / "empty.png").ndim == 3


def test_pictures_are_spread_over_the_dataset_and_the_same_each_time(directory, tmp_path):
    dataset = open_dataset(directory)
    first = write_pictures(dataset, 3, tmp_path / "one")
    assert [path.name for path in first] == ["frame-000000.png", "frame-000004.png", "frame-000007.png"]
    again = write_pictures(dataset, 1, tmp_path / "two")
    assert [path.name for path in again] == ["frame-000000.png"]
    assert first[0].read_bytes() == again[0].read_bytes()
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match=r"--out: .*expected a folder that can be written"):
        write_pictures(dataset, 1, tmp_path / "file" / "pictures")


def test_the_command_prints_the_numbers_and_draws(directory, tmp_path):
    result = run(directory, "--verify", "--frames", 1, "--out", tmp_path / "pictures")
    assert result.exit_code == 0, result.output
    for part in ("4 shards are as they were written", "street [2]", "24 x 64", "targets left out [dB]", "small"):
        assert part in result.output
    assert [path.name for path in (tmp_path / "pictures").iterdir()] == ["frame-000000.png"]
    assert run(directory, "--frames", 0).exit_code == 0
    assert not (directory / "pictures").exists()


def test_a_remote_dataset_is_read_and_its_pictures_stay_here(directory, tmp_path, monkeypatch, server):
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    result = run(server.upload(directory, f"{tmp_path.name}/data"), "--verify", "--frames", 1)
    assert result.exit_code == 0, result.output
    assert "4 shards are as they were written" in result.output
    assert "its pictures go to data-pictures, or to the folder that --out names" in result.output
    assert SECRET not in result.output
    assert [path.name for path in (tmp_path / "here" / "data-pictures").iterdir()] == ["frame-000000.png"]
    assert server.keys(f"{tmp_path.name}/data/pictures") == []


def test_a_folder_of_traced_paths_is_summarised(tmp_path):
    rows = [pa.Table.from_pylist([{"frame_id": index}]) for index in range(3)]
    record = write_tables(tmp_path / "paths" / "part-00000.parquet", rows, rows[0].schema, compression="zstd")
    write_manifest(tmp_path, {"version": 1, "counts": {"rays": 5}, "shards": [record.model_dump()]})
    result = run(tmp_path, "--verify")
    assert result.exit_code == 0, result.output
    for part in ("1 shards are as they were written", "frames of traced paths │ 3", "count: rays"):
        assert part in result.output
    assert not (tmp_path / "pictures").exists()


def test_verify_names_the_damaged_shard_and_exits_with_1(directory):
    shard = directory / "train/part-00001.parquet"
    content = bytearray(shard.read_bytes())
    content[len(content) // 2] ^= 4
    shard.write_bytes(content)
    result = run(directory, "--verify", "--frames", 0)
    assert result.exit_code == 1
    assert "train/part-00001.parquet: sha256 is " in result.output
    assert "train/part-00000.parquet" not in result.output


def test_bad_datasets_are_input_errors_not_tracebacks(directory):
    result = run(directory / "nothing")
    assert isinstance(result.exception, InputError)
    manifest = json.loads((directory / "manifest.json").read_text())
    (directory / "manifest.json").write_text(json.dumps(manifest | {"counts": [1]}))
    assert isinstance(run(directory).exception, InputError)


FILMED = (0, 0, 0, 0, 0, 1, 1, 1, 2, 2, -1)
SPLITS = ("train",) * 8 + ("test",) * 2 + ("train",)


def filmed_frame(frame_id: int) -> Frame:
    """A point that comes nearer by a range bin a frame."""
    image = np.zeros((24, 64), np.float32)
    image[20 - frame_id, 30] = 1.0
    frame = dataclasses.replace(make_frame(frame_id), kind="scene", image=image)
    return dataclasses.replace(frame, time=0.25 * frame_id, sequence=FILMED[frame_id])


@pytest.fixture
def dataset(tmp_path: Path) -> Dataset:
    return open_dataset(written(tmp_path / "data", SPLITS, filmed_frame))


def pictures(path: Path) -> list[np.ndarray]:
    with Image.open(path) as film:
        found = []
        for number in range(getattr(film, "n_frames", 1)):
            film.seek(number)
            found.append(np.asarray(film.convert("RGB")))
        return found


def test_sequences_are_found_with_their_split_and_in_order(dataset: Dataset) -> None:
    found = sequences_of(dataset)
    assert [(item.number, item.split, len(item.rows)) for item in found] == [
        (0, "train", 5), (1, "train", 3), (2, "test", 2),
    ]  # fmt: skip
    assert summarise(dataset).sequences == 3


def test_a_film_has_a_picture_for_each_frame_and_the_first_of_each_split_come_first(
    dataset: Dataset, tmp_path: Path
) -> None:
    (tmp_path / "films").mkdir()
    paths = write_animations(dataset, 2, tmp_path / "films")
    assert [path.name for path in paths] == ["sequence-0000.gif", "sequence-0002.gif"]
    shown = pictures(paths[0])
    assert len(shown) == 5
    assert all(np.abs(one.astype(int) - other).max() > 50 for one, other in pairwise(shown))
    assert max(path.stat().st_size for path in paths) < LARGEST_BYTES
    with Image.open(paths[0]) as film:
        assert film.info["duration"] == 250  # as fast as it was: four a second


def test_a_film_that_is_too_large_leaves_pictures_out(
    dataset: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "films").mkdir()
    (whole,) = write_animations(dataset, 1, tmp_path / "films")
    monkeypatch.setattr(made, "LARGEST_BYTES", whole.stat().st_size)
    (shorter,) = write_animations(dataset, 1, tmp_path / "films")
    assert len(pictures(shorter)) == 3
    monkeypatch.setattr(made, "MOST_PICTURES", 2)
    (strides,) = write_animations(dataset, 1, tmp_path / "films")
    assert len(pictures(strides)) == 2


def test_the_command_says_what_it_wrote(dataset: Dataset) -> None:
    result = run(dataset.path, "--frames", 1)
    assert result.exit_code == 0, result.output
    assert "sequence-0000.gif" in result.output
    assert "sequences" in result.output
