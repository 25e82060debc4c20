"""Shards on disk: plans, files, notes, what is left alone; portions of them cut, in order, left over; late poses."""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from factory_command import but_made, shards
from small_dataset import PEAKS, RADAR, make_frame

from datafactory import Report, RunFailed, render
from datafactory.frame.deal import split_of
from datafactory.run import pipeline, portions, progress
from datafactory.run.portions import Engine, Rows
from datafactory.run.progress import FOLDER, handed_over
from datafactory.run.shards import MOST_FRAMES, PATHS, Portion, ShardPlan, plan_shards, portions_of, write_shard
from shared.dataset import arrow_schema, description
from shared.dataset.reading import read_frames
from shared.physics.errors import InputError
from shared.processes.pool import Finished, ThisProcess

SCHEMA = arrow_schema(description(RADAR, PEAKS, "range-channel"))


def begun(directory: Path, resume: bool = False) -> None:
    with progress.claimed(directory, resume):
        progress.begin(directory, {}, resume)


def test_shards_hold_every_frame_once_and_one_split_each():
    plans = plan_shards([split_of(index) for index in range(30)], frames_per_shard=8)
    assert sorted(index for plan in plans for index in plan.frame_ids) == list(range(30))
    assert all(split_of(index) == plan.split for plan in plans for index in plan.frame_ids)
    assert [(plan.path, len(plan.frame_ids)) for plan in plans] == [
        ("train/part-00000.parquet", 8),
        ("train/part-00001.parquet", 8),
        ("train/part-00002.parquet", 8),
        ("validation/part-00000.parquet", 3),
        ("test/part-00000.parquet", 3),
    ]
    with pytest.raises(ValueError, match="split 'dev'"):
        plan_shards(["dev"])


def test_a_shard_is_what_its_record_says_in_the_encoding_that_was_measured(tmp_path):
    """The encoding that the figures in ``shards.py`` are about is the one in the file."""
    path = tmp_path / "train/part-00003.parquet"
    record = write_shard(path, map(make_frame, (4, 5, 6)), SCHEMA)
    content = path.read_bytes()
    assert record.model_dump() == {
        "path": "train/part-00003.parquet",
        "rows": 3,
        "bytes": len(content),
        "sha256": hashlib.sha256(content).hexdigest(),
    }
    assert [frame.frame_id for frame in read_frames(path)] == [4, 5, 6]
    assert pq.read_schema(path).equals(SCHEMA, check_metadata=True)
    metadata = pq.read_metadata(path)
    assert metadata.num_row_groups == 3
    group = metadata.row_group(0)
    columns = {column.path_in_schema: column for column in map(group.column, range(group.num_columns))}
    for name in ("range_channel", "image", "velocity"):
        column = columns[f"{name}.list.element"]
        assert "BYTE_STREAM_SPLIT" in column.encodings
        assert column.compression == "LZ4"
    assert columns["frame_id"].statistics.min == 4


def test_a_shard_counts_as_finished_where_it_and_its_note_are_as_they_were_written(tmp_path):
    begun(tmp_path)
    plans = plan_shards(["train"] * 12, frames_per_shard=3)
    for plan in plans:
        record = write_shard(tmp_path / plan.path, map(make_frame, plan.frame_ids), SCHEMA)
        finished = progress.FinishedShard(record=record, counts={"left_out": 3}, fingerprint="made so")
        progress.record_finished(tmp_path, plan, finished)
    whole, *damaged = plans
    found = progress.completed(tmp_path, plans, "made so")
    assert (set(found.shards), found.damaged) == (set(plans), ())
    assert found.shards[whole].counts == {"left_out": 3}
    flipped = bytearray((tmp_path / damaged[0].path).read_bytes())
    flipped[100] ^= 1
    (tmp_path / damaged[0].path).write_bytes(flipped)
    (tmp_path / damaged[1].path).unlink()
    (tmp_path / ".progress/train-part-00003.json").write_text("{")
    found = progress.completed(tmp_path, plans, "made so")
    assert (set(found.shards), found.damaged) == ({whole}, tuple(plan.path for plan in damaged))
    # Nor does one of other arguments, or of other frames.
    assert progress.completed(tmp_path, [whole], "another").shards == {}
    longer = ShardPlan("train", 0, (0, 1, 2, 3))
    assert progress.completed(tmp_path, [longer], "made so").damaged == (whole.path,)


def test_a_folder_with_something_in_it_is_left_alone(tmp_path):
    (tmp_path / "thesis.tex").write_text("mine")
    with pytest.raises(InputError, match=r"--out: .* is not empty; expected an empty or new folder, or --resume"):
        begun(tmp_path)
    with pytest.raises(InputError, match=r"--out: .* is not empty and holds no unfinished run"):
        begun(tmp_path, resume=True)
    assert [path.name for path in tmp_path.rglob("*") if path.is_file()] == ["thesis.tex"]


