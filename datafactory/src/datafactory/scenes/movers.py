"""What moves in a scene, and whether a sensor keeps clear of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from datafactory.scenes.motion import Moving, drift
from datafactory.scenes.poses import Pose
from datafactory.scenes.scene import Scene

Box = tuple[NDArray[np.float64], NDArray[np.float64]]

CLEAR_M = 3.0
"""A drawn sensor is so far from everything that drives or walks by: nothing passes through it."""
TRIES = 64
"""Times that are drawn for a frame until its sensor stands clear."""


class Movers:
    """The boxes around everything that moves in a scene, upright and along the world's axes, at any time.

    What is only shifted is measured once; of what turns, every vertex is placed anew.
    """

    def __init__(self, scene: Scene) -> None:
        moving = [item for item in scene.objects if item.moves]
        self._turning = [item for item in moving if isinstance(item.motion, Moving)]
        self._shifted = [
            (item, (item.vertices.min(axis=0), item.vertices.max(axis=0)))
            for item in moving
            if not isinstance(item.motion, Moving)
        ]
        self._targets = [item for item in scene.targets if item.motion is not None or any(item.velocity)]
        every = [item.motion for item in moving] + [target.motion for target in self._targets]
        self.rests_from_s = max((motion.ends_s for motion in every if motion is not None), default=np.inf)
        """From when on what has samples rests [s]; inf where nothing has."""

    def __bool__(self) -> bool:
        return bool(self._turning or self._shifted or self._targets)

    def boxes(self, time_s: float) -> list[Box]:
        """Lower and upper corner [3] [m] of each at a time [s]."""
        found: list[Box] = []
        for item, (lower, upper) in self._shifted:
            assert not isinstance(item.motion, Moving)
            shift, _ = drift(item.velocity, item.motion, time_s)
            found.append((lower + shift, upper + shift))
        for item in self._turning:
            vertices = item.at(time_s).vertices
            found.append((vertices.min(axis=0), vertices.max(axis=0)))
        for target in self._targets:
            middle = np.asarray(target.at(time_s).position)
            reach = target.model.footprint_m if target.model is not None else 0.0
            found.append((middle - reach, middle + reach))
        return found

    def clear_of(self, poses: Sequence[Pose], least_m: float) -> bool:
        """Whether poses, each at its time, keep at least this from every box [m]."""
        for pose in poses if self else ():
            corners = np.array(self.boxes(pose.time_s))
            here = np.asarray(pose.position)
            outside = np.maximum(np.maximum(corners[:, 0] - here, here - corners[:, 1]), 0.0)
            if np.linalg.norm(outside, axis=1).min() < least_m:
                return False
        return True


@dataclass(frozen=True, eq=False)
class Traffic:
    """What moves in a populated scene, for frames that have no time yet.

    :param until_s: it runs from time 0 to here [s]
    """

    movers: Movers
    until_s: float

    @staticmethod
    def of(scene: Scene) -> Traffic | None:
        """None of a scene that is not populated, or in which nothing moves."""
        movers = Movers(scene)
        return Traffic(movers, scene.population.horizon_s) if scene.population is not None and movers else None

    def clear_of(self, pose: Pose) -> bool:
        """Whether a sensor keeps ``CLEAR_M`` from everything at its pose's time."""
        return self.movers.clear_of([pose], CLEAR_M)

    def at_a_clear_time(self, pose: Pose, rng: np.random.Generator) -> Pose:
        """The pose at a drawn time at which nothing is near; at the last of 64 drawn ones where something always is."""
        for time_s in rng.uniform(0.0, self.until_s, TRIES).tolist():
            pose = replace(pose, time_s=time_s)
            if self.clear_of(pose):
                break
        return pose
