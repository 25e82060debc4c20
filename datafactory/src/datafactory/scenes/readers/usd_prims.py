"""The geometry of one USD prim in its own coordinates: polygon meshes and the solids given by parameters."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from datafactory.scenes.readers import primitives
from datafactory.scenes.readers.common import Notes
from datafactory.scenes.readers.triangulation import triangulate
from datafactory.scenes.readers.usd_skinning import is_baked
from datafactory.scenes.usd_library import Usd, UsdGeom, UsdSkel
from shared.physics.errors import InputError

LARGEST = 1e60  # of a solid's size: squares of it, as in areas, are still finite


@dataclass(frozen=True)
class PrimMesh:
    """A prim's triangles in local coordinates and units of the USD stage.

    :param points: [V, 3], in the precision of the file
    :param triangles: [T, 3] vertex indices, counter-clockwise seen from outside
    :param faces: [T] the USD face that each triangle was cut from
    """

    points: NDArray[np.floating]
    triangles: NDArray[np.int64]
    faces: NDArray[np.int64]


def whole_numbers(attribute: Usd.Attribute, time: Usd.TimeCode) -> NDArray[np.int64]:
    """The value of an attribute as whole numbers; empty without a value, or with one of another type."""
    values = np.asarray(attribute.Get(time))
    if values.ndim != 1 or values.dtype.kind not in "iu":
        return np.empty(0, dtype=np.int64)
    return values.astype(np.int64)


def is_solid(prim: Usd.Prim) -> bool:
    """Whether ``solid_mesh`` can make a mesh of this prim."""
    return prim.GetTypeName() in _SOLIDS


def size_changes(prim: Usd.Prim) -> bool:
    """Whether a solid's size has samples."""
    sizes = ("size", "radius", "radiusBottom", "radiusTop", "height", "width", "length")
    return any(prim.HasAttribute(name) and prim.GetAttribute(name).ValueMightBeTimeVarying() for name in sizes)


def polygon_mesh(mesh: UsdGeom.Mesh, time: Usd.TimeCode, notes: Notes) -> PrimMesh | None:
    """A UsdGeomMesh as triangles: its control cage, without its holes; None (and counted) where it has no faces.

    The winding follows the prim's orientation attribute. What is invalid is left out and counted.
    """
    points = np.asarray(mesh.GetPointsAttr().Get(time))
    counts = np.asarray(mesh.GetFaceVertexCountsAttr().Get(time))
    indices = np.asarray(mesh.GetFaceVertexIndicesAttr().Get(time))
    if points.dtype == object or counts.dtype == object or indices.dtype == object:  # None: no value in the file
        notes.count("# meshes without points or faces ignored")
        return None
    if points.ndim != 2 or points.shape[1] != 3 or counts.ndim != 1 or indices.ndim != 1:
        notes.count("# meshes ignored whose points are not an array of 3-vectors")
        return None
    if counts.dtype.kind not in "iu" or indices.dtype.kind not in "iu":
        notes.count("# meshes ignored whose faceVertexCounts or faceVertexIndices are not whole numbers")
        return None
    if (counts < 0).any() or counts.sum() != len(indices):
        notes.count("# meshes ignored whose faceVertexCounts do not add up to their faceVertexIndices")
        return None
    if not len(counts):
        notes.count("# meshes without points or faces ignored")
        return None
    if mesh.GetSubdivisionSchemeAttr().Get() != UsdGeom.Tokens.none:
        notes.count("# subdivision surfaces taken as their control cage")
    if UsdSkel.BindingAPI(mesh).GetJointIndicesAttr().HasAuthoredValue() and not is_baked(mesh):
        notes.count("# skinned meshes taken in their rest pose")
    cut = triangulate(points, counts, indices)
    notes.count("# faces with fewer than three corners or an index out of range dropped", cut.bad_faces)
    notes.count("# faces whose outline crosses itself cut into a fan", cut.crossing_faces)
    solid = ~np.isin(cut.faces, whole_numbers(mesh.GetHoleIndicesAttr(), time))
    return PrimMesh(points, _wound(mesh, cut.triangles[solid]), cut.faces[solid])


