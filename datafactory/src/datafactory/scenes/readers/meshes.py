"""Triangle meshes: placing them in the world, and dropping triangles that no ray tracer can use."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from datafactory.scenes.chain import placed
from datafactory.scenes.readers.notes import Notes
from shared.physics.units import FARTHEST_M

Y_UP_TO_Z_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])  # (x, y, z) -> (x, -z, y)
FLAT = 1e-12  # twice a triangle's area over its longest edge squared: below this float64 cannot tell it from a line


@dataclass(frozen=True)
class Dropped:
    """Triangles that a mesh lost in cleaning, by reason."""

    out_of_range: int = 0
    not_finite: int = 0
    beyond: int = 0
    no_area: int = 0

    def add_to(self, notes: Notes) -> None:
        notes.count("# triangles with a vertex index out of range dropped", self.out_of_range)
        notes.count("# triangles with a NaN or infinite vertex dropped", self.not_finite)
        notes.count(f"# triangles with a vertex beyond {FARTHEST_M:g} m dropped", self.beyond)
        notes.count("# triangles without area dropped", self.no_area)


def clean_mesh(
    vertices: NDArray[np.floating], triangles: NDArray[np.integer]
) -> tuple[NDArray[np.float64], NDArray[np.int32], Dropped]:
    """Drop triangles that no ray tracer can use, and vertices that no triangle uses.

    :param vertices: [V, 3]
    :param triangles: [T, 3] vertex indices
    :return: vertices [V', 3] float64, triangles [T', 3] int32 in the order given, and what was dropped
    """
    vertices = np.asarray(vertices, dtype=np.float64).reshape(-1, 3)
    kept, dropped = usable_triangles(vertices, triangles)
    used, compact = np.unique(kept, return_inverse=True)
    return vertices[used], compact.reshape(-1, 3).astype(np.int32), dropped


def usable_triangles(
    vertices: NDArray[np.float64], triangles: NDArray[np.integer]
) -> tuple[NDArray[np.int64], Dropped]:
    """The triangles [T', 3] that a ray tracer can use, in the order given, and what was dropped.

    :param vertices: [V, 3]; :param triangles: [T, 3] vertex indices
    """
    triangles = np.asarray(triangles, dtype=np.int64).reshape(-1, 3)
    inside = np.all((triangles >= 0) & (triangles < len(vertices)), axis=1)
    kept = triangles[inside]
    finite = np.isfinite(vertices[kept]).all(axis=(1, 2))
    kept = kept[finite]
    near = (np.abs(vertices[kept]) <= FARTHEST_M).all(axis=(1, 2))
    kept = kept[near]
    solid = _has_area(vertices[kept])
    kept = kept[solid]
    return kept, Dropped(*(int((~mask).sum()) for mask in (inside, finite, near, solid)))


def usable(corners: NDArray[np.float64]) -> NDArray[np.bool_]:
    """[T] whether :func:`clean_mesh` keeps triangles with these corners [T, 3, 3]."""
    with np.errstate(invalid="ignore", over="ignore"):
        solid = _has_area(corners)
    near = np.all(np.abs(corners) <= FARTHEST_M, axis=(1, 2))  # false for NaN
    kept: NDArray[np.bool_] = solid & near
    return kept


def _has_area(corners: NDArray[np.float64]) -> NDArray[np.bool_]:
    edges = np.roll(corners, -1, axis=1) - corners  # [T, 3, 3]
    doubled_area = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    solid: NDArray[np.bool_] = doubled_area > FLAT * np.square(edges).sum(axis=2).max(axis=1, initial=0.0)
    return solid


def place_mesh(
    vertices: NDArray[np.floating], triangles: NDArray[np.integer], matrix: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.integer]]:
    """Apply an affine transform in float64, and keep outer sides outside under a mirror.

    :param vertices: [V, 3]
    :param triangles: [T, 3] vertex indices; counter-clockwise seen from outside
    :param matrix: [4, 4] acting on column vectors; a negative determinant reverses the winding
    """
    # NaN, infinite and absurdly far vertices are dropped and counted in ``clean_mesh``.
    return placed(vertices, matrix), triangles[:, ::-1] if mirrors(matrix) else triangles


def mirrors(matrix: NDArray[np.float64]) -> bool:
    """Whether an affine transform [4, 4] turns outer sides in."""
    with np.errstate(invalid="ignore", over="ignore"):
        return bool(np.linalg.det(matrix[:3, :3]) < 0)
