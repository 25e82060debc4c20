"""Steps of shards that are at work on a cluster, counted in a process of their own, which imports little."""

from __future__ import annotations

from collections import Counter


class Steps:
    """An actor that counts the steps of running tasks. Where its process is lost, so are counts, and nothing else."""

    def __init__(self) -> None:
        self._done: Counter[int] = Counter()

    def add(self, ticket: int, count: int) -> None:
        """:param ticket: of the task, a number that no other has"""
        self._done[ticket] += count

    def done(self) -> dict[int, int]:
        """Steps by ticket."""
        return dict(self._done)
