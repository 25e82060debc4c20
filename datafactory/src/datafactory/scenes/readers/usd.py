"""Universal Scene Description: a composed USD stage to metres, z up and triangles.

The reader takes the USD stage at its start, with the variants that the file selects, and how each prim moves from there
on (see ``usd_motion``). It expands instances and point instancers. It leaves out invisible prims and those of purpose
guide or proxy. Custom attributes state what the radar needs: docs/own-scene.md lists them. ``radar:velocity`` is in the
axes of the USD stage, and samples below it do not count.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datafactory.scenes.chain import Chain, Samples
from datafactory.scenes.motion import Motion, Moving, Vector, triple
from datafactory.scenes.readers.common import (
    AS_WRITTEN,
    MAXIMUM_NESTING,
    Notes,
    Reading,
    check_counts,
    note_coarse_vertices,
    place_mesh,
    vertex_spacing_m,
    with_remarks,
)
from datafactory.scenes.readers.usd_labels import (
    UNLABELLED,
    Labelling,
    model_axes,
    note_unread,
    occupied_below,
    prim_model,
    target_kind,
)
from datafactory.scenes.readers.usd_motion import (
    Frame,
    Transforms,
    check_motion,
    instance_frames,
    note_instancer,
    source_path,
)
from datafactory.scenes.readers.usd_prims import PrimShape, has_shape, prim_shape
from datafactory.scenes.readers.usd_samples import Clock, bake_skinning
from datafactory.scenes.readers.usd_stage import EVEN_UNDEFINED, open_usd_stage, usd_stage_to_world
from datafactory.scenes.scene import LARGEST_RCS_DBSM, WORLD_AXES, ZERO, PointTarget, Scene, SceneObject
from datafactory.scenes.usd_library import Sdf, Tf, Usd, UsdGeom, UsdShade
from shared.physics.errors import InputError
from shared.physics.units import FARTHEST_M

SCENE_PRIMS = Usd.TraverseInstanceProxies()  # active, loaded, defined, not abstract
PROTOTYPE_PRIMS = Usd.TraverseInstanceProxies(EVEN_UNDEFINED)


@dataclass(frozen=True)
class _Inherited:
    """The values that a prim passes to the prims below it."""

    frame: Frame
    material: str | None = None
    velocity: Vector | None = None
    purpose: str = "default"
    instancers: tuple[str, ...] = ()
    targets_by_name: bool = False
    labelling: Labelling = UNLABELLED


def read_usd(path: str | Path, reading: Reading = AS_WRITTEN) -> Scene:
    """Read a .usd, .usda, .usdc or .usdz file.

    :param path: the root layer
    :param reading: what the user decides of it
    :raises InputError: a layer that is missing or cannot be parsed, a reference or payload that leads nowhere, metadata
        or a ``radar:`` attribute without a usable value
    """
    path = Path(path)
    notes = Notes()
    # USD would print its diagnostics. The trap keeps them for the error's one line or for a counted warning.
    with Tf.DiagnosticTrap() as trap:
        try:
            usd_stage = open_usd_stage(path, notes, reading)
            bake_skinning(usd_stage, notes)
            scene = _Reader(path, usd_stage, notes).read()
        except (Tf.ErrorException, UnicodeDecodeError) as error:
            raise InputError(path, f"USD cannot read it ({_reason(error)})", "an intact USD file") from error
        finally:
            remarks = [_commentary(remark) for remark in (*trap.GetWarnings(), *trap.GetErrors())]
            # USD reports composition errors twice. ``open_usd_stage`` has counted them already.
            remarks = [remark for remark in remarks if "(instantiating stage on stage" not in remark]
            trap.Clear()
    if remarks:
        more = f" (and {len(remarks) - 1} more)" if len(remarks) > 1 else ""
        notes.say(f"USD reported: {' '.join(remarks[0].split())}{more}")
    mixed = any("which USD does not convert" in sentence for sentence in notes.sentences())
    return with_remarks(scene, notes, "metersPerUnit", always=mixed)


def _reason(error: Exception) -> str:
    """The text of USD's own error."""
    try:
        text = str(error)
    except UnicodeDecodeError as undecodable:  # the text quotes bytes of the file that are no UTF-8
        text = str(undecodable)
    quoted = [line.split(" : ", 1)[-1].strip("' ") for line in text.splitlines() if " : '" in line]
    whys = [line for line in quoted if not line.startswith("Failed to open layer")] or quoted
    return re.sub(r"pxrInternal\w*?::", "", "; ".join(whys)) or text  # without the namespace of USD's own build


def _commentary(remark: Any) -> str:
    """The text of one of USD's diagnostics."""
    try:
        return remark.commentary
    except UnicodeDecodeError as undecodable:
        return str(undecodable)


