"""Walls, mirrors and roads of closed forms, and one trace of them: walls of metal reflect 1 at every angle."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from sionna_scenes import FREQUENCY_HZ, mapping, material, plate

from datafactory.paths import solver as solver_module
from datafactory.paths.geometry import placed
from datafactory.paths.merged_scene import merge_scene
from datafactory.paths.rays import RayFan
from datafactory.paths.slabs import Slabs
from datafactory.paths.solver import TraceSettings
from datafactory.paths.table import PathTable
from datafactory.paths.trace import trace
from datafactory.scenes.poses import Pose
from datafactory.scenes.scene import Scene, SceneObject

RADAR_AT_ORIGIN = Pose((0.0, 0.0, 0.0))
SCATTERING = 0.6
MATERIALS = mapping(
    material("mirror", 1.0, 1e7, 0.1),
    material("rough", 1.0, 1e7, 0.1, SCATTERING),
    material("concrete", 5.24, 1.38, 0.1),
)


def wall(
    of: str, distance_m: float = 10.0, half_m: float = 300.0, velocity=(0.0, 0.0, 0.0), name="wall"
) -> SceneObject:
    return plate(name, (distance_m, 0.0, 0.0), (0.0, half_m, 0.0), (0.0, 0.0, half_m), of, velocity)


def side_wall(of: str, name="side") -> SceneObject:
    return plate(name, (10.0, 6.0, 0.0), (10.0, 0.0, 0.0), (0.0, 0.0, 10.0), of)


def traced(
    *objects: SceneObject,
    pose: Pose = RADAR_AT_ORIGIN,
    fan: RayFan | None = None,
    rays: int = 20_000,
    seed: int = 1,
    **settings,
) -> PathTable:
    merged = merge_scene(Scene("test", objects), MATERIALS)
    chosen = TraceSettings(
        rays=rays, **{"depth": 1, "paths_a_cell": 0, "solver_share": 1, "twice_share": 1, **settings}
    )
    return trace(merged, pose, FREQUENCY_HZ, chosen, fan or RayFan(rays), seed)


def solved(*objects: SceneObject, fan: RayFan, rays: int, **settings):
    """The solver's own Paths of the same trace."""
    merged = merge_scene(Scene("test", objects), MATERIALS)
    chosen = TraceSettings(rays=rays, **settings)
    slabs = Slabs(merged.slabs, FREQUENCY_HZ)
    scene = solver_module.radio_scene(placed(merged, RADAR_AT_ORIGIN), slabs, chosen)
    return solver_module.solver_paths(scene, chosen, fan, 1)


class WholeSphere(RayFan):
    """Sionna's own lattice, each ray standing for 4 pi / N."""

    aimable = False

    def unit_square(self) -> NDArray[np.float64]:
        from sionna.rt.utils import fibonacci_lattice

        return fibonacci_lattice(self.count).numpy().T.astype(np.float64)

    def solid_angle_ratio(self, directions: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.ones(len(directions))


def power(paths) -> float:
    return float(np.sum(np.abs(paths.amplitude) ** 2))


def decibels(ratio: float) -> float:
    return float(10.0 * np.log10(ratio))
