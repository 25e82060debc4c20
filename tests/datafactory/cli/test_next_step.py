"""What a command says comes next."""

import pytest

from datafactory.api.options import PointsOptions
from datafactory.cli.making import next_step


@pytest.mark.parametrize(
    ("out", "shard", "expected"),
    [
        ("build/data", None, "look:  somewhere"),
        ("build/jobs", "0/4", "next:  datafactory merge build/jobs --out ANOTHER_FOLDER, once all jobs are done"),
        # Jobs are merged where they are files.
        (
            "s3://bucket/jobs",
            "0/4",
            "next:  once all jobs are done, copy s3://bucket/jobs to a local FOLDER; "
            "datafactory merge FOLDER --out DIR",
        ),
    ],
)
def test_of_a_job_the_merge_comes_next(out: str, shard: str | None, expected: str, capsys) -> None:
    next_step(PointsOptions(out, shard=shard), "look:  somewhere")
    assert capsys.readouterr().out == f"{expected}\n"
