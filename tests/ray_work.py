"""What processes of the cluster do in tests; a module, so that they can import it."""

from __future__ import annotations

import os
import signal
from pathlib import Path

from datafactory.run.job import Job, render_shard
from datafactory.run.shards import ShardPlan
from datafactory.run.workers import ShardResult
from shared.processes.tasks import StepsDone

DEADLY = "test/part-00000.parquet"


def shard_or_death(job: Job, plan: ShardPlan, directory: Path, fingerprint: str, report: StepsDone) -> ShardResult:
    """As :func:`datafactory.run.job.render_shard`, but one shard is deadly."""
    if plan.path == DEADLY:
        os.kill(os.getpid(), signal.SIGKILL)
    return render_shard(job, plan, directory, fingerprint, report)
