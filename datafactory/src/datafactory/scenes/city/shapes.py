"""Closed polygon surfaces with a material on every face, of which the procedural city is built.

Metres, z up. Corners run counter-clockwise seen from outside, so that every normal points out of the body.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray

MILLIMETRE_DECIMALS = 3
"""Vertices are rounded to 1 mm: nearly equal corners are welded, and a file does not depend on a library's sine."""

X_TO_Z_CYCLE = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
"""Proper rotation (x, y, z) -> (z, x, y): lays the z axis of a prism along x."""

QUARTER_TURN_X = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""Proper rotation (x, y, z) -> (x, -z, y): lays the z axis of a prism along -y."""


@dataclass(frozen=True)
class Polygon:
    """One planar convex face.

    :param corners: [n, 3] corners [m], counter-clockwise seen from outside
    :param material: material key, e.g. ``"brick"``
    """

    corners: NDArray[np.float64]
    material: str


@dataclass(frozen=True)
class Surface:
    """Welded polygons.

    :param vertices: [V, 3] [m], float64, rounded
    :param faces: vertex indices of each planar convex face, counter-clockwise seen from outside
    :param materials: the material key of each face
    """

    vertices: NDArray[np.float64]
    faces: tuple[tuple[int, ...], ...]
    materials: tuple[str, ...]

    def moved(
        self, offset: ArrayLike, rotation: ArrayLike | None = None, decimals: int = MILLIMETRE_DECIMALS
    ) -> Surface:
        """The same body rotated by a proper rotation [3, 3] and then shifted by ``offset`` [3] in metres."""
        turned = self.vertices if rotation is None else self.vertices @ np.asarray(rotation, dtype=np.float64).T
        return Surface(np.round(turned + np.asarray(offset), decimals), self.faces, self.materials)


def welded(polygons: Iterable[Polygon], decimals: int = MILLIMETRE_DECIMALS) -> Surface:
    """Polygons to one surface in which corners that are equal to these decimals are one vertex."""
    index: dict[tuple[float, ...], int] = {}
    faces, materials = [], []
    for polygon in polygons:
        # Adding 0.0 turns -0.0 into 0.0: the two compare equal but print differently.
        corners = [tuple(corner) for corner in (np.round(polygon.corners, decimals) + 0.0).tolist()]
        faces.append(tuple(index.setdefault(corner, len(index)) for corner in corners))
        materials.append(polygon.material)
    return Surface(np.array(list(index), dtype=np.float64).reshape(-1, 3), tuple(faces), tuple(materials))


def joined(surfaces: Sequence[Surface]) -> Surface:
    """Several bodies as one surface; each stays closed by itself and nothing is cut where they overlap."""
    starts = np.cumsum([0, *(len(item.vertices) for item in surfaces)])
    faces = [
        tuple(vertex + int(start) for vertex in face)
        for item, start in zip(surfaces, starts[:-1], strict=True)
        for face in item.faces
    ]
    materials = [key for item in surfaces for key in item.materials]
    return Surface(np.concatenate([item.vertices for item in surfaces]), tuple(faces), tuple(materials))


def prism(profile: ArrayLike, bottom: float, top: float, material: str) -> Surface:
    """Closed right prism over a convex profile.

    :param profile: [n, 2] corners (x, y) [m], counter-clockwise seen from above
    :param bottom: z of the base [m]
    :param top: z of the lid [m], above ``bottom``
    """
    profile = np.asarray(profile, dtype=np.float64)
    low = np.column_stack([profile, np.full(len(profile), bottom)])
    high = np.column_stack([profile, np.full(len(profile), top)])
    sides = [
        np.array([low[i], low[j], high[j], high[i]])
        for i, j in enumerate(np.roll(np.arange(len(profile)), -1).tolist())
    ]
    return welded(Polygon(corners, material) for corners in [low[::-1], high, *sides])


def cylinder(radius: float, bottom: float, top: float, sides: int, material: str) -> Surface:
    """Closed upright cylinder about the z axis; its ``sides`` corners lie on the circle of ``radius`` [m]."""
    angle = 2.0 * np.pi * np.arange(sides) / sides
    return prism(radius * np.column_stack([np.cos(angle), np.sin(angle)]), bottom, top, material)


def box(lower: Sequence[float], upper: Sequence[float], material: str) -> Surface:
    """Closed box between two opposite corners (x, y, z) [m]."""
    profile = [(lower[0], lower[1]), (upper[0], lower[1]), (upper[0], upper[1]), (lower[0], upper[1])]
    return prism(profile, lower[2], upper[2], material)


def blob(radii: Sequence[float], roughness: float, rng: np.random.Generator, material: str) -> Surface:
    """Closed ellipsoid of 80 triangles about the origin with a ragged surface: a tree crown, or a head.

    :param radii: semi-axes (x, y, z) [m]
    :param roughness: largest relative change of a vertex's radius, 0 to 1
    """
    sphere = trimesh.creation.icosphere(subdivisions=1)
    stretch = 1.0 + roughness * rng.uniform(-1.0, 1.0, (len(sphere.vertices), 1))
    points = np.asarray(sphere.vertices) * stretch * np.asarray(radii)
    return welded(Polygon(points[list(face)], material) for face in sphere.faces.tolist())


def stepped_surface(
    us: Sequence[float], vs: Sequence[float], heights: ArrayLike, material: Callable[[int, int], str]
) -> list[Polygon]:
    """A terrace over a grid of cells: one flat quad for each cell, one upright quad wherever neighbours differ.

    Kerbs along a road and recesses in a facade are both this surface. Corners are (u, v, w), w along the height; an
    upright quad has the material of the higher of its two cells.

    :param us: [nu + 1] rising grid lines [m]
    :param vs: [nv + 1] rising grid lines [m]
    :param heights: [nu, nv] height w of each cell [m]
    :param material: material key of cell (i, j)
    """
    heights = np.asarray(heights, dtype=np.float64)
    polygons = []
    for i, j in np.ndindex(heights.shape):
        (u0, u1), (v0, v1), h = us[i : i + 2], vs[j : j + 2], heights[i, j]
        polygons.append(Polygon(np.array([(u0, v0, h), (u1, v0, h), (u1, v1, h), (u0, v1, h)]), material(i, j)))
        for di, dj, (a, b) in [(1, 0, ((u1, v0), (u1, v1))), (0, 1, ((u1, v1), (u0, v1)))]:
            if i + di == heights.shape[0] or j + dj == heights.shape[1] or heights[i + di, j + dj] == h:
                continue
            other = heights[i + di, j + dj]
            low, high = min(h, other), max(h, other)
            corners = np.array([(*a, low), (*b, low), (*b, high), (*a, high)])
            # As written the normal points towards rising u or v, which is right where this cell is the higher one.
            higher = (i, j) if h > other else (i + di, j + dj)
            polygons.append(Polygon(corners if h > other else corners[::-1], material(*higher)))
    return polygons


def framed_pane(corners: NDArray[np.float64], border: float, recess: float, frame: str) -> list[Polygon]:
    """A planar quad as a frame around a pane of glass that lies ``recess`` behind it; the outline stays as it is.

    :param corners: [4, 3] outline [m], counter-clockwise seen from outside; parallel sides 0-1 and 2-3
    :param border: width of the frame [m]
    :param recess: depth of the pane behind the frame [m], above 0
    """
    a, b, c, d = corners
    along = border / float(min(np.linalg.norm(b - a), np.linalg.norm(c - d)))
    up = border / float(min(np.linalg.norm(d - a), np.linalg.norm(c - b)))

    def inside(s: float, t: float) -> NDArray[np.float64]:
        return (1 - s) * (1 - t) * a + s * (1 - t) * b + s * t * c + (1 - s) * t * d

    inner = np.array([inside(along, up), inside(1 - along, up), inside(1 - along, 1 - up), inside(along, 1 - up)])
    normal = np.cross(b - a, d - a)
    sunk = inner - recess * normal / np.linalg.norm(normal)
    polygons = [Polygon(sunk, "glass")]
    for i, j in [(0, 1), (1, 2), (2, 3), (3, 0)]:
        polygons.append(Polygon(np.array([corners[i], corners[j], inner[j], inner[i]]), frame))
        polygons.append(Polygon(np.array([inner[i], inner[j], sunk[j], sunk[i]]), frame))
    return polygons
