"""Seconds and memory by stage of the chain.

Seconds are per frame on one core, the median over frames and repeats. Writing waits for the disk, and tracing on a GPU
for that: they are timed on the wall clock. The rest is timed in processor time, which neighbours on the machine hardly
change. The image stage works on a batch, as a run does, and its time is shared by a full batch. Peak memory is the
growth of the process's resident set while a stage runs, sampled every 5 ms, over what was resident before: the stage's
own arrays, not the libraries.
"""

from __future__ import annotations

import threading
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
import psutil

from datafactory.paths.backend import traces_on_the_processor

STAGES = ("trace", "delays and spread", "range-Doppler", "truth", "image", "write")
SAMPLING_S = 0.005
Value = TypeVar("Value")
Advance = Callable[[int, int, str], None]
"""Takes settings done, settings in all, and what is being measured."""


@contextmanager
def peak_memory() -> Iterator[Callable[[], float]]:
    """Yields a function that tells the growth of the resident set so far [MB]."""
    process, done = psutil.Process(), threading.Event()
    before = process.memory_info().rss
    highest = [before]

    def watch() -> None:
        while not done.wait(SAMPLING_S):
            highest[0] = max(highest[0], process.memory_info().rss)

    watcher = threading.Thread(target=watch, daemon=True)
    watcher.start()
    try:
        yield lambda: (max(highest[0], process.memory_info().rss) - before) / 1e6
    finally:
        done.set()
        watcher.join()


def _waits(stage: str) -> bool:
    """Whether a stage waits for something else than this process."""
    return stage == "write" or (stage == "trace" and not traces_on_the_processor())


@dataclass(frozen=True)
class _Measured:
    value: Any
    seconds: tuple[float, ...]
    peak_mb: float


class Clock:
    """Seconds and peak memory by stage; a stage whose settings the kept run shares is not run again.

    :param repeats: runs of each call
    :param kept: stages of an earlier run, by stage, part, settings and frame
    :param keep: whether this run's stages join them
    """

    def __init__(self, repeats: int = 1, kept: dict[Any, _Measured] | None = None, keep: bool = False) -> None:
        self.repeats, self.kept, self.keep = repeats, {} if kept is None else kept, keep
        self.measured: dict[tuple[str, str], list[_Measured]] = defaultdict(list)

    def __call__(self, stage: str, work: Callable[[], Value], share: int = 1, key: Any = None, part: str = "") -> Value:
        """The work's value; its time is divided by ``share``.

        :param part: of a stage that is done in several steps, whose times are added
        """
        found = self.kept.get((stage, part, key)) if key is not None else None
        if found is None:
            seconds = []
            now = time.perf_counter if _waits(stage) else time.process_time
            with peak_memory() as peak:
                for _ in range(self.repeats):
                    started = now()
                    value = work()
                    seconds.append((now() - started) / share)
                found = _Measured(value, tuple(seconds), peak())
            if self.keep:
                self.kept[stage, part, key] = found
        self.measured[stage, part].append(found)
        return found.value

    def seconds(self) -> dict[str, float]:
        """Medians over frames and repeats, of a stage's parts together."""
        result: dict[str, float] = defaultdict(float)
        for (stage, _), every in self.measured.items():
            result[stage] += float(np.median([s for m in every for s in m.seconds]))
        return dict(result)

    def peak_mb(self) -> float:
        """The largest growth of any stage [MB]."""
        return max(item.peak_mb for every in self.measured.values() for item in every)


def in_turn(times: int, first: Callable[[Clock], Value], second: Callable[[Clock], Any]) -> tuple[Value, Clock, Clock]:
    """What the first makes, and the clocks of both, made one after the other so often: what else the machine does, and
    how warm it is, then meets both alike."""
    of_first, of_second = Clock(), Clock()
    value = first(of_first)
    second(of_second)
    for _ in range(times - 1):
        first(of_first)
        second(of_second)
    return value, of_first, of_second
