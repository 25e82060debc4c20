"""What the command and the driver say to each other, over a pipe."""

from __future__ import annotations

from dataclasses import dataclass

from datafactory.run.progress import FinishedShard
from datafactory.run.shards import ShardPlan
from datafactory.run.workers import Seconds
from shared.dataset.locations import Location

PROBE_S = 120.0
"""Within this a node has to say what is installed on it; the first process of a node takes some seconds to start."""


@dataclass(frozen=True)
class Connect:
    """The first thing said.

    :param address: HOST:PORT of a cluster; None for the one that this machine is a node of, or a Ray of this run's own
    """

    address: str | None


@dataclass(frozen=True)
class Reached:
    """The driver's first answer: Ray is there. An exception in its place, or later, says why not."""


@dataclass(frozen=True)
class Connected:
    """The driver's second answer: the nodes have been asked what they are like.

    :param nodes: alive, that have a processor for tasks
    :param notes: lines for the user
    """

    nodes: int
    notes: tuple[str, ...]


@dataclass(frozen=True)
class Begin:
    """What all shards need.

    :param given: a pickled :class:`datafactory.run.cluster.node.Given`
    :param directory: that shards are written to
    :param memory: of a process [bytes]
    """

    given: bytes
    directory: Location
    memory: int


@dataclass(frozen=True)
class Outcome:
    """What became of a shard that was handed out: one of the four is set.

    :param result: it is written
    :param died: how the process that worked on it ended
    :param lost: its machine is gone
    :param error: what its task raised
    """

    plan: ShardPlan
    result: tuple[FinishedShard, Seconds] | None = None
    died: str = ""
    lost: bool = False
    error: Exception | None = None


@dataclass(frozen=True)
class Look:
    """How the cluster stands.

    :param outcomes: since the last look
    :param steps: done of shards that are at work
    :param places: shards that its nodes can work on at a time
    """

    outcomes: tuple[Outcome, ...]
    steps: int
    places: int
