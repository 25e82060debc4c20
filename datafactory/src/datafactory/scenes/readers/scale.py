"""Two checks of a scene's scale: a plausible size, and vertices that are fine enough for the wavelength.

float32 keeps 24 bits: at 500 km from the origin neighbouring numbers are 3 cm apart, eight wavelengths of 77 GHz. A
vertex rounded by half a spacing moves its echo's phase by up to 2 * 360 deg * (spacing / 2) / wavelength.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from datafactory.scenes.readers.notes import Notes
from datafactory.scenes.scene import Scene
from shared.physics.units import SPEED_OF_LIGHT

PLAUSIBLE_METRES = (0.1, 50e3)
"""Of a scene's longest side: a tin can, a city."""
WAVELENGTH_M = SPEED_OF_LIGHT / 77e9
COARSE_DEG = 10.0
"""Smaller phase errors of vertices are not noted. float32 vertices reach this about 1 km from the origin."""


def phase_error_deg(spacing_m: float) -> float:
    """Two-way phase error [deg] at 77 GHz of a vertex on a grid of this spacing [m]."""
    return 360.0 * spacing_m / WAVELENGTH_M


def vertex_spacing_m(vertices: NDArray[np.floating], matrix: NDArray[np.float64]) -> float:
    """Spacing [m] of the numbers that a mesh's farthest vertex is written in; 0 for float64, which is always fine.

    :param vertices: [V, 3] in local coordinates, in the precision of the file
    :param matrix: [4, 4] to the world in metres; its offset is added in float64 and costs nothing
    """
    return placed_spacing_m(number_spacing(vertices), matrix)


def number_spacing(vertices: NDArray[np.floating]) -> float:
    """Spacing of the numbers of a mesh's farthest vertex [V, 3], in its own unit; 0 for float64."""
    if vertices.dtype.itemsize > 4:
        return 0.0
    largest = np.float32(np.max(np.abs(vertices), initial=0.0, where=np.isfinite(vertices)))
    # The largest number has infinity above it: its spacing is that to the number below.
    return float(largest - np.nextafter(largest, np.float32(0.0)))


def placed_spacing_m(spacing: float, matrix: NDArray[np.float64]) -> float:
    """The spacing [m] of numbers of this spacing after a transform [4, 4]; 0 where it is too fine for a remark."""
    linear = matrix[:3, :3]
    with np.errstate(over="ignore", invalid="ignore"):
        bound = spacing * float(np.sqrt(np.square(linear).sum()))  # the Frobenius norm, at least the spectral one
    if not np.isfinite(bound) or phase_error_deg(bound) <= COARSE_DEG:
        return 0.0
    return spacing * float(np.linalg.norm(linear, ord=2))


def note_coarse_vertices(spacings_m: Sequence[float], notes: Notes) -> None:
    """Count the meshes whose vertices are too coarse for coherent echoes, with the largest phase error.

    :param spacings_m: :func:`vertex_spacing_m` of every mesh
    """
    coarse = [spacing for spacing in spacings_m if phase_error_deg(spacing) > COARSE_DEG]
    if coarse:
        notes.count(
            f"# meshes have float32 vertices far from their origin, {max(coarse) * 1e3:.2g} mm apart: phases at 77 GHz "
            f"are wrong by up to {phase_error_deg(max(coarse)):.0f} deg; hold the offset in a transform or in doubles",
            len(coarse),
        )


def size_remark(scene: Scene, remedy: str, always: bool = False) -> str:
    """The remark on a scene of implausible size; "" for a plausible one.

    :param remedy: what the user should check
    :param always: return the remark for any size
    """
    if not scene.objects and not scene.targets:
        return ""
    lower, upper = scene.bounds()
    sides = upper - lower
    low, high = PLAUSIBLE_METRES
    if not (always or sides.max() > high or (scene.objects and sides.max() < low)):
        return ""
    text = " x ".join(f"{side:.3g}" for side in sides)
    return f"the scene measures {text} m (x, y, z): check {remedy}"
