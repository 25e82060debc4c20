"""Seconds by stage of the chain, a frame on one core, the median over frames and repeats.

Writing waits for the disk, and tracing on a GPU for that: they are timed on the wall clock. The rest is timed in
processor time, which neighbours on the machine hardly change. The image stage works on a batch, as a run does, and its
time is shared by a full batch.
"""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np

from datafactory.paths.backend import traces_on_the_processor

STAGE_OF = {
    "trace": "trace", "sorting": "delays and spread", "cube": "delays and spread", "range-Doppler": "range-Doppler",
    "truth": "truth", "image": "image", "write": "write",
}  # fmt: skip
"""Of each step that is timed, the stage that it is a part of."""
STAGES = tuple(dict.fromkeys(STAGE_OF.values()))
Value = TypeVar("Value")
Advance = Callable[[int, int, str], None]
"""Takes settings done, settings in all, and what is being measured."""


def _waits(step: str) -> bool:
    """Whether a step waits for something else than this process."""
    return step == "write" or (step == "trace" and not traces_on_the_processor())


class Clock:
    """Seconds by stage; a step whose settings an earlier run shares is not run again.

    :param repeats: runs of each step
    :param kept: steps of an earlier run with their seconds, by step, frame and settings
    :param keep: whether this run's steps join them
    """

    def __init__(self, repeats: int = 1, kept: dict[Any, tuple[Any, list[float]]] | None = None, keep: bool = False):
        self.repeats, self.kept, self.keep = repeats, {} if kept is None else kept, keep
        self.measured: dict[str, list[float]] = defaultdict(list)

    def __call__(self, step: str, work: Callable[[], Value], share: int = 1, key: Any = None) -> Value:
        """The work's value; its time is divided by ``share``."""
        if key is not None and (step, key) in self.kept:
            value, seconds = self.kept[step, key]
        else:
            now, seconds = time.perf_counter if _waits(step) else time.process_time, []
            for _ in range(self.repeats):
                started = now()
                value = work()
                seconds.append((now() - started) / share)
            if self.keep:
                self.kept[step, key] = value, seconds
        self.measured[step] += seconds
        return value

    def seconds(self) -> dict[str, float]:
        """Medians over frames and repeats, of a stage's steps together."""
        result: dict[str, float] = defaultdict(float)
        for step, every in self.measured.items():
            result[STAGE_OF[step]] += float(np.median(every))
        return dict(result)
