"""What a USD prim states for itself, read once: many instances ask for the same prim."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from datafactory.scenes.chain import Samples
from datafactory.scenes.readers.common import Notes
from datafactory.scenes.readers.usd_prims import (
    PrimMesh,
    is_solid,
    polygon_mesh,
    size_changes,
    solid_mesh,
    whole_numbers,
)
from datafactory.scenes.readers.usd_samples import Clock, point_track
from datafactory.scenes.readers.usd_targets import names_are_targets, target_kind
from datafactory.scenes.usd_library import Sdf, Usd, UsdGeom, UsdShade
from shared.physics.errors import InputError

Found = TypeVar("Found")


@dataclass(frozen=True)
class PrimFacts:
    """The values of one prim that reading depends on, without what it inherits.

    :param visible: False hides the prim and everything below it; :param blinks: that changes with time
    :param purpose: the authored purpose, None where there is none
    :param velocity: ``radar:velocity`` [m/s] in the USD stage's axes
    :param material: ``radar:material``
    :param targets_by_name: ``radar:targets_by_name``
    :param class_name: ``radar:class``
    :param has_rcs: whether ``radar:rcs_dbsm`` is there
    :param is_instancer: a point instancer
    :param is_gprim: any geometry
    """

    visible: bool
    purpose: str | None
    velocity: NDArray[np.float64] | None = None
    material: str | None = None
    targets_by_name: bool | None = None
    has_rcs: bool = False
    is_instancer: bool = False
    is_gprim: bool = False
    blinks: bool = False
    class_name: str | None = None


@dataclass(frozen=True)
class PrimShape:
    """The meshes of one prim: one for each of its material subsets, and one for the rest.

    :param points: [P, 3] in local coordinates, in the precision of the file
    :param parts: (name of the subset, "" for the prim itself; its triangles [T, 3]); none without a mesh
    :param probes: [P, 3] points between which all others lie
    :param track: samples [K, P, 3] of all points; None where they stay as they are
    :param notes: what was left out of the geometry
    """

    points: NDArray[np.floating]
    parts: tuple[tuple[str, NDArray[np.int64]], ...]
    probes: NDArray[np.floating]
    notes: Notes
    track: Samples | None = None


class FactsOfPrims:
    """The facts of a USD stage's prims; those of an instance's prims are those of its prototype."""

    def __init__(self, path: Path, clock: Clock) -> None:
        self._path = path
        self._clock = clock
        self._start = Usd.TimeCode(clock.start)
        self._known: dict[tuple[Hashable, ...], Any] = {}

    def of(self, prim: Usd.Prim) -> PrimFacts:
        """The facts of one prim.

        :raises InputError: a ``radar:`` attribute without a usable value
        """
        return self._once((source_path(prim),), lambda: self._read(prim))

    def kind(self, prim: Usd.Prim, by_name: bool) -> str | None:
        """The model of a target that the prim calls for, see :func:`.usd_targets.target_kind`."""
        key = "kind", source_path(prim), by_name
        return self._once(key, lambda: target_kind(self._path, prim, self._start, by_name))

    def shape(self, prim: Usd.Prim, shared: bool) -> PrimShape:
        """The meshes of a Mesh or a solid; kept only where they are ``shared``."""
        if not shared:
            return self._read_shape(prim)
        return self._once(("shape", source_path(prim)), lambda: self._read_shape(prim))

    def bound_material(self, prim: Usd.Prim) -> tuple[str, bool]:
        """Name of the material bound to a prim, "" without one, and whether a binding leads to no material."""
        # Bindings above an instance count too, so that its prims do not have those of the prototype.
        return self._once(("material", prim.GetPath()), lambda: _bound_material(prim))

    def _once(self, key: tuple[Hashable, ...], read: Callable[[], Found]) -> Found:
        if key not in self._known:
            self._known[key] = read()
        found: Found = self._known[key]
        return found

    def numbers(self, prim: Usd.Prim, name: str, size: int, expected: str) -> NDArray[np.float64]:
        """A custom attribute's value as [size] float64."""
        value = prim.GetAttribute(name).Get(self._start)
        try:
            numbers = np.array(value, dtype=np.float64).reshape(-1)
        except (TypeError, ValueError):
            numbers = np.empty(0)
        if isinstance(value, (str, bool)) or numbers.shape != (size,) or not np.isfinite(numbers).all():
            raise InputError(self._path, f"{prim.GetPath()}.{name} = {value!r}", expected)
        return numbers

    def _read(self, prim: Usd.Prim) -> PrimFacts:
        imageable = UsdGeom.Imageable(prim)
        visible, purpose, blinks = True, None, False
        if imageable:
            visible = imageable.GetVisibilityAttr().Get(self._start) != UsdGeom.Tokens.invisible
            blinks = imageable.GetVisibilityAttr().ValueMightBeTimeVarying()
            if imageable.GetPurposeAttr().HasAuthoredValue():
                purpose = str(imageable.GetPurposeAttr().Get())
        if not visible:
            return PrimFacts(False, purpose)
        velocity = material = by_name = class_name = None
        if prim.HasAttribute("radar:velocity"):
            velocity = self.numbers(prim, "radar:velocity", 3, "three finite numbers [m/s]")
        if prim.HasAttribute("radar:material"):
            material = self._word(prim, "radar:material", "a material name")
        if prim.HasAttribute("radar:targets_by_name"):
            by_name = names_are_targets(self._path, prim, self._start)
        if prim.HasAttribute("radar:class"):
            class_name = self._word(prim, "radar:class", "the name of a class, e.g. car")
        return PrimFacts(
            visible=True,
            purpose=purpose,
            velocity=velocity,
            material=material,
            targets_by_name=by_name,
            has_rcs=prim.HasAttribute("radar:rcs_dbsm"),
            is_instancer=prim.IsA(UsdGeom.PointInstancer),
            is_gprim=prim.IsA(UsdGeom.Gprim),
            blinks=blinks,
            class_name=class_name,
        )

    def _word(self, prim: Usd.Prim, name: str, expected: str) -> str:
        """A custom attribute's value as text."""
        value = prim.GetAttribute(name).Get(self._start)
        if not isinstance(value, str) or not value:
            raise InputError(self._path, f"{prim.GetPath()}.{name} = {value!r}", expected)
        return value

    def _read_shape(self, prim: Usd.Prim) -> PrimShape:
        notes = Notes()
        mesh: PrimMesh | None
        track = None
        if prim.IsA(UsdGeom.Mesh):
            mesh = polygon_mesh(UsdGeom.Mesh(prim), self._start, notes)
            track = None if mesh is None else point_track(UsdGeom.Mesh(prim), len(mesh.points), self._clock, notes)
        else:
            mesh = solid_mesh(prim, self._start)
            notes.count("# solids change their size: taken as they are at the start", int(size_changes(prim)))
        if mesh is None:
            return PrimShape(np.zeros((0, 3)), (), np.zeros((0, 3)), notes)
        parts = []
        rest = np.ones(len(mesh.triangles), dtype=bool)
        for subset in UsdShade.MaterialBindingAPI(prim).GetMaterialBindSubsets():
            chosen = rest & np.isin(mesh.faces, whole_numbers(subset.GetIndicesAttr(), self._start))
            rest &= ~chosen
            parts.append((subset.GetPrim().GetName(), mesh.triangles[chosen]))
        if rest.any() or not len(rest):
            parts.append(("", mesh.triangles[rest]))
        probes = mesh.points if track is not None else _corners(mesh.points)
        return PrimShape(mesh.points, tuple(parts), probes, notes, track)


def _bound_material(prim: Usd.Prim) -> tuple[str, bool]:
    binding = UsdShade.MaterialBindingAPI(prim)
    bound, _ = binding.ComputeBoundMaterial()
    leads_nowhere = not bound and bool(binding.GetDirectBindingRel().GetTargets())
    return str(bound.GetPrim().GetName()) if bound else "", leads_nowhere


def _corners(points: NDArray[np.floating]) -> NDArray[np.floating]:
    """[8, 3] the corners of the box around the finite points."""
    finite = points[np.isfinite(points).all(axis=1)]
    if not len(finite):
        return np.zeros((1, 3))
    sides = np.stack([finite.min(axis=0), finite.max(axis=0)])
    return np.array([[sides[i, 0], sides[j, 1], sides[k, 2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)])


def source_path(prim: Usd.Prim) -> Sdf.Path:
    """The path under which a prim's values are kept: within an instance, that of the prototype's prim."""
    return (prim.GetPrimInPrototype() if prim.IsInstanceProxy() else prim).GetPath()


def has_shape(prim: Usd.Prim) -> bool:
    """Whether :meth:`FactsOfPrims.shape` can make meshes of a prim."""
    return prim.IsA(UsdGeom.Mesh) or is_solid(prim)
