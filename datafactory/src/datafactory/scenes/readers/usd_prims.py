"""The geometry of one USD prim in its own coordinates: polygon meshes and the solids given by parameters."""

from __future__ import annotations

from collections.abc import Callable
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
    names, _ = _SOLIDS[str(prim.GetTypeName())]
    return any(prim.GetAttribute(name).ValueMightBeTimeVarying() for name in names if name != "axis")


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
    cut = triangulate(points, counts, indices)
    notes.count("# faces with fewer than three corners or an index out of range dropped", cut.bad_faces)
    notes.count("# faces whose outline crosses itself cut into a fan", cut.crossing_faces)
    solid = ~np.isin(cut.faces, whole_numbers(mesh.GetHoleIndicesAttr(), time))
    return PrimMesh(points, _wound(mesh, cut.triangles[solid]), cut.faces[solid])


def solid_mesh(prim: Usd.Prim, time: Usd.TimeCode) -> PrimMesh:
    """A Cube, Sphere, Cylinder, Cone, Capsule or Plane as triangles (see ``primitives`` for the chord error).

    :raises InputError: a size that is negative or not finite
    """
    names, make = _SOLIDS[str(prim.GetTypeName())]
    sizes = [_size(prim, name, time) for name in names if name != "axis"]
    if "axis" in names:
        axis = _axis(prim)
        points, triangles = make(axis, *sizes)
        points = points[:, _EXCHANGE[axis]]
    else:
        points, triangles = make(*sizes)
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


def _axis(prim: Usd.Prim) -> str:
    axis = str(prim.GetAttribute("axis").Get())
    if axis not in ("X", "Y", "Z"):
        raise InputError(prim.GetStage().GetRootLayer().identifier, f"{prim.GetPath()}.axis = {axis!r}", "X, Y or Z")
    return axis


def _plane(axis: str, width: float, length: float) -> primitives.Mesh:
    """UsdGeomPlane: width along x (along z where the axis is X), length along y (along z where the axis is Y)."""
    # The cyclic exchange brings the built (x, y) to (y, z) for axis X, to (z, x) for axis Y: width stands second.
    return primitives.rectangle(width, length) if axis == "Z" else primitives.rectangle(length, width)


# The attributes of each solid, and its mesh along z from their values; with an axis that comes first.
_SOLIDS: dict[str, tuple[tuple[str, ...], Callable[..., primitives.Mesh]]] = {
    "Cube": (("size",), primitives.box),
    "Sphere": (("radius",), primitives.sphere),
    "Cylinder": (("axis", "radius", "height"), lambda _, radius, height: primitives.cylinder(radius, radius, height)),
    "Cylinder_1": (("axis", "radiusBottom", "radiusTop", "height"), lambda _, *sizes: primitives.cylinder(*sizes)),
    "Cone": (("axis", "radius", "height"), lambda _, radius, height: primitives.cylinder(radius, 0.0, height)),
    "Capsule": (("axis", "radius", "height"), lambda _, radius, height: primitives.capsule(radius, radius, height)),
    "Capsule_1": (("axis", "radiusBottom", "radiusTop", "height"), lambda _, *sizes: primitives.capsule(*sizes)),
    "Plane": (("axis", "width", "length"), _plane),
}
_EXCHANGE = {"X": [2, 0, 1], "Y": [1, 2, 0], "Z": [0, 1, 2]}
"""Coordinates of a solid along z that turn it to another axis, cyclic: a rotation."""
