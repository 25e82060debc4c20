"""What a node of the cluster does: make a shard, and hand over its bytes.

Nodes need no disk in common. A shard is made as a file in the node's own temporary folder and travels to the driver
through Ray's object store; one process, on the user's machine, writes the dataset.
"""

from __future__ import annotations

import os
import pickle
import platform
import shutil
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import psutil
from jaxtyping import UInt8

from datafactory.run.cluster.surroundings import difference, surroundings, tracer, unlike, where
from datafactory.run.progress import FinishedShard
from datafactory.run.shards import ShardPlan
from datafactory.run.workers import Seconds, ShardWork
from shared.dataset.locations import file_size
from shared.physics.errors import InputError

SCRATCH = f"sparseradar-shard-{platform.node()}-"
"""Folders in the temporary folder, one a process, whose number follows; containers may have the folder in common."""


def surroundings_of(work: ShardWork) -> dict[str, str]:
    """What this process is like, as far as the work asks."""
    return surroundings() | (tracer() if work.job.scenes else {})


@dataclass(frozen=True)
class Given:
    """What every process of the cluster is given once.

    :param like: what the process has to be like, see :mod:`datafactory.run.cluster.surroundings`
    """

    work: ShardWork
    like: Mapping[str, str]


def make_shard(
    plan: ShardPlan, ticket: int, given: list[Any], steps: Any
) -> tuple[tuple[FinishedShard, Seconds], UInt8[np.ndarray, " size"]]:
    """Make one shard; its record and seconds, and its bytes.

    :param ticket: of this attempt, a number that no other has
    :param given: the reference of a pickled :class:`Given`; in a list, because Ray would fetch it for every task
    :param steps: the handle of :class:`datafactory.run.cluster.steps.Steps`
    :raises InputError: a node that is not like the user's machine
    """
    work = _ready_for(given[0])
    with tempfile.TemporaryDirectory(prefix=f"{SCRATCH}{os.getpid()}-") as scratch:
        result = replace(work, directory=Path(scratch))(plan, lambda count: steps.add.remote(ticket, count))
        return result, np.fromfile(Path(scratch) / plan.path, dtype=np.uint8)


@lru_cache(maxsize=1)  # a process of Ray's works for one run
def _ready_for(given: Any) -> ShardWork:
    """The work, this process made ready for it."""
    import ray

    _remove_scratch_of_the_dead()
    try:
        read: Given = pickle.loads(ray.get(given))
    except (ImportError, AttributeError) as error:  # a class of the user's own, say a target's
        raise InputError("--engine", f"{where()} lacks what this run needs: {error}", "it on all nodes") from error
    for path in {path for path, _ in read.work.job.stored}:
        if file_size(path) is None:
            problem = f"node {where()} has no file {path}"
            raise InputError("--paths", problem, "a folder that every node sees under the same name")
    read.work.begin()
    if found := difference(read.like, surroundings_of(read.work)):
        raise unlike(where(), found)
    return read.work


def _remove_scratch_of_the_dead() -> None:
    """Processes that were killed left their folders."""
    for folder in Path(tempfile.gettempdir()).glob(f"{SCRATCH}*"):
        number = folder.name.removeprefix(SCRATCH).split("-")[0]
        if number.isdigit() and not psutil.pid_exists(int(number)):
            shutil.rmtree(folder, ignore_errors=True)