def test_a_folder_that_cannot_be_written_is_refused_before_any_work(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match=r"--out: .*Not a directory; expected a folder that can be written"):
        begun(tmp_path / "file" / "out")

    def read_only(dir):
        raise OSError(30, "Read-only file system")

    # Root may write into folders of mode 555, so the file system's answer is played.
    monkeypatch.setattr(tempfile, "TemporaryFile", read_only)
    with pytest.raises(InputError, match=r"--out: .*Read-only file system"):
        begun(tmp_path / "out")


FRAMES = 21
"""In five shards: 8, 8, 1 of training, 2 and 2."""


def made(out: Path, radar_file: Path, **more: object) -> Report:
    return render(None, out, radar=radar_file, frames=0, points=FRAMES, **more)  # type: ignore[arg-type]


def require_same(folder: Path, whole: Path) -> None:
    assert (shards(folder), but_made(folder)) == (shards(whole), but_made(whole))


def cut(monkeypatch: pytest.MonkeyPatch, by: Callable[[Sequence[Portion]], Sequence[Portion]], workers: int) -> None:
    """Have the next runs cut their shards as for so many workers, and deal the portions in another order."""
    monkeypatch.setattr(pipeline, "portions_of", lambda plans, _: by(portions_of(plans, workers)))


@pytest.mark.parametrize(
    ("frames", "workers", "most", "count"),
    [(8, 1, 3, 2 + 2), (8, 2, 2, 7), (16, 16, 1, 16), (64, 4, 8, 29), (18_500, 16, 8, 2403), (1, 64, 1, 1)],
)
def test_frames_are_shared_by_all_workers(frames: int, workers: int, most: int, count: int) -> None:
    """In portions of a shard that are as large as images share their matrices, smaller where frames are few."""
    plans = plan_shards([split_of(frame_id) for frame_id in range(frames)])
    dealt = portions_of(plans, workers)
    assert [frame for portion in dealt for frame in portion.frame_ids] == [
        frame for plan in plans for frame in plan.frame_ids
    ]
    assert max(len(portion.frame_ids) for portion in dealt) == most <= MOST_FRAMES
    assert len(dealt) == count
    left = frames
    for portion in dealt if workers > 1 else ():
        assert len(portion.frame_ids) <= max(left // (2 * workers), 1)
        left -= len(portion.frame_ids)
    assert all(set(portion.frame_ids) <= set(portion.plan.frame_ids) for portion in dealt)
    # 4 and 4 of a shard, not 6 and 2.
    (plan,) = plan_shards([PATHS] * 8)
    sizes = [len(portion.frame_ids) for portion in portions_of([plan] * 5, 3)]
    assert sizes == [4, 4, 4, 4, 4, *[2] * 5, *[1] * 10]


def test_no_byte_depends_on_how_shards_are_cut(
    radar_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made(tmp_path / "whole", radar_file)
    for name, by, workers in (("small", list, 100), ("backwards", lambda dealt: dealt[::-1], 3)):
        with monkeypatch.context() as patch:
            cut(patch, by, workers)
            made(tmp_path / name, radar_file)
        require_same(tmp_path / name, tmp_path / "whole")


def test_rows_wait_in_files_for_the_rest_of_their_shard_alone(
    radar_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out, waiting = tmp_path / "data", list[int]()
    cut(monkeypatch, list, 100)
    monkeypatch.setattr(portions, "record_finished", lambda *_: waiting.append(len(list(out.rglob("*.arrow")))))
    made(out, radar_file)
    assert waiting == [8, 8, 1, 2, 2]


class Deadly(ThisProcess[Portion, Rows]):
    """Nobody survives frame 8."""

    def finished(self, timeout_s: float) -> Iterator[Finished[Portion, Rows]]:
        """As it is, or a failure."""
        if 8 in self._waiting[0].frame_ids:
            yield Finished(self._waiting.pop(), None, "three worker processes died of it, it ended")
        else:
            yield from super().finished(timeout_s)


@pytest.mark.parametrize("keep_going", [False, True])
def test_a_deadly_portion_is_named_and_only_its_shard_is_owed(
    keep_going: bool, radar_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "data"
    with monkeypatch.context() as patch:
        cut(patch, list, 2)
        patch.setattr(Engine, "pool", lambda self, work, count, workers: Deadly(work))
        died = r"^train/part-00000\.parquet, frames 4 to 9: three worker processes died of it, .* --resume, and fewer"
        with pytest.raises(RunFailed, match=died):
            made(out, radar_file, keep_going=keep_going)
    there = sorted(str(path.relative_to(out)) for path in out.glob("*/*.parquet"))
    assert len(there) == (4 if keep_going else 0)
    assert not list(out.rglob("*.arrow"))
    assert made(out, radar_file, resume=True).shards_kept == len(there)
    made(tmp_path / "whole", radar_file)
    require_same(out, tmp_path / "whole")


def test_rows_of_a_run_that_was_killed_are_gone(tmp_path: Path) -> None:
    left = tmp_path / FOLDER / "workers" / "train-0-4711.arrow"
    left.parent.mkdir(parents=True)
    left.write_bytes(b"ARROW1 and no more")
    with handed_over(tmp_path) as folder:
        assert folder == left.parent
        assert list(folder.iterdir()) == []
    assert not folder.exists()
