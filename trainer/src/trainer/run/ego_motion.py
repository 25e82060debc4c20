"""Which velocity the sensor has in a frame: told with the command, by the source, or seen in the frame itself."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from shared.signal.ego_motion import EgoMotion
from trainer.data.measurements import Measurement
from trainer.run.answers import Answer


@dataclass
class Motions:
    """The frames of one command.

    :param velocity: of the vehicle, forward and to the left [m/s], where the command says it
    :param yaw_deg: of the radar on it, with ``velocity``
    :param wanted: whether anything asks for the motion: without that none is estimated
    :ivar estimated: frames in which it was looked for
    :ivar unknown: of these, where too few echoes agree
    :ivar largest_std_mps: of those estimated
    """

    velocity: tuple[float, float] | None
    yaw_deg: float
    wanted: bool
    estimated: int = 0
    unknown: int = 0
    largest_std_mps: float = 0.0

    def told(self, measurement: Measurement, answer: Answer) -> Measurement:
        """The frame with the sensor's motion as well as it is known."""
        if self.velocity is not None:
            told = EgoMotion.of_vehicle(*self.velocity, math.radians(self.yaw_deg))
            measurement = replace(measurement, motion=told)
        if measurement.motion is not None or not self.wanted:
            return measurement
        motion = answer.seen_motion(measurement)
        self.estimated += 1
        if motion is None:
            self.unknown += 1
        else:
            self.largest_std_mps = max(self.largest_std_mps, *motion.std_mps)
        return replace(measurement, motion=motion)

    def __str__(self) -> str:
        found = self.estimated - self.unknown
        spread = f", standard deviation at most {self.largest_std_mps:.2g} m/s" if found else ""
        none = f"; in {self.unknown} too few echoes agree, and it is not known" if self.unknown else ""
        return f"the sensor's velocity was estimated in {found} of {self.estimated} frames{spread}{none}"