class _Reader:
    """Reads one USD stage, prim by prim."""

    def __init__(self, path: Path, usd_stage: Usd.Stage, notes: Notes) -> None:
        self._path = path
        self._usd_stage = usd_stage
        self._notes = notes
        self._to_world = usd_stage_to_world(path, usd_stage, notes)
        self._clock = Clock.of(usd_stage, notes)
        self._transforms = Transforms(self._clock, self._to_world, notes)
        self._start = Usd.TimeCode(self._clock.start)
        # Kept for all instances of a prim, by its path, and by its path and the materials bound above it.
        self._shapes: dict[Sdf.Path, PrimShape] = {}
        self._bound_material = cache(_bound_material)
        self._turn = self._to_world[:3, :3] / np.cbrt(np.linalg.det(self._to_world[:3, :3]))
        self._objects: list[SceneObject] = []
        self._targets: list[PointTarget] = []
        self._triangles = 0
        self._spacings: list[float] = []
        self._registry = Usd.SchemaRegistry()

    def read(self) -> Scene:
        root = self._usd_stage.GetPseudoRoot()
        top = _Inherited(Frame(root, "", np.eye(4), None, SCENE_PRIMS))
        for prim in root.GetFilteredChildren(SCENE_PRIMS):
            self._read_from(prim, top)
        note_coarse_vertices(self._spacings, self._notes)
        outside = "# animations have samples before startTimeCode or after endTimeCode, which count too"
        self._notes.count(outside, self._clock.outside)
        return Scene(self._path.stem, tuple(self._objects), tuple(self._targets), str(self._path))

    def _read_from(self, prim: Usd.Prim, inherited: _Inherited) -> None:
        """Read a prim and everything below it."""
        waiting = [(prim, inherited)]
        while waiting:
            below = self._visit(*waiting.pop())
            waiting.extend(reversed(below))  # the last one is taken next: the order of the USD stage

    def _visit(self, prim: Usd.Prim, inherited: _Inherited) -> list[tuple[Usd.Prim, _Inherited]]:
        """Read the prim itself; return the prims below it that are to be read, with what they inherit."""
        imageable = UsdGeom.Imageable(prim)
        if imageable:
            visibility = imageable.GetVisibilityAttr()
            blinks = visibility.ValueMightBeTimeVarying()
            self._notes.count("# prims appear or vanish: taken as at the start", int(blinks))
            if visibility.Get(self._start) == UsdGeom.Tokens.invisible:
                self._notes.count("# invisible prims skipped, with everything below them")
                return []
            if imageable.GetPurposeAttr().HasAuthoredValue():
                inherited = replace(inherited, purpose=str(imageable.GetPurposeAttr().Get()))
        inherited = self._with_attributes(prim, inherited)
        class_name = None
        if prim.HasAttribute("radar:class"):
            class_name = self._word(prim, "radar:class", "the name of a class, e.g. car")
        straight = inherited.velocity is not None
        labelling = inherited.labelling.below(prim, class_name, inherited.frame, self._transforms, straight)
        inherited = replace(inherited, labelling=labelling)
        is_gprim, is_instancer = prim.IsA(UsdGeom.Gprim), prim.IsA(UsdGeom.PointInstancer)
        if inherited.purpose not in (UsdGeom.Tokens.guide, UsdGeom.Tokens.proxy):
            kind = target_kind(self._path, prim, self._start, inherited.targets_by_name)
            note_unread(prim, kind, self._notes)
            if kind is not None or prim.HasAttribute("radar:rcs_dbsm"):
                self._add_target(prim, inherited, kind)
                return []
            if is_instancer:
                self._read_instances(UsdGeom.PointInstancer(prim), inherited)
                return []
            self._add_geometry(prim, is_gprim, inherited)
        elif is_gprim or is_instancer:
            self._notes.count(f"# prims of purpose {inherited.purpose} skipped")
        return [(child, inherited) for child in prim.GetFilteredChildren(inherited.frame.predicate)]

    def _with_attributes(self, prim: Usd.Prim, inherited: _Inherited) -> _Inherited:
        """What holds for a prim and below it, with what the prim itself states.

        :raises InputError: a ``radar:`` attribute without a usable value
        """
        stated: dict[str, Any] = {}
        if prim.HasAttribute("radar:velocity"):
            velocity = self._numbers(prim, "radar:velocity", 3, "three finite numbers [m/s]")
            stated["velocity"] = triple(self._turn @ velocity)
        if prim.HasAttribute("radar:material"):
            stated["material"] = self._word(prim, "radar:material", "a material name")
        if prim.HasAttribute("radar:targets_by_name"):
            by_name = prim.GetAttribute("radar:targets_by_name").Get(self._start)
            if not isinstance(by_name, bool):
                raise InputError(self._path, f"{prim.GetPath()}.radar:targets_by_name = {by_name!r}", "true or false")
            stated["targets_by_name"] = by_name
        return replace(inherited, **stated) if stated else inherited

    def _numbers(self, prim: Usd.Prim, name: str, size: int, expected: str) -> NDArray[np.float64]:
        """A custom attribute's value as [size] float64."""
        value = prim.GetAttribute(name).Get(self._start)
        try:
            numbers = np.array(value, dtype=np.float64).reshape(-1)
        except (TypeError, ValueError):
            numbers = np.empty(0)
        if isinstance(value, (str, bool)) or numbers.shape != (size,) or not np.isfinite(numbers).all():
            raise InputError(self._path, f"{prim.GetPath()}.{name} = {value!r}", expected)
        return numbers

    def _word(self, prim: Usd.Prim, name: str, expected: str) -> str:
        """A custom attribute's value as text."""
        value = prim.GetAttribute(name).Get(self._start)
        if not isinstance(value, str) or not value:
            raise InputError(self._path, f"{prim.GetPath()}.{name} = {value!r}", expected)
        return value

    def _add_target(self, prim: Usd.Prim, inherited: _Inherited, kind: str | None) -> None:
        model, occupied = None, None
        matrix, motion = self._placing(prim, inherited)
        turned = model_axes(matrix[:3, :3], self._turn)
        if kind is None:
            rcs_dbsm = float(self._numbers(prim, "radar:rcs_dbsm", 1, "a finite number [dBsm]")[0])
            if abs(rcs_dbsm) > LARGEST_RCS_DBSM:
                bounds = f"{-LARGEST_RCS_DBSM:g} to {LARGEST_RCS_DBSM:g} dBsm"
                raise InputError(self._path, f"{prim.GetPath()}.radar:rcs_dbsm = {rcs_dbsm:g}", bounds)
        else:
            model = prim_model(self._path, prim, self._start, kind)
            rcs_dbsm = model.nominal_rcs_dbsm
            if turned is None:
                raise InputError(self._path, f"{prim.GetPath()}: its transform is flat", "one that keeps x and z apart")
        axes = turned or WORLD_AXES
        below = list(Usd.PrimRange(prim, inherited.frame.predicate))
        replaced = sum(1 for item in below if item.IsA(UsdGeom.Gprim) or item.IsA(UsdGeom.PointInstancer))
        if kind is None and replaced:
            occupied = occupied_below(prim, self._start, (self._to_world @ matrix)[:3, :3], axes)
        reason = "a point target (radar:rcs_dbsm)" if kind is None else "the model of a target"
        self._notes.count(f"# geometry prims left out: {reason} stands for them", replaced)
        lost = sum(
            item.HasAttribute("radar:rcs_dbsm") or target_kind(self._path, item, self._start, False) is not None
            for item in below
            if item != prim
        )
        self._notes.count("# targets left out: they are below another target, which stands for them", lost)
        x, y, z = (float(value) for value in (self._to_world @ matrix)[:3, 3])
        if not (np.abs([x, y, z]) <= FARTHEST_M).all():
            raise InputError(
                self._path, f"{prim.GetPath()} stands at ({x}, {y}, {z})", f"a position within {FARTHEST_M:g} m"
            )
        name, velocity = inherited.frame.name(prim), inherited.velocity or ZERO
        label = inherited.labelling.of_target(
            prim, kind, inherited.frame, self._transforms, inherited.velocity is not None
        )
        target = PointTarget(name, (x, y, z), rcs_dbsm, velocity, model, axes, motion, occupied=occupied, label=label)
        if motion is not None:
            check_motion(self._path, name, motion)
            target = replace(target, velocity=target.at(0.0).velocity)
        if model is not None and (problem := model.unfit(float(np.dot(axes[0], target.velocity)))):
            raise InputError(self._path, f"{prim.GetPath()}: {problem}")
        self._targets.append(target)
        self._check_counts(name)

    def _placing(
        self, prim: Usd.Prim, inherited: _Inherited, track: Samples | None = None
    ) -> tuple[NDArray[np.float64], Motion | None]:
        """[4, 4] from the prim's coordinates to the USD stage's at time 0, and how the prim moves.

        :param track: its points' samples
        """
        frame = inherited.frame
        chain = self._transforms.chain(prim, frame)
        matrix = self._transforms.rest(prim, frame) if chain is None else chain.at(0.0)[0]
        motion = self._transforms.motion(prim, frame, chain)
        if inherited.velocity is not None:
            both = motion is not None or track is not None
            self._notes.count("# objects have radar:velocity and time samples: the attribute says how they move", both)
            return matrix, None
        if track is not None:
            chain = Chain((self._to_world,)).then(*(chain.factors if chain is not None else (matrix,)))
            motion = Moving(frame.name(prim), chain, track)
        return matrix, motion

    def _read_instances(self, instancer: UsdGeom.PointInstancer, inherited: _Inherited) -> None:
        path, depth = str(instancer.GetPath()), len(inherited.instancers)
        if path in inherited.instancers:
            raise InputError(self._path, f"point instancer {path} is within its own prototypes", "no such loop")
        if depth >= MAXIMUM_NESTING:
            raise InputError(self._path, f"{path} lies within {depth} levels of instances", f"less than {depth}")
        inherited = replace(inherited, instancers=(*inherited.instancers, path))
        note_instancer(instancer, self._start, self._notes)
        try:
            frames = instance_frames(instancer, inherited.frame, self._transforms, PROTOTYPE_PRIMS)
        except ValueError as error:
            raise InputError(self._path, f"point instancer {path}: {error}", "arrays that fit together") from error
        known = set()
        for frame, repeats in frames:
            objects, triangles = self._count, self._triangles
            self._read_from(frame.root, replace(inherited, frame=frame))
            if frame.root not in known:  # what the first instance of a prototype makes, each of them will
                known.add(frame.root)
                objects, triangles = repeats * (self._count - objects), repeats * (self._triangles - triangles)
                check_counts(self._path, f"point instancer {path}", objects, triangles)

    @property
    def _count(self) -> int:
        return len(self._objects) + len(self._targets)

    def _check_counts(self, name: str) -> None:
        check_counts(self._path, f"the scene as far as {name}", self._count, self._triangles)

    def _add_geometry(self, prim: Usd.Prim, is_gprim: bool, inherited: _Inherited) -> None:
        if has_shape(prim):
            self._add_shape(prim, inherited)
            return
        kind = str(prim.GetTypeName())
        if is_gprim:
            self._notes.count(f"# prims of type {kind} ignored")
        elif kind and self._registry.FindConcretePrimDefinition(kind) is None:
            self._notes.count(f"# prims of unknown type {kind} ignored")

    def _add_shape(self, prim: Usd.Prim, inherited: _Inherited) -> None:
        """One object for the prim, or one for each of its material subsets and one for the rest."""
        path = source_path(prim)
        shape = self._shapes.get(path) or prim_shape(prim, self._clock, inherited.frame.predicate)
        if prim.IsInstanceProxy() or not inherited.frame.root.IsPseudoRoot():
            self._shapes[path] = shape
        self._notes.repeat(shape.notes)
        if not shape.parts:
            return
        matrix, motion = self._placing(prim, inherited, shape.track)
        matrix = self._to_world @ matrix
        label = inherited.labelling.of_shape(prim, inherited.frame, self._transforms, shape.track is not None)
        self._spacings.append(vertex_spacing_m(shape.points, matrix))
        if motion is not None:
            check_motion(self._path, inherited.frame.name(prim), motion, shape.probes)
        for subset, triangles in shape.parts:
            part, own = prim, inherited
            if subset:
                part = prim.GetChild(subset)
                own = self._with_attributes(part, inherited)
            vertices, kept, used = place_mesh(shape.points, triangles, matrix, self._notes)
            if not len(kept):
                self._notes.count("# meshes or subsets without a usable triangle ignored")
                continue
            name, material, velocity = own.frame.name(part), self._material(part, own), own.velocity or ZERO
            its_own = motion if own.velocity is None else None  # a subset may have a radar:velocity
            local = (shape.points, used) if isinstance(its_own, Moving) else None
            item = SceneObject(name, vertices, kept, material, velocity, its_own, label, local).as_it_moves()
            self._objects.append(item)
            self._triangles += len(kept)
            self._check_counts(name)

    def _material(self, prim: Usd.Prim, inherited: _Inherited) -> str:
        if inherited.material is not None:
            return inherited.material
        material, leads_nowhere = self._bound_material(prim)
        self._notes.count("# material bindings lead to no material", int(leads_nowhere))
        return material


def _bound_material(prim: Usd.Prim) -> tuple[str, bool]:
    """Name of the material bound to a prim, "" without one, and whether a binding leads to no material."""
    binding = UsdShade.MaterialBindingAPI(prim)
    purposes = (UsdShade.Tokens.allPurpose, UsdShade.Tokens.full, UsdShade.Tokens.preview)
    found = (binding.ComputeBoundMaterial(purpose)[0] for purpose in purposes)
    bound = next((material for material in found if material), None)
    leads_nowhere = not bound and bool(binding.GetDirectBindingRel().GetTargets())
    return str(bound.GetPrim().GetName()) if bound else "", leads_nowhere
