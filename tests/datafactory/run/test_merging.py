"""Jobs of an array: which shards are whose, how they become the run in one piece, and what is refused."""

import json
import os
import shutil
from pathlib import Path
from typing import Any

import pytest
from factory_command import but_made, frames_of, refused, run, shards
from hypothesis import given
from hypothesis import strategies as st
from small_radar import SMALL_RADAR
from typer.testing import CliRunner

import datafactory
from datafactory.cli.app import app
from datafactory.frame.draws import split_of
from datafactory.run import merging
from datafactory.run.merging import ranges
from datafactory.run.shards import PATHS, ArrayJob, JobEntry, is_job_folder, parse_job, plan_shards
from shared.dataset.documents import read_json, sealed, unsealed
from shared.dataset.folder import open_dataset, read_manifest, verify
from shared.dataset.locations import sha256_of
from shared.physics.errors import InputError

JOBS = 3


def points(out: Path, radar_file: Path, *more: object) -> str:
    return run("points", "--frames", 40, "--split", "2:1:1", "--radar", radar_file, "--out", out, "--workers", 1, *more)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory, radar_file: Path) -> Path:
    out = tmp_path_factory.mktemp("whole") / "data"
    points(out, radar_file)
    return out


@pytest.fixture(scope="module")
def made_once(tmp_path_factory: pytest.TempPathFactory, radar_file: Path) -> Path:
    out = tmp_path_factory.mktemp("jobs")
    for number in range(JOBS):
        points(out, radar_file, "--shard", f"{number}/{JOBS}")
    return out


@pytest.fixture
def jobs(made_once: Path, tmp_path: Path) -> Path:
    """A copy that a test may damage."""
    return Path(shutil.copytree(made_once, tmp_path / "jobs"))


def require_same(merged: Path, whole: Path) -> None:
    """Shards and manifest, but for ``made``, and card byte for byte; nothing beside them."""
    assert shards(merged) == shards(whole)
    assert json.dumps(but_made(merged)) == json.dumps(but_made(whole))
    assert (merged / "README.md").read_bytes() == (whole / "README.md").read_bytes()
    assert verify(open_dataset(merged)) == []
    assert sorted(path.name for path in merged.iterdir()) == sorted(path.name for path in whole.iterdir())


def not_merged(jobs: Path, out: Path) -> str:
    """The line; nothing is written."""
    line = refused("merge", jobs, "--out", out)
    assert not out.exists()
    return line.removeprefix("datafactory: ").rstrip()


def test_jobs_merge_to_the_run_in_one_piece(jobs: Path, whole: Path, tmp_path: Path) -> None:
    """By itself a job is a dataset of its frames, whatever its folder is called."""
    opened = [open_dataset(folder) for folder in sorted(jobs.iterdir())]
    assert [fault for dataset in opened for fault in verify(dataset)] == []
    frames = [frame_id for folder in sorted(jobs.iterdir()) for frame_id in frames_of(folder)]
    assert sorted(frames) == list(range(40))
    said = run("merge", jobs, "--out", tmp_path / "merged")
    require_same(tmp_path / "merged", whole)
    assert "7 shards are links" in said
    assert [item["job"] for item in read_manifest(tmp_path / "merged")["made"]["jobs"]] == ["0/3", "1/3", "2/3"]
    assert "already complete" in run("merge", jobs, "--out", tmp_path / "merged", "--resume")
    folders = [path.rename(tmp_path / f"node{number}") for number, path in enumerate(sorted(jobs.iterdir()))]
    run("merge", *reversed(folders), "--out", tmp_path / "again")
    for folder in folders:
        shutil.rmtree(folder)
    for name in ("merged", "again"):
        require_same(tmp_path / name, whole)


