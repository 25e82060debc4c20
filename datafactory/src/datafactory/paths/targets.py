"""Echoes of targets that are given by their radar cross section."""

from __future__ import annotations

from typing import Any

import numpy as np

from datafactory.paths.stage import Stage
from datafactory.paths.table import ScatteredPaths
from datafactory.scenes.materials import MaterialMapping
from datafactory.scenes.poses import Pose
from shared.units import SPEED_OF_LIGHT, db_to_power


def target_echoes(
    geometry: Any, stage: Stage, materials: MaterialMapping, pose: Pose, frequency_hz: float, refraction: bool
) -> tuple[ScatteredPaths, int]:
    """Echoes of the point targets that the radar can see, and the number of those that it cannot.

    Radar equation for isotropic antennas of unit power: lambda sqrt(sigma) / ((4 pi)^(3/2) R^2).

    :param geometry: Mitsuba's scene in the radar frame
    :param refraction: whether targets behind panes are seen through them
    """
    import mitsuba as mi

    first = len(stage.objects) - len(stage.targets)
    position = np.array([target.position for target in stage.targets]).reshape(-1, 3)
    velocity = np.array([target.velocity for target in stage.targets]).reshape(-1, 3)
    rotation = pose.rotation()
    position = (position + velocity * pose.time_s - np.asarray(pose.position)) @ rotation
    velocity = (velocity - np.asarray(pose.velocity)) @ rotation
    range_m = np.linalg.norm(position, axis=1)
    visible = range_m > 0.0
    if len(position):
        direction = position / np.where(visible, range_m, 1.0)[:, None]
        ray = mi.Ray3f(mi.Point3f(0.0), mi.Vector3f(*direction.T.astype(np.float32)))
        ray.maxt = range_m.astype(np.float32)
        visible &= ~geometry.ray_test(ray).numpy()
    cross_section = db_to_power([target.rcs_dbsm for target in stage.targets])
    amplitude = SPEED_OF_LIGHT / frequency_hz * np.sqrt(cross_section) / (4.0 * np.pi) ** 1.5
    amplitude = amplitude / np.where(visible, range_m, 1.0) ** 2
    index = np.arange(first, len(stage.objects), dtype=np.int32)
    echoes = ScatteredPaths.of_points(position, velocity, amplitude, index)
    return echoes.take(visible), int((~visible).sum())
