"""Shards on disk: plans, complete files only, and a killed run that ends in the same bytes."""

import hashlib
import tempfile
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from small_dataset import PEAKS, RADAR, make_frame

from datafactory.frame.index import split_of
from datafactory.run import progress
from datafactory.run.shards import ShardPlan, plan_shards, write_shard
from shared.dataset import arrow_schema, description
from shared.dataset.reading import read_frames
from shared.physics.errors import InputError

SCHEMA = arrow_schema(description(RADAR, PEAKS, "range-channel"))
ARGUMENTS = {"scene": ["sionna:munich"], "frames": 20, "seed": 7, "budget": -30.0}


def make_dataset(directory: Path, resume: bool = False, arguments: dict = ARGUMENTS, stop_after: int = 99) -> list[str]:
    """A pipeline in small; returns the paths of the shards that it wrote. Stops like a killed run, in mid-shard."""
    with progress.claimed(directory, resume):
        return make_claimed(directory, resume, arguments, stop_after)


def make_claimed(directory: Path, resume: bool, arguments: dict, stop_after: int) -> list[str]:
    if progress.begin(directory, arguments, resume):
        return []
    mark = progress.fingerprint(arguments)
    plans = plan_shards([split_of(index) for index in range(arguments["frames"])], frames_per_shard=4)
    done = progress.completed(directory, plans, mark).shards
    written = list[str]()
    for plan in plans:
        if plan in done:
            continue
        if len(written) == stop_after:
            partial = (directory / plan.path).with_name("part-00099.parquet.partial")
            partial.parent.mkdir(exist_ok=True)
            partial.write_bytes(b"PAR1 and no more")
            return written
        record = write_shard(directory / plan.path, map(make_frame, plan.frame_ids), SCHEMA)
        done[plan] = progress.FinishedShard(record=record, counts={"left_out": record.rows}, fingerprint=mark)
        progress.record_finished(directory, plan, done[plan])
        written.append(plan.path)
    manifest = {
        "version": 1,
        "arguments": arguments,
        "counts": {"left_out": sum(done[plan].counts["left_out"] for plan in plans)},
        "shards": [done[plan].record.model_dump() for plan in plans],
    }
    progress.finish(directory, manifest)
    return written


def contents(directory: Path) -> dict[str, bytes]:
    files = (path for path in directory.rglob("*") if path.is_file())
    return {path.relative_to(directory).as_posix(): path.read_bytes() for path in files}


def test_shards_hold_every_frame_once_and_one_split_each():
    splits = [split_of(index) for index in range(30)]
    plans = plan_shards(splits, frames_per_shard=8)
    assert sorted(index for plan in plans for index in plan.frame_ids) == list(range(30))
    assert all(splits[index] == plan.split for plan in plans for index in plan.frame_ids)
    assert all(list(plan.frame_ids) == sorted(plan.frame_ids) for plan in plans)
    assert [(plan.path, len(plan.frame_ids)) for plan in plans] == [
        ("train/part-00000.parquet", 8),
        ("train/part-00001.parquet", 8),
        ("train/part-00002.parquet", 8),
        ("validation/part-00000.parquet", 3),
        ("test/part-00000.parquet", 3),
    ]
    assert plan_shards([]) == ()
    with pytest.raises(ValueError, match="split 'dev'"):
        plan_shards(["dev"])


def test_a_shard_is_what_its_record_says(tmp_path):
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
    assert pq.read_metadata(path).num_row_groups == 3
    assert pq.read_schema(path).equals(SCHEMA, check_metadata=True)


