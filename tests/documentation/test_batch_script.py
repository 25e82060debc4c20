"""The batch script of docs/large-runs.md, as it stands but for its size, under a stand-in for Slurm."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from manual import DOCS, ROOT, blocks

from datafactory import merge

SMALLER = {
    "scenes/street.usda": str(ROOT / "scenes/tiny.usda"),
    "--frames 18500": "--frames 14 --rays 500 --effects specular,diffuse --workers 1",
    "$SLURM_ARRAY_TASK_ID/16": "$SLURM_ARRAY_TASK_ID/2",
    "srun .venv/bin/datafactory": f"{sys.executable} -m datafactory",
}


def script() -> str:
    (text,) = blocks(DOCS / "large-runs.md", "bash")
    return text


def test_the_array_has_as_many_jobs_as_the_script_says() -> None:
    assert "#SBATCH --array=0-15\n" in script()
    assert '--shard "$SLURM_ARRAY_TASK_ID/16"' in script()


@pytest.mark.slow
def test_the_jobs_of_the_script_merge(tmp_path: Path) -> None:
    text = script()
    for theirs, ours in SMALLER.items():
        assert theirs in text
        text = text.replace(theirs, ours)
    (tmp_path / "jobs.sh").write_text(text, encoding="utf-8")
    for task in ("1", "0", "0"):  # one of them is put back into the queue
        done = subprocess.run(
            ["bash", "jobs.sh"], cwd=tmp_path, env={**os.environ, "SLURM_ARRAY_TASK_ID": task},
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr[-800:]
    assert merge(tmp_path / "build/jobs", tmp_path / "build/dataset").frames == 14
