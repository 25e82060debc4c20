"""What a benchmark says: one record a comparison, and how its times are taken."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from typing import Any, TypeVar

Value = TypeVar("Value")

RELATIVE_L2 = "relative L2"
DB_OF_PEAK = "dB, largest difference over peak"


class NotInstalledError(RuntimeError):
    """A reference from outside this project is not installed; the message is the reason that is printed."""


@dataclass(frozen=True)
class Timing:
    """How long something took: by the clock, and of the processor's time, which a busy machine disturbs less.

    :param seconds: wall clock [s]
    :param cpu_seconds: of this process, all threads together [s]
    """

    seconds: float
    cpu_seconds: float

    def scaled(self, factor: float) -> Timing:
        """The same work ``factor`` times."""
        return Timing(factor * self.seconds, factor * self.cpu_seconds)


@dataclass(frozen=True)
class Record:
    """One comparison, both sides measured in this run on the same data.

    :param name: what is compared
    :param ours_time: ours, the median of its repeats
    :param reference: what it is held against, its threads, and whether its time was scaled up from a sample
    :param reference_time: the reference
    :param error: of ours against the reference or, where the reference is another setting, against the float64 sum
    :param error_unit: unit of ``error``
    :param ours: what was measured, with its threads
    :param details: whatever else was measured, by name with units
    """

    name: str
    ours_time: Timing
    reference: str
    reference_time: Timing
    error: float
    error_unit: str
    ours: str
    details: dict[str, Any] = field(default_factory=dict)

    @property
    def ratio(self) -> float:
        """How many times faster ours is."""
        return self.reference_time.seconds / self.ours_time.seconds

    @property
    def cpu_ratio(self) -> float:
        """The same ratio of processor times, the fairer one where others use the machine; threads count together."""
        return self.reference_time.cpu_seconds / self.ours_time.cpu_seconds

    def to_json(self) -> dict[str, Any]:
        """The record as ``bench.json`` holds it."""
        return {**asdict(self), "ratio": self.ratio, "cpu_ratio": self.cpu_ratio}


def timed(function: Callable[[], Value], repeats: int) -> tuple[Timing, Value]:
    """Median times of ``repeats`` calls, and the last result. Warm up before: the first call compiles."""
    seconds, cpu_seconds = [], []
    for _ in range(repeats):
        start, cpu_start = time.perf_counter(), time.process_time()
        value = function()
        seconds.append(time.perf_counter() - start)
        cpu_seconds.append(time.process_time() - cpu_start)
    return Timing(statistics.median(seconds), statistics.median(cpu_seconds)), value
