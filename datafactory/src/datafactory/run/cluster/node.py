"""What a node of the cluster does: make a portion, and hand over its rows.

Nodes need no disk in common. Rows travel to the driver through Ray's object store; one process, on the user's machine,
writes the dataset. What of a machine changes the bytes of a shard, versions and the ray tracer's back end, is compared
with that of the user's.
"""

from __future__ import annotations

import pickle
import platform
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np
import pyarrow as pa
from jaxtyping import UInt8

from datafactory.run.portions import PortionWork
from datafactory.run.shards import PACKAGES, Portion
from shared.dataset.locations import file_size
from shared.physics.errors import InputError

MISSING = "missing"


def surroundings() -> dict[str, str]:
    """Versions by name, told without importing what they are of."""
    found = {"Python": platform.python_version(), "the machine": f"{platform.system()} {platform.machine()}"}
    for name in (*PACKAGES, "scipy"):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = MISSING
    return found


def tracer() -> dict[str, str]:
    """Mitsuba's variant and, on LLVM, the version of the library, of this process; it is made ready if need be.

    :raises InputError: as :func:`datafactory.paths.backend.select_variant`
    """
    from datafactory.paths.backend import LLVM_VARIANT, find_llvm, select_variant

    variant = select_variant()
    return {"the ray tracer": f"{variant} with LLVM {find_llvm()[1]}" if variant == LLVM_VARIANT else variant}


def processor() -> str:
    """The kind of processor, as LLVM calls it: code is compiled for it, so that last digits may depend on it."""
    from llvmlite import binding

    return str(binding.get_host_cpu_name())


def difference(here: Mapping[str, str], there: Mapping[str, str]) -> str:
    """The first thing that differs, in words; empty where nothing does."""
    for name, value in here.items():
        if there.get(name, MISSING) != value:
            return f"{name} is {there.get(name, MISSING)} there, {value} here"
    return ""


def look_around() -> tuple[dict[str, str], str]:
    """Versions, and the kind of processor, of the machine that this runs on."""
    return surroundings(), processor()


def unlike(node: str, found: str) -> InputError:
    """What is said of a node that would make other bytes."""
    return InputError("--engine", f"node {node}: {found}", "the same on all nodes, for the same bytes")


def where() -> str:
    """This interpreter, for a message about a node."""
    return f"{platform.node()} ({sys.executable})"


def surroundings_of(work: PortionWork) -> dict[str, str]:
    """What this process is like, as far as the work asks."""
    return surroundings() | (tracer() if work.job.scenes else {})


@dataclass(frozen=True)
class Given:
    """What every process of the cluster is given once.

    :param like: what the process has to be like, see :mod:`datafactory.run.cluster.node`
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
    for path in {row.shard for row in read.work.job.deal.stored}:
        if file_size(path) is None:
            problem = f"node {where()} has no file {path}"
            raise InputError("--paths", problem, "a folder that every node sees under the same name")
    read.work.begin()
    if found := difference(read.like, surroundings_of(read.work)):
        raise unlike(where(), found)
    return read.work
