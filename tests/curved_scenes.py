"""Scenes of curved bodies, what a trace finds of them, and closed forms to hold it against."""

from __future__ import annotations

import numpy as np
from curved_bodies import Mesh
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.special import fresnel
from sionna_scenes import FREQUENCY_HZ, WAVELENGTH_M, mesh, scene_of
from slab_coefficients import slab_reflection

from datafactory.paths.rays import RayFan
from datafactory.paths.solver import TraceSettings
from datafactory.paths.table import PathTable
from datafactory.paths.trace import trace
from datafactory.scenes.poses import Pose
from datafactory.scenes.scene import SceneObject

Real = NDArray[np.float64]
HOME = Pose((0.0, 0.0, 0.0))
WAVENUMBER = 2.0 * np.pi / WAVELENGTH_M
METAL, GLASS = (
    slab_reflection(*slab, FREQUENCY_HZ, np.ones(1))[0][0] for slab in ((1.0, 1e7, 0.1), (6.31, 1.211, 0.006))
)
"""Reflection coefficients at normal incidence."""


def turned(seed: int) -> Rotation:
    return Rotation.random(random_state=np.random.default_rng(seed))


def body(
    of: Mesh, centre, turn: Rotation | None = None, material: str = "metal", velocity=(0.0, 0.0, 0.0)
) -> SceneObject:
    vertices = of[0] if turn is None else turn.apply(of[0])
    return mesh("body", vertices + np.asarray(centre, dtype=float), of[1], material, velocity)


def traced(*objects: SceneObject, pose: Pose = HOME, **settings) -> PathTable:
    chosen = TraceSettings(**{"rays": 2000, "depth": 1, "diffuse": False, **settings})
    return trace(scene_of(*objects), pose, FREQUENCY_HZ, chosen, RayFan(chosen.rays), 1)


def amplitudes(table: PathTable) -> NDArray[np.complex128]:
    return np.concatenate([table.scattered.amplitude, table.specular.amplitude])


def level_db(table: PathTable, expected: float) -> float:
    """The only echo's amplitude over the expected one [dB]."""
    (amplitude,) = amplitudes(table)
    return float(20.0 * np.log10(abs(amplitude / METAL) / expected))


def sphere_amplitude(radius: float, distance: float) -> float:
    """Of a metal sphere with its centre at this distance, in the near field too."""
    return WAVELENGTH_M / (8.0 * np.pi * (distance - radius)) * radius / distance


def cylinder_amplitude(radius: float, length: float, distance: float) -> float:
    """Of a metal cylinder seen broadside at its middle, with its axis at this distance, in the near field too."""
    range_m = distance - radius
    sine, cosine = fresnel(np.sqrt(2.0) * 0.5 * length * np.sqrt(2.0 / (range_m * WAVELENGTH_M)))
    share = np.sqrt(2.0) * abs(cosine + 1j * sine)
    return WAVELENGTH_M / (8.0 * np.pi * range_m) * share / np.sqrt(1.0 + range_m / radius)