def solid_mesh(prim: Usd.Prim, time: Usd.TimeCode) -> PrimMesh:
    """A Cube, Sphere, Cylinder, Cone, Capsule or Plane as triangles (see ``primitives`` for the chord error).

    :raises InputError: a size that is negative or not finite
    """
    points, triangles = _SOLIDS[str(prim.GetTypeName())](prim, time)
    return PrimMesh(points, _wound(UsdGeom.Gprim(prim), triangles), np.zeros(len(triangles), dtype=np.int64))


def _wound(gprim: UsdGeom.Gprim, triangles: NDArray[np.int64]) -> NDArray[np.int64]:
    left_handed = gprim.GetOrientationAttr().Get() == UsdGeom.Tokens.leftHanded
    return triangles[:, ::-1] if left_handed else triangles


def _size(prim: Usd.Prim, name: str, time: Usd.TimeCode) -> float:
    value = prim.GetAttribute(name).Get(time)
    if not isinstance(value, (int, float)) or not 0 <= value <= LARGEST:
        source, expected = prim.GetStage().GetRootLayer().identifier, f"a number from 0 to {LARGEST:g}"
        raise InputError(source, f"{prim.GetPath()}.{name} = {value!r}", expected)
    return float(value)


def _along_axis(prim: Usd.Prim, mesh: primitives.Mesh) -> primitives.Mesh:
    """Turn a solid built along z to the prim's axis, by a cyclic exchange of coordinates (a rotation)."""
    points, triangles = mesh
    order = {"X": [2, 0, 1], "Y": [1, 2, 0], "Z": [0, 1, 2]}[_axis(prim)]
    return points[:, order], triangles


def _axis(prim: Usd.Prim) -> str:
    axis = str(prim.GetAttribute("axis").Get())
    if axis not in ("X", "Y", "Z"):
        raise InputError(prim.GetStage().GetRootLayer().identifier, f"{prim.GetPath()}.axis = {axis!r}", "X, Y or Z")
    return axis


def _cube(prim: Usd.Prim, time: Usd.TimeCode) -> primitives.Mesh:
    return primitives.box(_size(prim, "size", time))


def _sphere(prim: Usd.Prim, time: Usd.TimeCode) -> primitives.Mesh:
    return primitives.sphere(_size(prim, "radius", time))


def _cylinder(prim: Usd.Prim, time: Usd.TimeCode) -> primitives.Mesh:
    radius = _size(prim, "radius", time)
    return _along_axis(prim, primitives.cylinder(radius, radius, _size(prim, "height", time)))


def _cylinder_1(prim: Usd.Prim, time: Usd.TimeCode) -> primitives.Mesh:
    bottom, top = _size(prim, "radiusBottom", time), _size(prim, "radiusTop", time)
    return _along_axis(prim, primitives.cylinder(bottom, top, _size(prim, "height", time)))


def _cone(prim: Usd.Prim, time: Usd.TimeCode) -> primitives.Mesh:
    return _along_axis(prim, primitives.cylinder(_size(prim, "radius", time), 0.0, _size(prim, "height", time)))


def _capsule(prim: Usd.Prim, time: Usd.TimeCode) -> primitives.Mesh:
    radius = _size(prim, "radius", time)
    return _along_axis(prim, primitives.capsule(radius, radius, _size(prim, "height", time)))


def _capsule_1(prim: Usd.Prim, time: Usd.TimeCode) -> primitives.Mesh:
    bottom, top = _size(prim, "radiusBottom", time), _size(prim, "radiusTop", time)
    return _along_axis(prim, primitives.capsule(bottom, top, _size(prim, "height", time)))


def _plane(prim: Usd.Prim, time: Usd.TimeCode) -> primitives.Mesh:
    """UsdGeomPlane: width along x (along z where the axis is X), length along y (along z where the axis is Y)."""
    width, length = _size(prim, "width", time), _size(prim, "length", time)
    if _axis(prim) == "Z":
        return primitives.rectangle(width, length)
    # The cyclic exchange brings the built (x, y) to (y, z) for axis X, to (z, x) for axis Y: width stands second.
    return _along_axis(prim, primitives.rectangle(length, width))


_SOLIDS = {
    "Cube": _cube,
    "Sphere": _sphere,
    "Cylinder": _cylinder,
    "Cylinder_1": _cylinder_1,
    "Cone": _cone,
    "Capsule": _capsule,
    "Capsule_1": _capsule_1,
    "Plane": _plane,
}
