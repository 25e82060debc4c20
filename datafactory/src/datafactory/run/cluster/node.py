"""What a node of the cluster does: make a portion, and hand over its rows.

Nodes need no disk in common. Rows travel to the driver through Ray's object store; one process, on the user's machine,
writes the dataset.
"""

from __future__ import annotations

import pickle
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import pyarrow as pa
from jaxtyping import UInt8

from datafactory.run.cluster.surroundings import difference, surroundings, tracer, unlike, where
from datafactory.run.portions import PortionWork
from datafactory.run.shards import Portion
from shared.dataset.locations import file_size
from shared.physics.errors import InputError


def surroundings_of(work: PortionWork) -> dict[str, str]:
    """What this process is like, as far as the work asks."""
    return surroundings() | (tracer() if work.job.scenes else {})


@dataclass(frozen=True)
class Given:
    """What every process of the cluster is given once.

    :param like: what the process has to be like, see :mod:`datafactory.run.cluster.surroundings`
    """

    work: PortionWork
    like: Mapping[str, str]


def make_portion(
    portion: Portion, given: list[Any]
) -> tuple[tuple[dict[str, int], dict[str, float]], UInt8[np.ndarray, " size"]]:
    """Make one portion; its counts and seconds, and the file of its rows.

    :param given: the reference of a pickled :class:`Given`; in a list, because Ray would fetch it for every task
    :raises InputError: a node that is not like the user's machine
    """
    sink = pa.BufferOutputStream()
    counted = _ready_for(given[0]).write(portion, sink)
    return counted, np.frombuffer(sink.getvalue(), dtype=np.uint8)


@lru_cache(maxsize=1)  # a process of Ray's works for one run
def _ready_for(given: Any) -> PortionWork:
    """The work, this process made ready for it."""
    import ray

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
