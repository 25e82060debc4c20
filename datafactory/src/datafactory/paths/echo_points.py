"""The echo points of point targets in one frame, with their cross sections."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from datafactory.scenes.scene import PointTarget
from shared.physics.units import db_to_power

Real = NDArray[np.float64]


@dataclass(frozen=True)
class EchoPoints:
    """K echo points of a scene's point targets.

    :param position: [K, 3] world [m]; :param velocity: [K, 3] world [m/s]
    :param rcs_m2: [K] radar cross sections towards the radar [m^2], above 0
    :param target: [K] index of the target that each belongs to
    :param silent: echo points left out because they have no echo in this direction, e.g. a trihedral from behind
    :param near: targets nearer than the smallest distance at which their model holds
    """

    position: Real
    velocity: Real
    rcs_m2: Real
    target: NDArray[np.int32]
    silent: int
    near: int


def echo_points(
    targets: Sequence[PointTarget],
    radar_position: Sequence[float],
    wavelength_m: float,
    cross_polarized: bool = False,
) -> EchoPoints:
    """Every target's echo points, seen from one place, in the targets' order.

    :param targets: as they are at the frame's time
    :param radar_position: [3] world [m]
    :param cross_polarized: the RX's polarisation is across the TX's; a cross section that the scene states as a number
        is used unchanged
    """
    position, velocity, sections, owner = [np.zeros((0, 3))], [np.zeros((0, 3))], [np.zeros(0)], [np.zeros(0, np.int32)]
    near = 0
    for index, target in enumerate(targets):
        origin = np.array(target.position)
        if target.model is None:
            points, values = origin[None, :], db_to_power([target.rcs_dbsm])
        else:
            axes = np.array(target.axes)  # rows: the target's x, y, z in the world
            radar = axes @ (np.asarray(radar_position, dtype=np.float64) - origin)
            local, values = target.model.echoes(radar, wavelength_m)
            points = origin + local @ axes
            near += int(np.linalg.norm(radar) < target.model.far_field_m(wavelength_m))
            if cross_polarized:
                values = values * float(db_to_power(-target.model.cross_polar_ratio_db))
        position.append(points)
        velocities = np.tile(np.array(target.velocity, dtype=np.float64), (len(points), 1))
        if any(target.spin):
            velocities += np.cross(np.array(target.spin), points - origin)
        velocity.append(velocities)
        sections.append(values)
        owner.append(np.full(len(points), index, dtype=np.int32))
    rcs_m2 = np.concatenate(sections)
    heard = rcs_m2 > 0.0
    return EchoPoints(
        position=np.concatenate(position)[heard],
        velocity=np.concatenate(velocity)[heard],
        rcs_m2=rcs_m2[heard],
        target=np.concatenate(owner)[heard],
        silent=int((~heard).sum()),
        near=near,
    )
