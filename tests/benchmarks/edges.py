"""Where mirrors and edges together are not a face's field: ``PYTHONPATH=tests python tests/benchmarks/edges.py``.

Faces 5 m ahead of the radar, whose foot on their plane moves by up to 10 cm. Printed is the largest difference from
physical optics, in the Fresnel approximation: beyond both edges of a plate's corner, where one mesh begins within
another in the same plane, and across a seam between two materials.
"""

from collections.abc import Callable, Sequence

import numpy as np
from scipy.special import fresnel
from sionna_scenes import WAVELENGTH_M, every_one, plate, scene_of, slabs, view_of

from datafactory.paths.backend import select_variant
from datafactory.paths.diffraction import EdgeEchoes
from datafactory.paths.mirrors import single_mirrors
from datafactory.scenes.poses import Pose
from datafactory.scenes.scene import SceneObject

DISTANCE_M = 5.0
NEAR_M = np.array([1e-4, 0.005, 0.01, 0.02, 0.05, 0.1])
UP, HIGH = (0.0, 0.0, 3.0), (0.0, 3.0, 0.0)


def echo(faces: Sequence[SceneObject], y: float, z: float) -> float:
    """Mirrors and edges of the plane with the radar at (0, y, z), over what a whole mirror sends back."""
    view = view_of(scene_of(*faces), Pose((0.0, y, z)))
    total = 0.0j
    for part in (single_mirrors(view)[0], *every_one(EdgeEchoes(view))[:2]):
        total += (part.amplitude * np.exp(4j * np.pi / WAVELENGTH_M * (part.range_m() - DISTANCE_M))).sum()
    return abs(total) / (WAVELENGTH_M / (8.0 * np.pi * DISTANCE_M))


def half(y: float) -> complex:
    """What the half plane from 0 on has of a whole mirror's field, seen from y."""
    sine, cosine = fresnel(2.0 * y / np.sqrt(DISTANCE_M * WAVELENGTH_M))
    return complex((0.5 + cosine + 1j * (0.5 + sine)) / (1.0 + 1j))


def told(what: str, faces: Sequence[SceneObject], places: Sequence[tuple[float, float]],
         exact: Callable[[float, float], complex]) -> None:  # fmt: skip
    """Print the least and the most difference [dB]."""
    off = [20.0 * np.log10(echo(faces, *place) / abs(exact(*place))) for place in places]
    print(f"{what}: {min(off):+.1f} to {max(off):+.1f} dB")


def main() -> None:
    """Print all."""
    select_variant()
    beside = [(float(y), 0.0) for y in (*-NEAR_M, *NEAR_M)]
    first = plate("first", (DISTANCE_M, 3.0, 0.0), HIGH, UP, "metal")
    told("a plate's edge", [first], beside, lambda y, z: half(y))
    corner = plate("corner", (DISTANCE_M, 3.0, 3.0), HIGH, UP, "metal")
    told("beyond one edge of its corner", [corner], [(-y, z) for y in NEAR_M for z in NEAR_M],
         lambda y, z: half(y) * half(z))  # fmt: skip
    told("beyond both edges", [corner], [(-y, -z) for y in NEAR_M for z in NEAR_M], lambda y, z: half(y) * half(z))
    wide = plate("wide", (DISTANCE_M, 1.0, 0.0), HIGH, UP, "metal")
    told("a mesh that begins within another", [first, wide], beside, lambda y, z: 1.0)
    glass = plate("glass", (DISTANCE_M, -3.0, 0.0), HIGH, UP, "glass")
    of = slabs(scene_of(first, glass))
    metal_back, glass_back = (of.reflection(np.array([mesh]), np.ones(1))[0][0] for mesh in (0, 1))
    told("a seam of metal and glass", [first, glass], beside,
         lambda y, z: metal_back * half(y) + glass_back * half(-y))  # fmt: skip


if __name__ == "__main__":
    main()
