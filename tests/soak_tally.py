"""What is counted of runs that are killed and resumed, and the table of it."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field

KINDS = ("group", "parent", "worker", "node")
"""Of kills: a process group, the process alone, one of its workers, a node of its cluster."""


@dataclass
class Tally:
    """What happened to the runs of one command.

    :param kills: by kind
    :param finished: runs that were compared
    :param differing: of them, those whose files were not the reference's: a frame lost, doubled or changed
    :param hangs: commands that did not end in time
    :param orphans: processes that outlived the one that started them
    :param leftovers: files of a finished run that the reference does not have
    :param tracebacks: runs that showed one
    :param waited_s: longest time from a kill to the end of all processes
    """

    kills: dict[str, int] = field(default_factory=lambda: dict.fromkeys(KINDS, 0))
    finished: int = 0
    differing: int = 0
    hangs: int = 0
    orphans: int = 0
    leftovers: int = 0
    tracebacks: int = 0
    waited_s: float = 0.0

    @property
    def clean(self) -> bool:
        """Whether nothing went wrong."""
        return not (self.differing or self.hangs or self.orphans or self.leftovers or self.tracebacks)


def table(tallies: dict[str, Tally]) -> str:
    """The tallies in Markdown."""
    heads = ["command", *(f"{kind} kills" for kind in KINDS), "runs compared", "differing", "hangs", "orphans",
             "leftovers", "tracebacks", "longest wait [s]"]  # fmt: skip
    lines = ["| " + " | ".join(heads) + " |", "|" + "---|" * len(heads)]
    totals: dict[str, float] = defaultdict(float)
    for name, tally in tallies.items():
        numbers = [*tally.kills.values(), tally.finished, tally.differing, tally.hangs, tally.orphans, tally.leftovers,
                   tally.tracebacks]  # fmt: skip
        for head, number in zip(heads[1:], numbers, strict=False):
            totals[head] += number
        lines.append("| " + " | ".join([name, *map(str, numbers), f"{tally.waited_s:.1f}"]) + " |")
    longest = max(tally.waited_s for tally in tallies.values())
    sums = [f"{totals[head]:.0f}" for head in heads[1:-1]]
    return "\n".join([*lines, "| " + " | ".join(["all", *sums, f"{longest:.1f}"]) + " |"])
