"""Which shards are whose: every shard one job's, under any number of jobs, and what ``--shard`` refuses."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from datafactory.frame.deal import split_of
from datafactory.run.array_job import ArrayJob, JobEntry, is_job_folder, parse_job
from datafactory.run.shards import PATHS, plan_shards
from shared.physics.errors import InputError


@given(st.integers(1, 300), st.integers(1, 40))
def test_every_shard_is_made_by_one_job(frames: int, of: int) -> None:
    plans = plan_shards([split_of(frame_id) for frame_id in range(frames)])
    of = min(of, len(plans))
    own = [ArrayJob(number, of).own(plans) for number in range(of)]
    assert sorted((plan for plans in own for plan in plans), key=plans.index) == list(plans)
    assert max(map(len, own)) - min(map(len, own)) <= 1
    assert min(map(len, own)) >= 1


def test_more_jobs_than_shards_are_refused() -> None:
    plans = plan_shards([split_of(frame_id) for frame_id in range(20)])
    with pytest.raises(InputError, match="--shard: 9 jobs for 4 shards; expected at most 4 jobs"):
        ArrayJob(0, 9).own(plans)


@pytest.mark.parametrize(
    "text", ["3/3", "/", "1", "-1/3", "0/0", "1 / 3", "a/b", "", "1/", "0/3/4", "0.5/3", "٣/٤", "0/9999999999"]
)
def test_what_is_no_job_is_one_line(text: str) -> None:
    with pytest.raises(InputError, match=r"--shard: .*; expected i/n with i from 0 to n - 1") as caught:
        parse_job(text)
    assert "\n" not in str(caught.value)


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
    assert JobEntry(frames=50, split=split, counts=()).plans() == plan_shards(splits)