def test_a_finished_dataset_is_not_made_again(tmp_path):
    make_dataset(tmp_path)
    before = contents(tmp_path)
    assert make_dataset(tmp_path, resume=True) == []
    assert contents(tmp_path) == before
    with pytest.raises(InputError, match=r"--resume: seed is 8, but the run in .* had 7"):
        make_dataset(tmp_path, resume=True, arguments=ARGUMENTS | {"seed": 8})


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"seed": 8}, "seed is 8, but the run in .* had 7"),
        ({"budget": -40.0}, r"budget is -40\.0, but .* had -30\.0"),
        ({"radar": "x.toml"}, r"radar is 'x\.toml', but .* had nothing"),
    ],
)
def test_a_resume_with_other_arguments_is_refused(tmp_path, changes, message):
    make_dataset(tmp_path, stop_after=2)
    before = contents(tmp_path)
    with pytest.raises(InputError, match=f"--resume: {message}"):
        make_dataset(tmp_path, resume=True, arguments=ARGUMENTS | changes)
    assert contents(tmp_path) == before


def test_finished_shards_that_changed_are_made_again(tmp_path):
    first = make_dataset(tmp_path / "resumed", stop_after=3)
    flipped = bytearray((tmp_path / "resumed" / first[0]).read_bytes())
    flipped[100] ^= 1
    (tmp_path / "resumed" / first[0]).write_bytes(flipped)
    (tmp_path / "resumed" / first[1]).unlink()
    (tmp_path / "resumed/.progress/train-part-00002.json").write_text("{")
    plans = plan_shards([split_of(index) for index in range(20)], frames_per_shard=4)
    found = progress.completed(tmp_path / "resumed", plans, progress.fingerprint(ARGUMENTS))
    assert found == progress.Progress({}, tuple(first))
    make_dataset(tmp_path / "resumed", resume=True)
    make_dataset(tmp_path / "whole")
    assert contents(tmp_path / "resumed") == contents(tmp_path / "whole")


def test_a_record_of_other_arguments_does_not_count(tmp_path):
    make_dataset(tmp_path, stop_after=1)
    plan = ShardPlan("train", 0, (0, 1, 2, 3))
    assert plan in progress.completed(tmp_path, [plan], progress.fingerprint(ARGUMENTS)).shards
    assert progress.completed(tmp_path, [plan], "another").shards == {}
    longer = ShardPlan("train", 0, (0, 1, 2, 3, 4))
    assert progress.completed(tmp_path, [longer], progress.fingerprint(ARGUMENTS)).damaged == (plan.path,)


def test_a_folder_with_something_in_it_is_left_alone(tmp_path):
    (tmp_path / "thesis.tex").write_text("mine")
    with pytest.raises(InputError, match=r"--out: .* is not empty; expected an empty or new folder, or --resume"):
        make_dataset(tmp_path)
    with pytest.raises(InputError, match=r"--out: .* is not empty and holds no unfinished run"):
        make_dataset(tmp_path, resume=True)
    assert contents(tmp_path) == {"thesis.tex": b"mine"}


def test_a_folder_that_cannot_be_written_is_refused_before_any_work(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match=r"--out: .*Not a directory; expected a folder that can be written"):
        make_dataset(tmp_path / "file" / "out")

    def read_only(dir):
        raise OSError(30, "Read-only file system")

    # Root may write into folders of mode 555, so the file system's answer is played.
    monkeypatch.setattr(tempfile, "TemporaryFile", read_only)
    with pytest.raises(InputError, match=r"--out: .*Read-only file system"):
        make_dataset(tmp_path / "out")


def test_the_encoding_is_the_one_that_was_measured(tmp_path):
    """The encoding that the figures in ``shards.py`` are about is the one in the file."""
    path = tmp_path / "train/part-00000.parquet"
    write_shard(path, [make_frame(0)], SCHEMA)
    group = pq.read_metadata(path).row_group(0)
    columns = {column.path_in_schema: column for column in map(group.column, range(group.num_columns))}
    for name in ("range_channel", "image", "velocity"):
        column = columns[f"{name}.list.element"]
        assert "BYTE_STREAM_SPLIT" in column.encodings
        assert column.compression == "LZ4"
    assert columns["frame_id"].statistics.min == 0
