"""Counted remarks of a reader: what a file holds and the scene does not."""

from __future__ import annotations

from collections import Counter


class Notes:
    """Collects the warnings of one reading, in the order in which they first came up."""

    def __init__(self) -> None:
        self._counts: Counter[str] = Counter()

    def count(self, remark: str, number: int = 1) -> None:
        """Add ``number`` to the count of one kind of remark.

        :param remark: the sentence, with ``#`` where the count goes, e.g. ``"# prims of type Points ignored"``
        """
        if number:
            self._counts[remark] += number

    def say(self, remark: str) -> None:
        """Add a remark that has no count; saying it twice changes nothing."""
        self._counts[remark] = 1

    def repeat(self, other: Notes) -> None:
        """Add the counts of other notes once more."""
        self._counts.update(other._counts)

    def sentences(self) -> tuple[str, ...]:
        """The remarks with their counts filled in."""
        return tuple(remark.replace("#", str(number), 1) for remark, number in self._counts.items())
