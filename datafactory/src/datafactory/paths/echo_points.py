"""The echo points of point targets in one frame, with their cross sections."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from datafactory.paths.columns import WHOLE, Columns
from datafactory.scenes.poses import Pose
from datafactory.scenes.scene import PointTarget
from datafactory.scenes.targets.bodies import Motion
from shared.physics.units import db_to_power
from shared.physics.vectors import Real


@dataclass(frozen=True)
class EchoPoints(Columns):
    """K echo points of a scene's point targets.

    :param position: [K, 3] [m]; :param velocity: [K, 3] [m/s], both of the world until :meth:`seen_by`
    :param rcs_m2: [K] radar cross sections towards the radar [m^2], above 0; 0 of silent points that were asked for
    :param target: [K] index of the target that each belongs to, rising; :param place: [K] which of its points it is
    :param silent: echo points that have no echo in this direction, e.g. a trihedral's from behind
    :param near: targets nearer than the smallest distance at which their model holds
    """

    position: Real
    velocity: Real
    rcs_m2: Real
    target: NDArray[np.int32]
    place: NDArray[np.intp]
    silent: int = field(metadata=WHOLE)
    near: int = field(metadata=WHOLE)

    def heard(self) -> EchoPoints:
        """Those with an echo."""
        return self.take(self.rcs_m2 > 0.0)

    def seen_by(self, pose: Pose) -> EchoPoints:
        """The same points in the radar frame, velocities relative to the radar."""
        return replace(self, position=pose.seen(self.position), velocity=pose.seen_velocity(self.velocity))

    def amplitudes(self, wavelength_m: float) -> Real:
        """[K] lambda sqrt(sigma) / (4 pi)^(3/2) [m^2]: of their echoes before either leg spreads it."""
        return wavelength_m * np.sqrt(self.rcs_m2) / (4.0 * np.pi) ** 1.5


@dataclass(frozen=True)
class Seen:
    """The circumstances in which targets are seen.

    :param wavelength_m: [m]
    :param time_s: since the scene's time 0 [s], for moving parts; targets are given as they are then
    :param cross_polarized: the RX's polarisation is across the TX's; a cross section that the scene states as a number
        is used unchanged
    :param seed: of where in their cycle moving parts are at time 0
    """

    wavelength_m: float
    time_s: float = 0.0
    cross_polarized: bool = False
    seed: int = 0

    def motion(self, target: PointTarget, index: int) -> Motion:
        """How a target moves; the seed is its own."""
        forward = float(np.dot(target.axes[0], target.velocity))
        own = int(np.random.SeedSequence(self.seed, spawn_key=(index,)).generate_state(1)[0])
        return Motion(forward, self.time_s, own)


def seen_from(target: PointTarget, index: int, radar_position: Sequence[float] | Real, seen: Seen) -> EchoPoints:
    """All echo points of one target, silent ones among them; as many, in the same order, from everywhere.

    :param index: number of the target among the scene's
    :param radar_position: [3] world [m]
    """
    origin = np.array(target.position)
    near = 0
    own = np.zeros((1, 3))
    if target.model is None:
        points, values = origin[None, :], db_to_power([target.rcs_dbsm])
    else:
        axes = np.array(target.axes)  # rows: the target's x, y, z in the world
        radar = axes @ (np.asarray(radar_position, dtype=np.float64) - origin)
        local, values = target.model.echoes(radar, seen.wavelength_m)
        moving = target.model.parts(radar, seen.motion(target, index))
        points = origin + np.concatenate([local, moving.position]) @ axes
        values = np.concatenate([values, moving.rcs_m2])
        own = np.concatenate([np.zeros_like(local), moving.velocity]) @ axes
        near = int(np.linalg.norm(radar) < target.model.far_field_m(seen.wavelength_m))
        if seen.cross_polarized:
            values = values * float(db_to_power(-target.model.cross_polar_ratio_db))
    velocity = np.array(target.velocity, dtype=np.float64) + own
    if any(target.spin):
        velocity += np.cross(np.array(target.spin), points - origin)
    owner = np.full(len(points), index, dtype=np.int32)
    return EchoPoints(points, velocity, values, owner, np.arange(len(points)), int((values <= 0.0).sum()), near)


def all_echo_points(targets: Sequence[PointTarget], radar_position: Sequence[float], seen: Seen) -> EchoPoints:
    """Every target's echo points, silent ones among them, in the targets' order.

    :param radar_position: [3] world [m]
    """
    none = EchoPoints(
        np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), np.zeros(0, np.int32), np.zeros(0, np.intp), 0, 0
    )
    parts = [none, *(seen_from(target, index, radar_position, seen) for index, target in enumerate(targets))]
    return EchoPoints.joined(parts, silent=sum(part.silent for part in parts), near=sum(part.near for part in parts))
