"""What every pool of processes has in common: work, its tasks, and what becomes of a task whose processes die."""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable, Iterator
from dataclasses import dataclass
from typing import Any, Generic, Protocol, TypeVar

ATTEMPTS = 3
"""Processes that may die of one task before it counts as failed."""
LOSSES = 10
"""Machines that may be lost with one task before it counts as failed. A machine holds many tasks, and is seldom lost by
the fault of one; a task whose machine is always lost is to blame all the same."""

Item = TypeVar("Item", bound=Hashable)
Result = TypeVar("Result")
Item_contra = TypeVar("Item_contra", contravariant=True)
Result_co = TypeVar("Result_co", covariant=True)


class Work(Protocol[Item_contra, Result_co]):
    """What every worker is given once; it can be pickled."""

    def begin(self) -> None:
        """Make the process ready; called once in each."""

    def __call__(self, item: Item_contra, /) -> Result_co:
        """Do one task."""


@dataclass(frozen=True)
class Finished(Generic[Item, Result]):
    """A task that is done, or that failed.

    :param result: None where it failed
    :param failure: how often and how its processes ended, in words; empty where it is done
    """

    item: Item
    result: Result | None
    failure: str = ""


class Pool(Protocol[Item, Result]):
    """Processes that work on tasks; a context, which ends what it started when it is left, whatever for."""

    def __enter__(self) -> Pool[Item, Result]: ...

    def __exit__(self, *error: Any) -> None: ...

    @property
    def busy(self) -> bool:
        """Whether any task is not finished."""

    @property
    def has_room(self) -> bool:
        """Whether another task may be handed out."""

    def submit(self, item: Item) -> None:
        """Hand out a task."""

    def finished(self, timeout_s: float) -> Iterator[Finished[Item, Result]]:
        """What has finished within this time [s]; tasks of processes that died are handed out again.

        :raises Exception: what a task raised
        """


class Attempts(Generic[Item, Result]):
    """How often a task was begun in vain, and whether it is tried again."""

    def __init__(self) -> None:
        self._deaths: Counter[Item] = Counter()
        self._losses: Counter[Item] = Counter()

    def died(self, item: Item, how: str) -> Finished[Item, Result] | None:
        """A process died of a task; None where it is to be tried again.

        :param how: the process ended, in words
        """
        self._deaths[item] += 1
        if self._deaths[item] < ATTEMPTS:
            return None
        return Finished(item, None, f"three worker processes died of it, {how}")

    def lost(self, item: Item) -> Finished[Item, Result] | None:
        """A machine was lost with a task; None where it is to be tried again."""
        self._losses[item] += 1
        if self._losses[item] < LOSSES:
            return None
        return Finished(item, None, f"{LOSSES} machines were lost while they worked on it")
