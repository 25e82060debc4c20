"""The lobing of a target above ground as a picture: traced levels over range, and the two-ray model in closed form.

``python examples/ground_bounce.py [FILE.png]`` draws docs/ground_bounce.png and prints the largest differences.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from datafactory.paths.merged_scene import merge_scene
from datafactory.paths.rays import RayFan
from datafactory.paths.solver import TraceSettings
from datafactory.paths.trace import trace
from datafactory.scenes.materials.table import Material, load_materials
from datafactory.scenes.poses import Pose
from datafactory.scenes.scene import PointTarget, Scene, SceneObject
from shared.physics.units import SPEED_OF_LIGHT

FREQUENCY_HZ = 77.5e9
WAVELENGTH_M = SPEED_OF_LIGHT / FREQUENCY_HZ
RADAR_M, TARGET_M = 0.5, 0.8
RANGE_M = np.linspace(12.0, 80.0, 3000)
COMPARED_DB = -30.0
"""Levels that are compared, over free space: in a null the level is the difference of nearly equal numbers."""


def traced_db(material: str, polarization: str) -> NDArray[np.float64]:
    """Level over that in free space of targets at ``RANGE_M`` above 400 m of ground [dB]."""
    corners = np.array([(-200.0, -200.0, 0.0), (200.0, -200.0, 0.0), (200.0, 200.0, 0.0), (-200.0, 200.0, 0.0)])
    ground = SceneObject("ground", corners, np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32), material)
    targets = tuple(PointTarget(str(k), (float(x), 0.0, TARGET_M), 0.0) for k, x in enumerate(RANGE_M))
    materials = load_materials().map_materials([material])
    merged = merge_scene(Scene("ground", (ground,), targets), materials)
    settings = TraceSettings(rays=100, diffuse=False, polarization=(polarization, polarization))  # type: ignore[arg-type]
    table = trace(merged, Pose((0.0, 0.0, RADAR_M)), FREQUENCY_HZ, settings, RayFan(100), 1)
    paths = table.scattered
    echo = paths.amplitude * np.exp(4j * np.pi * paths.range_m() / WAVELENGTH_M)
    field = np.bincount(paths.object_index - 1, echo.real) + 1j * np.bincount(paths.object_index - 1, echo.imag)
    free = WAVELENGTH_M / (4.0 * np.pi) ** 1.5 / (RANGE_M**2 + (TARGET_M - RADAR_M) ** 2)
    return 20.0 * np.log10(np.abs(field) / free)


def two_rays_db(material: Material, polarization: str) -> NDArray[np.float64]:
    """40 log10 F with F = |1 + Gamma R_d / R_b exp(-j k (R_b - R_d))|, Fresnel's half space and its rough share."""
    direct, bounced = np.hypot(RANGE_M, TARGET_M - RADAR_M), np.hypot(RANGE_M, TARGET_M + RADAR_M)
    cosine = (TARGET_M + RADAR_M) / bounced
    eta = material.relative_permittivity - 1j * material.conductivity_s_per_m / (
        2.0 * np.pi * FREQUENCY_HZ * 8.8541878128e-12
    )
    root = np.sqrt(eta - 1.0 + cosine**2)
    first = cosine if polarization == "H" else eta * cosine
    gamma = (first - root) / (first + root) * np.sqrt(1.0 - material.scattering_coefficient**2)
    turned = np.exp(-2j * np.pi * (bounced - direct) / WAVELENGTH_M)
    return 40.0 * np.log10(np.abs(1.0 + gamma * direct / bounced * turned))


def main() -> None:
    """Draw three grounds, one below the other."""
    figure = Figure(figsize=(9.0, 8.0), layout="constrained")
    axes = figure.subplots(3, 1, sharex=True, sharey=True)
    for axis, (name, polarization) in zip(axes, (("metal", "V"), ("asphalt", "V"), ("asphalt", "H")), strict=True):
        found = traced_db(name, polarization)
        expected = two_rays_db(load_materials().materials[name], polarization)
        compared = expected > COMPARED_DB
        error = np.abs(found - expected)[compared].max()
        print(f"{name}, {polarization}: at most {error:.3f} dB apart where above {COMPARED_DB:g} dB")
        axis.plot(RANGE_M, expected, color="tab:orange", linewidth=3.0, label="two-ray model")
        axis.plot(RANGE_M, found, color="black", linewidth=0.8, label="traced, four paths")
        axis.axhline(0.0, color="grey", linewidth=0.5)
        axis.set(title=f"{name}, {polarization} polarisation", ylabel="over free space [dB]", ylim=(-45.0, 16.0))
    axes[0].legend(loc="lower right", ncols=2)
    axes[-1].set(xlabel=f"range [m]; radar {RADAR_M:g} m, target {TARGET_M:g} m above the ground")
    figure.savefig(Path(sys.argv[1] if len(sys.argv) > 1 else "docs/ground_bounce.png"), dpi=90)


if __name__ == "__main__":
    main()
