"""Polygons to triangles.

A convex polygon is cut into a fan from its first corner. The fan of a concave polygon would cover area outside its
outline, such as the yard of an L-shaped house. It is cut by clipping ears instead (Meisters, "Polygons have ears",
Amer. Math. Monthly 82, 1975): every simple polygon has a corner whose triangle lies inside it; that triangle is cut
off, and so on. A non-planar polygon is cut in the plane of its Newell normal. A polygon whose outline crosses itself
may have no ear; it is cut into a fan and counted.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

CONVEX_TOLERANCE = 1e-9  # relative to the squared polygon size: float32 corners on a straight edge are not concave


@dataclass(frozen=True)
class Triangulation:
    """Triangles of a polygon mesh.

    :param triangles: [T, 3] vertex indices, int64, wound like their polygons
    :param faces: [T] the polygon that each triangle came from
    :param bad_faces: polygons left out: fewer than three corners, or a corner that is no vertex
    :param crossing_faces: polygons whose outline crosses itself, cut into a fan
    """

    triangles: NDArray[np.int64]
    faces: NDArray[np.int64]
    bad_faces: int = 0
    crossing_faces: int = 0


def triangulate(
    points: NDArray[np.floating], counts: NDArray[np.integer], indices: NDArray[np.integer]
) -> Triangulation:
    """Cut a polygon mesh into triangles.

    :param points: [V, 3] vertices, any unit
    :param counts: [F] corners of each polygon, not negative
    :param indices: [sum(counts)] vertex index of every corner, polygon after polygon
    """
    starts = np.concatenate([[0], np.cumsum(counts)[:-1]]).astype(np.int64)
    out_of_range = np.concatenate([[0], np.cumsum((indices < 0) | (indices >= len(points)))])
    bad = (counts < 3) | (out_of_range[starts + counts] > out_of_range[starts])
    corners: list[NDArray[np.int64]] = []
    faces: list[NDArray[np.int64]] = []
    crossing = 0
    for size in np.unique(counts[~bad]):
        chosen = np.flatnonzero(~bad & (counts == size))
        polygons = indices[starts[chosen][:, None] + np.arange(size)].astype(np.int64)
        concave = _concave(points[polygons].astype(np.float64))
        fans, owners = _fan(polygons[~concave]), np.repeat(chosen[~concave], size - 2)
        corners.append(fans)
        faces.append(owners)
        for face, polygon in zip(chosen[concave], polygons[concave], strict=True):
            ears = _clip_ears(_in_own_plane(points[polygon].astype(np.float64)))
            if ears is None:
                crossing += 1
                cut = _fan(polygon[None])
            else:
                cut = polygon[np.array(ears, dtype=np.int64).reshape(-1, 3)]
            corners.append(cut)
            faces.append(np.full(len(cut), face))
    if not corners:
        return Triangulation(np.empty((0, 3), np.int64), np.empty(0, np.int64), int(bad.sum()))
    owner = np.concatenate(faces)
    order = np.argsort(owner, kind="stable")  # back to the order of the file
    return Triangulation(np.concatenate(corners)[order], owner[order], int(bad.sum()), crossing)


def _fan(polygons: NDArray[np.int64]) -> NDArray[np.int64]:
    """[F, n] polygons to [F * (n - 2), 3] triangles around the first corner."""
    size = polygons.shape[1]
    first = np.repeat(polygons[:, :1], size - 2, axis=1)
    return np.stack([first, polygons[:, 1:-1], polygons[:, 2:]], axis=-1).reshape(-1, 3)


def _newell(polygons: NDArray[np.float64]) -> NDArray[np.float64]:
    """Twice the vector area of each polygon, sum_i p_i x p_(i+1), about its first corner: [..., n, 3] to [..., 3]."""
    about = polygons - polygons[..., :1, :]
    return np.cross(about, np.roll(about, -1, axis=-2)).sum(axis=-2)


def _concave(polygons: NDArray[np.float64]) -> NDArray[np.bool_]:
    """[F] which of the [F, n, 3] polygons turn the other way at some corner; never true for NaN or triangles."""
    if polygons.shape[1] == 3:
        return np.zeros(len(polygons), dtype=bool)
    edges = np.roll(polygons, -1, axis=1) - polygons
    turns = np.cross(np.roll(edges, 1, axis=1), edges)
    normal = _newell(polygons)
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    normal = np.divide(normal, length, out=np.zeros_like(normal), where=length > 0)
    size = np.square(edges).sum(axis=-1).max(axis=1)
    return (np.einsum("fnk,fk->fn", turns, normal) < -CONVEX_TOLERANCE * size[:, None]).any(axis=1)


def _in_own_plane(polygon: NDArray[np.float64]) -> list[tuple[float, float]]:
    """[n, 3] corners as 2-D coordinates in the polygon's plane, counter-clockwise."""
    about = polygon - polygon[0]
    normal = _newell(polygon)
    normal /= np.linalg.norm(normal)
    helper = np.eye(3)[np.argmin(np.abs(normal))]
    axis_u = np.cross(helper, normal)
    axis_u /= np.linalg.norm(axis_u)
    axis_v = np.cross(normal, axis_u)
    return list(zip((about @ axis_u).tolist(), (about @ axis_v).tolist(), strict=True))


def _turn(a: tuple[float, float], b: tuple[float, float], c: tuple[float, float]) -> float:
    """Twice the signed area of a, b, c: positive where the path turns left."""
    return (b[0] - a[0]) * (c[1] - b[1]) - (b[1] - a[1]) * (c[0] - b[0])


def _clip_ears(flat: list[tuple[float, float]]) -> list[tuple[int, int, int]] | None:
    """Triangles (corner numbers) of a counter-clockwise polygon, or None where it crosses itself.

    Corners on a straight line are cut off without a triangle. Corners that coincide with one of the ear's own are
    no obstacle: holes are commonly joined to the outline by a doubled edge.
    """
    size = max(x * x + y * y for x, y in flat)
    straight = CONVEX_TOLERANCE * size
    ring = list(range(len(flat)))
    ears: list[tuple[int, int, int]] = []
    while len(ring) > 2:
        for place, corner in enumerate(ring):
            before, after = ring[place - 1], ring[(place + 1) % len(ring)]
            a, b, c = flat[before], flat[corner], flat[after]
            turn = _turn(a, b, c)
            if turn < -straight:
                continue
            if turn <= straight or not any(
                _turn(a, b, p) >= 0 and _turn(b, c, p) >= 0 and _turn(c, a, p) >= 0
                for p in (flat[other] for other in ring)
                if p not in (a, b, c)
            ):
                if turn > straight:
                    ears.append((before, corner, after))
                del ring[place]
                break
        else:
            return None
    covered = sum(_turn(flat[i], flat[j], flat[k]) for i, j, k in ears)
    outline = sum(p[0] * q[1] - p[1] * q[0] for p, q in zip(flat, flat[1:] + flat[:1], strict=True))
    # Ears of a simple polygon cover it exactly once; a figure of eight gives another sum.
    return ears if abs(covered - outline) <= 1e-6 * size else None
