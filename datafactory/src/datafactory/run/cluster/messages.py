"""What the command and the driver say to each other, over a pipe."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from datafactory.run.portions import Rows
from datafactory.run.shards import Portion

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
    :param cores: that they have together
    :param notes: lines for the user
    """

    nodes: int
    cores: int
    notes: tuple[str, ...]


@dataclass(frozen=True)
class Begin:
    """What all portions need.

    :param given: a pickled :class:`datafactory.run.cluster.node.Given`
    :param folder: of this machine, for the files of rows
    :param memory: of a process [bytes]
    """

    given: bytes
    folder: Path
    memory: int


@dataclass(frozen=True)
class Outcome:
    """What became of a portion that was handed out: one of the four is set.

    :param rows: it is made
    :param died: how the process that worked on it ended
    :param lost: its machine is gone
    :param error: what its task raised
    """

    portion: Portion
    rows: Rows | None = None
    died: str = ""
    lost: bool = False
    error: Exception | None = None


@dataclass(frozen=True)
class Look:
    """How the cluster stands.

    :param outcomes: since the last look
    :param places: portions that its nodes can work on at a time
    """

    outcomes: tuple[Outcome, ...]
    places: int
