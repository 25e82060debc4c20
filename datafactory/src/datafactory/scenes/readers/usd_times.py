"""The time of a USD stage: where it starts, how fast it runs, and what of its animations lies outside of it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from datafactory.scenes.readers.common import Notes
from datafactory.scenes.usd_library import Usd


@dataclass
class Clock:
    """Time codes to seconds since the scene's time 0.

    :param start: time code of time 0
    :param codes_per_second: time codes in a second
    :param end: last time code that the file states; None where it states none
    """

    start: float
    codes_per_second: float
    end: float | None = None
    _outside: int = field(default=0, init=False)

    @staticmethod
    def of(usd_stage: Usd.Stage, notes: Notes) -> Clock:
        """The clock of a USD stage: its authored start, or else the first sample in any layer, or 0.

        A start after the end is said, and the earlier of the two is the start.
        """
        per_second = float(usd_stage.GetTimeCodesPerSecond())
        if not usd_stage.HasAuthoredTimeCodeRange():
            samples = [time for layer in usd_stage.GetUsedLayers() for time in layer.ListAllTimeSamples()]
            return Clock(min((time for time in samples if np.isfinite(time)), default=0.0), per_second)
        start, end = float(usd_stage.GetStartTimeCode()), float(usd_stage.GetEndTimeCode())
        if start > end:
            notes.say(f"startTimeCode {start:g} lies after endTimeCode {end:g}: time 0 is that of {end:g}")
            start, end = end, start
        return Clock(start, per_second, end)

    def seconds(self, code: float) -> float:
        """Seconds since the start."""
        return (code - self.start) / self.codes_per_second

    def saw(self, first_s: float, last_s: float) -> None:
        """Take note of an animation's first and last sample."""
        end_s = np.inf if self.end is None else self.seconds(self.end)
        self._outside += int(first_s < 0.0 or last_s > end_s)

    def note_outside(self, notes: Notes) -> None:
        """Say how many animations have samples outside of the stated range."""
        notes.count(
            "# animations have samples before startTimeCode or after endTimeCode, which count too", self._outside
        )
