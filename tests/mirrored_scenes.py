"""Targets over mirrors: the ground, what it reflects, a point, and one trace of them."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sionna_scenes import FREQUENCY_HZ, WAVELENGTH_M, mapping, material, scene_of, traced

from datafactory.paths.table import TARGET, PathTable, ScatteredPaths
from datafactory.scenes.materials.table import Material, load_materials
from datafactory.scenes.poses import Pose
from datafactory.scenes.scene import PointTarget, SceneObject

ASPHALT = load_materials().materials["asphalt"]
METAL = material("mirror", 1.0, 1e7, 0.1)
MATERIALS = mapping(METAL, ASPHALT)


def ground(
    of: str = "mirror",
    x: tuple[float, float] = (-400.0, 400.0),
    y: tuple[float, float] = (-400.0, 400.0),
    name: str = "ground",
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> SceneObject:
    """A level rectangle at z = 0."""
    vertices = np.array([(a, b, 0.0) for a, b in ((x[0], y[0]), (x[1], y[0]), (x[1], y[1]), (x[0], y[1]))])
    return SceneObject(name, vertices, np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32), of, velocity)


def point(position: Sequence[float], velocity: Sequence[float] = (0.0, 0.0, 0.0)) -> PointTarget:
    x, y, z = position
    a, b, c = velocity
    return PointTarget("post", (x, y, z), 0.0, (a, b, c))


def echoes(
    objects: Sequence[SceneObject], targets: Sequence[PointTarget], pose: Pose, **settings: Any
) -> tuple[ScatteredPaths, PathTable]:
    """The targets' paths, and the whole table."""
    merged = scene_of(*objects, targets=targets, materials=MATERIALS)
    table = traced(merged, pose, **{"rays": 100, "depth": 2, "diffuse": False, **settings})
    return table.scattered.take(table.scattered.kinds & TARGET > 0), table


def level_db(paths: ScatteredPaths) -> float:
    """Of the coherent sum at the carrier of the trace, at t = 0 [dB]."""
    phase = 2.0 * np.pi * 2.0 * paths.range_m() / WAVELENGTH_M
    return float(20.0 * np.log10(abs(np.sum(paths.amplitude * np.exp(1j * phase)))))


def fresnel(material: Material, cosine: NDArray, polarization: str) -> NDArray:
    """Reflection of a half space: what enters 0.1 m of metal or 0.2 m of asphalt does not come back."""
    eta = material.relative_permittivity - 1j * material.conductivity_s_per_m / (
        2.0 * np.pi * FREQUENCY_HZ * 8.8541878128e-12
    )
    root = np.sqrt(eta - (1.0 - cosine**2))
    if polarization == "H":
        return (cosine - root) / (cosine + root)
    return (eta * cosine - root) / (eta * cosine + root)


def two_rays_db(material: Material, range_m: NDArray, radar_m: float, target_m: float, polarization: str) -> NDArray:
    """Level of a target of 0 dBsm over a smooth or rough plane by the two-ray model, one-way fields squared [dB]."""
    direct = np.hypot(range_m, target_m - radar_m)
    bounced = np.hypot(range_m, target_m + radar_m)
    gamma = fresnel(material, (target_m + radar_m) / bounced, polarization)
    gamma = gamma * np.sqrt(1.0 - material.scattering_coefficient**2)
    wavenumber = 2.0 * np.pi / WAVELENGTH_M
    field = np.exp(-1j * wavenumber * direct) / direct + gamma * np.exp(-1j * wavenumber * bounced) / bounced
    return 20.0 * np.log10(WAVELENGTH_M / (4.0 * np.pi) ** 1.5 * np.abs(field) ** 2)
