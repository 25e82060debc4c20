"""An experiment whose cells say what became of their process, or end badly: for a worker to import."""

import os
import signal
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import torch
from threadpoolctl import threadpool_info

from shared.physics.errors import InputError
from trainer.evaluation.experiments.bench import Bench, Experiment, Task
from trainer.evaluation.store import Values


@dataclass(eq=False)
class Troubled(Experiment):
    """Cells of what :data:`WORK` has, by name."""

    work: tuple[str, ...]
    name: str = "troubled"
    title: str = ""
    caption: str = ""

    def tasks(self, bench: Bench) -> Sequence[Task]:
        return [
            Task((kind, "", f"place={place}"), "", partial(WORK[kind], bench), "cuda" if kind == "gpu" else "cpu")
            for place, kind in enumerate(self.work)
        ]


def _report(bench: Bench) -> Values:
    blocked = signal.pthread_sigmask(signal.SIG_BLOCK, ())
    threads = max([torch.get_num_threads(), *(pool["num_threads"] for pool in threadpool_info())])
    return {
        "pid": np.asarray(os.getpid()), "deaf": np.asarray(signal.SIGINT in blocked), "threads": np.asarray(threads),
        "seed": np.asarray(bench.config.seed),
    }  # fmt: skip


def _refuse(_bench: Bench) -> Values:
    raise InputError("part-00000.parquet", "row 3: damaged", "a whole row")


def _die(_bench: Bench) -> Values:
    os.kill(os.getpid(), signal.SIGKILL)
    return {}


WORK = {"report": _report, "gpu": _report, "refuse": _refuse, "die": _die}
