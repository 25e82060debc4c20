"""Polygon meshes cut into triangles.

A convex polygon is cut into a fan from its first corner. The fan of a concave polygon would cover area outside its
outline, such as the yard of an L-shaped house. It is cut by clipping ears instead (Meisters, "Polygons have ears",
Amer. Math. Monthly 82, 1975): every simple polygon has a corner whose triangle lies inside it; that triangle is cut
off, and so on. A non-planar polygon is cut in the plane of its Newell normal. A polygon whose outline crosses itself
may have no ear; it is cut into a fan and counted.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from datafactory.scenes.readers.common import Notes

CONVEX_TOLERANCE = 1e-9  # relative to the squared polygon size: float32 corners on a straight edge are not concave
Cut = tuple[NDArray[np.int64], NDArray[np.int64]]
"""Triangles [T, 3] by the indices of their vertices, counter-clockwise seen from outside, and the face of each [T]."""


def triangulate(
    points: NDArray[np.floating], counts: NDArray[np.integer], indices: NDArray[np.integer], notes: Notes
) -> Cut:
    """Cut a polygon mesh into triangles, wound like their polygons, in the polygons' order.

    Polygons with fewer than three corners, or with a corner that is no vertex, are left out and counted.

    :param points: [V, 3] vertices, any unit
    :param counts: [F] corners of each polygon, not negative
    :param indices: [sum(counts)] vertex index of every corner, polygon after polygon
    """
    starts, bad = _starts(counts), _bad(points, counts, indices)
    notes.count("# faces with fewer than three corners or an index out of range dropped", int(bad.sum()))
    concave = find_concave(points, counts, indices)
    corners, faces = [np.empty((0, 3), np.int64)], [np.empty(0, np.int64)]
    for size in np.unique(counts[~bad]):
        fans = np.flatnonzero(~bad & ~concave & (counts == size))
        corners.append(_fan(indices[starts[fans][:, None] + np.arange(size)].astype(np.int64)))
        faces.append(np.repeat(fans, size - 2))
    for face in np.flatnonzero(concave):
        polygon = indices[starts[face] : starts[face] + counts[face]].astype(np.int64)
        ears = _clip_ears(_in_own_plane(points[polygon].astype(np.float64)))
        if ears is None:
            notes.count("# faces whose outline crosses itself cut into a fan")
            cut = _fan(polygon[None])
        else:
            cut = polygon[np.array(ears, dtype=np.int64).reshape(-1, 3)]
        corners.append(cut)
        faces.append(np.full(len(cut), face))
    owner = np.concatenate(faces)
    order = np.argsort(owner, kind="stable")  # back to the order of the file
    return np.concatenate(corners)[order], owner[order]


def find_concave(
    points: NDArray[np.floating], counts: NDArray[np.integer], indices: NDArray[np.integer]
) -> NDArray[np.bool_]:
    """[F] which polygons of a mesh, given as for :func:`triangulate`, a fan would not cover rightly.

    Never true for one with a corner that is no vertex, or not finite.
    """
    starts, bad = _starts(counts), _bad(points, counts, indices)
    concave = np.zeros(len(counts), dtype=bool)
    for size in np.unique(counts[~bad & (counts > 3)]):
        chosen = np.flatnonzero(~bad & (counts == size))
        concave[chosen] = _concave(points[indices[starts[chosen][:, None] + np.arange(size)]].astype(np.float64))
    return concave


def _starts(counts: NDArray[np.integer]) -> NDArray[np.int64]:
    """[F] where the corners of each polygon begin."""
    return np.concatenate([[0], np.cumsum(counts)[:-1]]).astype(np.int64)


def _bad(points: NDArray[np.floating], counts: NDArray[np.integer], indices: NDArray[np.integer]) -> NDArray[np.bool_]:
    """[F] which polygons have fewer than three corners, or one that is no vertex."""
    starts = _starts(counts)
    out_of_range = np.concatenate([[0], np.cumsum((indices < 0) | (indices >= len(points)))])
    bad: NDArray[np.bool_] = (counts < 3) | (out_of_range[starts + counts] > out_of_range[starts])
    return bad


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
    """[F] which of the [F, n, 3] polygons turn the other way at some corner; never true for NaN."""
    edges = np.roll(polygons, -1, axis=1) - polygons
    turns = np.cross(np.roll(edges, 1, axis=1), edges)
    normal = _newell(polygons)
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    normal = np.divide(normal, length, out=np.zeros_like(normal), where=length > 0)
    size = np.square(edges).sum(axis=-1).max(axis=1)
    leans = np.einsum("fnk,fk->fn", turns, normal)
    concave: NDArray[np.bool_] = np.any(leans < -CONVEX_TOLERANCE * size[:, None], axis=1)
    # At a corner that stands twice no edge turns: what counts is the outline without the repetition.
    repeats: NDArray[np.bool_] = np.all(edges == 0.0, axis=-1)
    for face in np.flatnonzero(np.any(repeats, axis=1) & ~concave):
        once = polygons[face][~repeats[face]]
        concave[face] = len(once) > 3 and _concave(once[None])[0]
    return concave


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