def test_where_no_link_can_be_made_shards_are_copied(
    jobs: Path, whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuses(source: Path, target: Path) -> None:
        raise OSError(18, "Invalid cross-device link")

    monkeypatch.setattr(os, "link", refuses)
    said = run("merge", jobs, "--out", tmp_path / "merged")
    require_same(tmp_path / "merged", whole)
    assert "7 shards are copies" in said
    assert all(path.stat().st_nlink == 1 for path in jobs.glob("*/*/*.parquet"))
    monkeypatch.setattr(merging, "free_bytes", lambda directory: 1000)
    assert "MB have to be copied there; expected another disk" in not_merged(jobs, tmp_path / "again")


def test_missing_frames_are_named_with_the_jobs_that_owe_them(jobs: Path, radar_file: Path, tmp_path: Path) -> None:
    first, second, _ = sorted(jobs.iterdir())
    owed = sorted(frames_of(second))
    shutil.rmtree(second)
    line = not_merged(jobs, tmp_path / "merged")
    assert f"frames {ranges(owed)} are missing ({len(owed)} of 40): job 1/3 is not there" in line
    (second / ".progress").mkdir(parents=True)
    (second / ".progress" / "arguments.json").write_text("{}", encoding="utf-8")
    line = not_merged(jobs, tmp_path / "merged")
    assert f"({len(owed)} of 40): {second} is not finished; expected all jobs finished" in line
    shutil.rmtree(first)
    shutil.rmtree(sorted(jobs.iterdir())[-1])
    assert "no job in it is finished" in not_merged(jobs, tmp_path / "merged")


def test_an_array_that_was_cut_anew_fills_the_gaps(jobs: Path, radar_file: Path, whole: Path, tmp_path: Path) -> None:
    """Job 1 of 3 is lost; two of seven smaller ones have its frames, and one has frames that job 0 made as well."""
    shutil.rmtree(jobs / "job-1-of-3")
    for number in (0, 1, 4):
        points(jobs, radar_file, "--shard", f"{number}/7")
    run("merge", jobs, "--out", tmp_path / "merged")
    require_same(tmp_path / "merged", whole)


def test_jobs_with_other_arguments_are_refused(jobs: Path, radar_file: Path, tmp_path: Path) -> None:
    shutil.rmtree(jobs / "job-1-of-3")
    (other := tmp_path / radar_file.name).write_text(SMALL_RADAR.replace("chirps = 8", "chirps = 6"), encoding="utf-8")
    points(jobs, other, "--shard", "1/3")
    line = not_merged(jobs, tmp_path / "merged")
    assert line.startswith(f"{jobs / 'job-1-of-3'}: radar.waveform.chirps is 6")
    assert line.endswith("expected jobs with the same arguments but --shard")


def test_damaged_shards_are_named_and_merged_when_their_jobs_ran_again(
    jobs: Path, whole: Path, radar_file: Path, tmp_path: Path
) -> None:
    content = bytearray((damaged := jobs / "job-0-of-3" / "validation" / "part-00000.parquet").read_bytes())
    content[len(content) // 2] ^= 1
    damaged.write_bytes(content)
    (gone := jobs / "job-2-of-3" / "train" / "part-00002.parquet").unlink()
    line = not_merged(jobs, tmp_path / "merged")
    assert f"{gone}, {damaged}" in line
    assert f"expected {jobs / 'job-0-of-3'} removed and job 0/3 run again" in line
    for number in (0, 2):
        shutil.rmtree(jobs / f"job-{number}-of-3")
        points(jobs, radar_file, "--shard", f"{number}/3")
    run("merge", jobs, "--out", tmp_path / "merged")
    require_same(tmp_path / "merged", whole)


def test_a_job_without_its_notes_is_to_run_again(jobs: Path, tmp_path: Path) -> None:
    """A copy of what a listing shows has none."""
    shutil.rmtree(jobs / "job-1-of-3" / ".progress")
    line = not_merged(jobs, tmp_path / "merged")
    assert "missing or not as recorded in .progress: " in line
    assert line.endswith(f"expected {jobs / 'job-1-of-3'} removed and job 1/3 run again")


def test_two_jobs_that_made_a_shard_differently_are_refused(jobs: Path, tmp_path: Path) -> None:
    twin = Path(shutil.copytree(jobs / "job-0-of-3", jobs / "job-0-of-4"))
    shard, note = twin / "train/part-00000.parquet", twin / ".progress/train-part-00000.json"
    shard.write_bytes(shard.read_bytes() + b"0")
    finished = unsealed(note, read_json(note, "the note"))
    finished["record"] |= {"bytes": shard.stat().st_size, "sha256": sha256_of(shard)}
    note.write_text(json.dumps(sealed(finished)), encoding="utf-8")
    assert "is not the file of this name in" in not_merged(jobs, tmp_path / "merged")


@pytest.fixture
def dying(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The merge dies at the third shard, once it is at its place and not noted yet."""
    left, record = [2], merging.record_finished

    def record_finished(*arguments: Any) -> None:
        if not left[0]:
            raise KeyboardInterrupt
        left[0] -= 1
        record(*arguments)

    monkeypatch.setattr(merging, "record_finished", record_finished)
    return left


@pytest.mark.parametrize("links", [True, False])
def test_a_merge_that_is_killed_goes_on(
    links: bool, dying: list[int], jobs: Path, whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not links:
        monkeypatch.setattr(os, "link", lambda *_: (_ for _ in ()).throw(OSError(18, "Invalid cross-device link")))
    out = tmp_path / "merged"
    CliRunner().invoke(app, ["merge", str(jobs), "--out", str(out)])
    assert not (out / "manifest.json").exists()
    assert len(list(out.glob("*/*.parquet"))) == 3
    (out / "train" / "part-00001.parquet.partial").write_bytes(b"of a copy that was killed")
    with pytest.raises(InputError, match="is not empty"):
        run("merge", jobs, "--out", out)
    dying[0] = 99
    assert "2 shards kept from before" in run("merge", jobs, "--out", out, "--resume")
    require_same(out, whole)


def test_jobs_of_sequences_merge_to_the_run_in_one_piece(tmp_path: Path, radar_file: Path) -> None:
    """A sequence has one split, whatever the numbers of its frames; frames of their own follow."""
    track = tmp_path / "track.csv"
    track.write_text("time,x,y,z,yaw_deg\n0,-10,-1.75,.5,0\n0.5,-9,-1.75,.5,0\n1,-8,-1.75,.5,4\n")

    def made(out: Path, *more: object) -> None:
        common = ("--radar", radar_file, "--rays", 500, "--workers", 1, "--split", "1:1:1", "--points", 4)
        run("render", "shipped:tiny", "--trajectory", track, "--trajectory", track, *common, "--out", out, *more)

    made(tmp_path / "whole")
    for number in range(2):
        made(tmp_path / "jobs", "--shard", f"{number}/2")
    run("merge", tmp_path / "jobs", "--out", tmp_path / "merged")
    require_same(tmp_path / "merged", tmp_path / "whole")


def test_what_holds_no_jobs_is_refused(whole: Path, tmp_path: Path) -> None:
    assert "no such folder" in not_merged(tmp_path / "jobs", tmp_path / "merged")
    (tmp_path / "jobs").mkdir()
    assert "holds no job" in not_merged(tmp_path / "jobs", tmp_path / "merged")
    assert "is not of a job of an array" in not_merged(whole, tmp_path / "merged")
    with pytest.raises(InputError, match="DIR: no folder; expected the --out of jobs of an array"):
        datafactory.merge([], tmp_path / "merged")


def test_a_job_is_not_taken_for_the_whole_run(jobs: Path, radar_file: Path) -> None:
    """Nor the whole run, in its folder, for the job."""
    with pytest.raises(InputError, match=r"--resume: shard is nothing, but the run in .* had '0/3'"):
        points(jobs / "job-0-of-3", radar_file, "--resume")


def test_ranges() -> None:
    assert ranges([0, 1, 2, 5, 8, 9]) == "0-2, 5, 8-9"
    assert ranges(range(0, 60, 2)).endswith("20, 22, and 18 more")


@given(st.integers(1, 300), st.integers(1, 40))
def test_every_shard_is_made_by_one_job(frames: int, of: int) -> None:
    plans = plan_shards([split_of(frame_id) for frame_id in range(frames)])
    of = min(of, len(plans))
    own = [ArrayJob(number, of).own(plans) for number in range(of)]
    assert sorted((plan for plans in own for plan in plans), key=plans.index) == list(plans)
    assert max(map(len, own)) - min(map(len, own)) <= 1
    assert min(map(len, own)) >= 1
    more = len(plans) + 1
    with pytest.raises(
        InputError, match=f"--shard: {more} jobs for {more - 1} shards; expected at most {more - 1} jobs"
    ):
        ArrayJob(0, more).own(plans)


@pytest.mark.parametrize("text", ["3/3", "/", "-1/3", "0/0", "1 / 3", "", "0/3/4", "0.5/3", "٣/٤", "0/9999999999"])
def test_what_is_no_job_is_one_line(text: str) -> None:
    with pytest.raises(InputError, match=r"--shard: .*; expected i/n with i from 0 to n - 1"):
        parse_job(text)


def test_folders_sort_by_number_and_are_known_again() -> None:
    names = [ArrayJob(number, 120).folder for number in range(120)]
    assert names == sorted(names)
    assert names[7] == "job-007-of-120"
    assert all(map(is_job_folder, names))
    assert not any(map(is_job_folder, ("job", "job-1-of-", "train", "job-1-of-3.old")))
    assert str(parse_job("007/120")) == "7/120"


@pytest.mark.parametrize("split", ["6:1:1", "1:0:0", None])
def test_a_job_says_how_the_whole_dataset_is_cut(split: str | None) -> None:
    splits = [PATHS if split is None else split_of(frame_id, split) for frame_id in range(50)]
    assert JobEntry(frames=50, split=split).plans() == plan_shards(splits)
