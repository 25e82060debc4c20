"""The shape of one USD prim in its own coordinates: polygon meshes and the solids given by parameters."""

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
from datafactory.scenes.readers.polygons import Cut, triangulate
from datafactory.scenes.readers.usd_samples import Clock, is_baked, point_track
from datafactory.scenes.usd_library import Usd, UsdGeom, UsdShade, UsdSkel
from shared.physics.errors import InputError

LARGEST = 1e60  # of a solid's size: squares of it, as in areas, are still finite


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


def prim_shape(prim: Usd.Prim, clock: Clock, predicate: Usd._PrimFlagsPredicate) -> PrimShape:
    """The meshes of a Mesh or a solid.

    :param predicate: which prims below it are visited: USD's own search for subsets passes those of a prototype by
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
        unused = mesh.GetVelocitiesAttr().HasAuthoredValue()
        notes.count("# meshes have 'velocities', which are not used (points' samples are)", unused)
    else:
        points, triangles = _solid(prim, start, notes)
        cut = triangles, np.zeros(len(triangles), dtype=np.int64)
    triangles, faces = cut
    if UsdGeom.Gprim(prim).GetOrientationAttr().Get() == UsdGeom.Tokens.leftHanded:
        triangles = triangles[:, ::-1]
    parts = []
    rest = np.ones(len(triangles), dtype=bool)
    for subset in filter(None, map(UsdGeom.Subset, prim.GetFilteredChildren(predicate))):
        kind, family = subset.GetElementTypeAttr().Get(), subset.GetFamilyNameAttr().Get()
        if (kind, family) != (UsdGeom.Tokens.face, UsdShade.Tokens.materialBind):
            _note_own_material(subset.GetPrim(), notes)
            continue
        chosen = rest & np.isin(faces, whole_numbers(subset.GetIndicesAttr(), start))
        rest &= ~chosen
        parts.append((subset.GetPrim().GetName(), triangles[chosen]))
    if rest.any() or not len(rest):
        parts.append(("", triangles[rest]))
    return PrimShape(points, tuple(parts), notes, track)


def _note_own_material(subset: Usd.Prim, notes: Notes) -> None:
    """Count a subset that USD gives no faces of its own material, if it has one."""
    bound = UsdShade.MaterialBindingAPI(subset).GetDirectBindingRel().GetTargets()
    if bound or subset.HasAttribute("radar:material"):
        notes.count("# subsets with a material ignored: they are not of faces in the family materialBind")


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
