"""``datafactory inspect`` of sequences: each is a film, in its order, small enough to send."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from datafactory.cli.app import app
from datafactory.inspection import pictures as made
from datafactory.inspection.dataset import summarise
from datafactory.inspection.pictures import LARGEST_BYTES, sequences_of, write_animations
from datafactory.run.shards import plan_shards, write_manifest, write_shard
from shared.dataset import VERSION, Frame, arrow_schema, description
from shared.dataset.folder import Dataset, open_dataset
from shared.radar import ImageGrid, Radar
from shared.radar.arrays import avr_qdm_110
from shared.radar.waveform import Waveform

RADAR = Radar(
    name="small", waveform=Waveform(chirps=2, samples=32, range_bins=24), array=avr_qdm_110(), grid=ImageGrid(bins=64)
)
SEQUENCES = (0, 0, 0, 0, 0, 1, 1, 1, 2, 2, -1)
SPLITS = ("train",) * 8 + ("test",) * 2 + ("train",)


def make_frame(frame_id: int) -> Frame:
    """A point that comes nearer by a range bin a frame."""
    image = np.zeros((24, 64), np.float32)
    image[20 - frame_id, 30] = 1.0
    return Frame(
        frame_id, "scene", "street", 1, (0.0, 0.0, 0.0), (3.0, 4.0, 0.0), (1.0, 0.0, 0.0, 0.0),
        range_channel=np.full((1, 24, 48), 1e-9, np.complex64),
        velocity=np.zeros((1, 24), np.float32),
        image=image,
        image_peak=1e-6,
        noise_power=0.0,
        time=0.25 * frame_id,
        sequence=SEQUENCES[frame_id],
    )  # fmt: skip


@pytest.fixture
def dataset(tmp_path: Path) -> Dataset:
    schema = arrow_schema(description(RADAR, 1, "range-channel"))
    shards = [
        write_shard(tmp_path / "data" / plan.path, map(make_frame, plan.frame_ids), schema)
        for plan in plan_shards(SPLITS, frames_per_shard=4)
    ]
    write_manifest(tmp_path / "data", {"version": VERSION, "shards": [record.model_dump() for record in shards]})
    return open_dataset(tmp_path / "data")


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
    result = CliRunner().invoke(app, ["inspect", str(dataset.path), "--frames", "1"], catch_exceptions=False)
    assert result.exit_code == 0
    assert "sequence-0000.gif" in result.output
    assert "sequences" in result.output
