"""The shape of one USD prim in its own coordinates: polygon meshes and the solids given by parameters.

A convex polygon is cut into a fan from its first corner. The fan of a concave polygon would cover area outside its
outline, such as the yard of an L-shaped house. It is cut by clipping ears instead (Meisters, "Polygons have ears",
Amer. Math. Monthly 82, 1975): every simple polygon has a corner whose triangle lies inside it; that triangle is cut
off, and so on. A non-planar polygon is cut in the plane of its Newell normal. A polygon whose outline crosses itself
may have no ear; it is cut into a fan and counted.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
from numpy.typing import NDArray

from datafactory.scenes.chain import Samples
from datafactory.scenes.readers import common
from datafactory.scenes.readers.common import Notes
from datafactory.scenes.readers.usd_samples import Clock, is_baked, point_track
from datafactory.scenes.usd_library import Usd, UsdGeom, UsdShade, UsdSkel
from shared.physics.errors import InputError

LARGEST = 1e60  # of a solid's size: squares of it, as in areas, are still finite
CONVEX_TOLERANCE = 1e-9  # relative to the squared polygon size: float32 corners on a straight edge are not concave


Cut = tuple[NDArray[np.int64], NDArray[np.int64]]
"""Triangles [T, 3] by the indices of their vertices, counter-clockwise seen from outside, and the face of each [T]."""


@dataclass(frozen=True)
class PrimShape:
    """The meshes of one prim: one for each of its material subsets, and one for the rest.

    :param points: [P, 3] in local coordinates and units of the USD stage, in the precision of the file
    :param parts: (name of the subset, "" for the prim itself; its triangles [T, 3]); none without a mesh
    :param notes: what was left out of the geometry
    :param track: samples [K, P, 3] of all points; None where they stay as they are
    """

    points: NDArray[np.floating]
    parts: tuple[tuple[str, NDArray[np.int64]], ...]
    notes: Notes
    track: Samples | None = None

    @cached_property
    def probes(self) -> NDArray[np.floating]:
        """[P, 3] points between which all others lie: where none moves, the corners of the box around them."""
        if self.track is not None:
            return self.points
        finite = self.points[np.isfinite(self.points).all(axis=1)]
        if not len(finite):
            return np.zeros((1, 3))
        return np.array(list(product(*zip(finite.min(axis=0), finite.max(axis=0), strict=True))))


def has_shape(prim: Usd.Prim) -> bool:
    """Whether :func:`prim_shape` can make meshes of a prim."""
    return prim.IsA(UsdGeom.Mesh) or prim.GetTypeName() in _SOLIDS


def prim_shape(prim: Usd.Prim, clock: Clock) -> PrimShape:
    """The meshes of a Mesh or a solid.

    :raises InputError: a solid's size that is negative or not finite
    """
    notes, track, start = Notes(), None, Usd.TimeCode(clock.start)
    if prim.IsA(UsdGeom.Mesh):
        mesh = UsdGeom.Mesh(prim)
        points = np.asarray(mesh.GetPointsAttr().Get(start))
        cut = _polygons(mesh, points, start, notes)
        if cut is None:
            return PrimShape(np.zeros((0, 3)), (), notes)
        track = point_track(mesh, len(points), clock, notes)
    else:
        points, triangles = _solid(prim, start, notes)
        cut = triangles, np.zeros(len(triangles), dtype=np.int64)
    triangles, faces = cut
    if UsdGeom.Gprim(prim).GetOrientationAttr().Get() == UsdGeom.Tokens.leftHanded:
        triangles = triangles[:, ::-1]
    parts = []
    rest = np.ones(len(triangles), dtype=bool)
    for subset in UsdShade.MaterialBindingAPI(prim).GetMaterialBindSubsets():
        chosen = rest & np.isin(faces, whole_numbers(subset.GetIndicesAttr(), start))
        rest &= ~chosen
        parts.append((subset.GetPrim().GetName(), triangles[chosen]))
    if rest.any() or not len(rest):
        parts.append(("", triangles[rest]))
    return PrimShape(points, tuple(parts), notes, track)


def whole_numbers(attribute: Usd.Attribute, time: Usd.TimeCode) -> NDArray[np.int64]:
    """The value of an attribute as whole numbers; empty without a value, or with one of another type."""
    values = np.asarray(attribute.Get(time))
    if values.ndim != 1 or values.dtype.kind not in "iu":
        return np.empty(0, dtype=np.int64)
    return values.astype(np.int64)


def _polygons(mesh: UsdGeom.Mesh, points: NDArray[np.floating], time: Usd.TimeCode, notes: Notes) -> Cut | None:
    """A UsdGeomMesh's control cage, without its holes; None (and counted) where it has no faces.

    What is invalid is left out and counted.
    """
    counts = np.asarray(mesh.GetFaceVertexCountsAttr().Get(time))
    indices = np.asarray(mesh.GetFaceVertexIndicesAttr().Get(time))
    if points.dtype == object or counts.dtype == object or indices.dtype == object:  # None: no value in the file
        notes.count("# meshes without points or faces ignored")
        return None
    whole = counts.dtype.kind in "iu" and indices.dtype.kind in "iu" and counts.ndim == indices.ndim == 1
    if points.ndim != 2 or points.shape[1] != 3 or not whole or (counts < 0).any() or counts.sum() != len(indices):
        notes.count("# meshes ignored whose points, faceVertexCounts and faceVertexIndices do not fit together")
        return None
    if not len(counts):
        notes.count("# meshes without points or faces ignored")
        return None
    if mesh.GetSubdivisionSchemeAttr().Get() != UsdGeom.Tokens.none:
        notes.count("# subdivision surfaces taken as their control cage")
    if UsdSkel.BindingAPI(mesh).GetJointIndicesAttr().HasAuthoredValue() and not is_baked(mesh):
        notes.count("# skinned meshes taken in their rest pose")
    triangles, faces = triangulate(points, counts, indices, notes)
    solid = ~np.isin(faces, whole_numbers(mesh.GetHoleIndicesAttr(), time))
    return triangles[solid], faces[solid]


def _solid(prim: Usd.Prim, time: Usd.TimeCode, notes: Notes) -> common.Mesh:
    """A Cube, Sphere, Cylinder, Cone, Capsule or Plane as triangles."""
    names, make = _SOLIDS[str(prim.GetTypeName())]
    lengths = [name for name in names if name != "axis"]
    changes = any(prim.GetAttribute(name).ValueMightBeTimeVarying() for name in lengths)
    notes.count("# solids change their size: taken as they are at the start", int(changes))
    sizes = [_size(prim, name, time) for name in lengths]
    if "axis" not in names:
        return make(*sizes)
    axis = str(prim.GetAttribute("axis").Get())
    if axis not in _EXCHANGE:
        raise InputError(prim.GetStage().GetRootLayer().identifier, f"{prim.GetPath()}.axis = {axis!r}", "X, Y or Z")
    points, triangles = make(axis, *sizes)
    return points[:, _EXCHANGE[axis]], triangles


def _size(prim: Usd.Prim, name: str, time: Usd.TimeCode) -> float:
    value = prim.GetAttribute(name).Get(time)
    if not isinstance(value, (int, float)) or not 0 <= value <= LARGEST:
        source, expected = prim.GetStage().GetRootLayer().identifier, f"a number from 0 to {LARGEST:g}"
        raise InputError(source, f"{prim.GetPath()}.{name} = {value!r}", expected)
    return float(value)


def _plane(axis: str, width: float, length: float) -> common.Mesh:
    """UsdGeomPlane: width along x (along z where the axis is X), length along y (along z where the axis is Y)."""
    # The cyclic exchange brings the built (x, y) to (y, z) for axis X, to (z, x) for axis Y: width stands second.
    return common.rectangle(width, length) if axis == "Z" else common.rectangle(length, width)


# The attributes of each solid, and its mesh along z from their values; with an axis that comes first.
_SOLIDS: dict[str, tuple[tuple[str, ...], Callable[..., common.Mesh]]] = {
    "Cube": (("size",), common.box),
    "Sphere": (("radius",), common.sphere),
    "Cylinder": (("axis", "radius", "height"), lambda _, radius, height: common.cylinder(radius, radius, height)),
    "Cylinder_1": (("axis", "radiusBottom", "radiusTop", "height"), lambda _, *sizes: common.cylinder(*sizes)),
    "Cone": (("axis", "radius", "height"), lambda _, radius, height: common.cylinder(radius, 0.0, height)),
    "Capsule": (("axis", "radius", "height"), lambda _, radius, height: common.capsule(radius, radius, height)),
    "Capsule_1": (("axis", "radiusBottom", "radiusTop", "height"), lambda _, *sizes: common.capsule(*sizes)),
    "Plane": (("axis", "width", "length"), _plane),
}
_EXCHANGE = {"X": [2, 0, 1], "Y": [1, 2, 0], "Z": [0, 1, 2]}
"""Coordinates of a solid along z that turn it to another axis, cyclic: a rotation."""


def triangulate(
    points: NDArray[np.floating], counts: NDArray[np.integer], indices: NDArray[np.integer], notes: Notes
) -> Cut:
    """Cut a polygon mesh into triangles, wound like their polygons, in the polygons' order.

    Polygons with fewer than three corners, or with a corner that is no vertex, are left out and counted.

    :param points: [V, 3] vertices, any unit
    :param counts: [F] corners of each polygon, not negative
    :param indices: [sum(counts)] vertex index of every corner, polygon after polygon
    """
    starts = np.concatenate([[0], np.cumsum(counts)[:-1]]).astype(np.int64)
    out_of_range = np.concatenate([[0], np.cumsum((indices < 0) | (indices >= len(points)))])
    bad = (counts < 3) | (out_of_range[starts + counts] > out_of_range[starts])
    notes.count("# faces with fewer than three corners or an index out of range dropped", int(bad.sum()))
    corners, faces = [np.empty((0, 3), np.int64)], [np.empty(0, np.int64)]
    for size in np.unique(counts[~bad]):
        chosen = np.flatnonzero(~bad & (counts == size))
        polygons = indices[starts[chosen][:, None] + np.arange(size)].astype(np.int64)
        concave = _concave(points[polygons].astype(np.float64))
        corners.append(_fan(polygons[~concave]))
        faces.append(np.repeat(chosen[~concave], size - 2))
        for face, polygon in zip(chosen[concave], polygons[concave], strict=True):
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
    concave = (np.einsum("fnk,fk->fn", turns, normal) < -CONVEX_TOLERANCE * size[:, None]).any(axis=1)
    # At a corner that stands twice no edge turns: what counts is the outline without the repetition.
    repeats = ~edges.any(axis=-1)
    for face in np.flatnonzero(repeats.any(axis=1) & ~concave):
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
