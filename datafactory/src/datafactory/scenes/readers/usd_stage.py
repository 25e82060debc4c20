"""A whole USD stage: its variants, missing layers, units and axes, size.

Of what it refers to and cannot be opened, a material's loss is a remark, that of geometry an error: how they are told
apart says docs/scenes.md#what-cannot-be-opened. Files are often passed on without their materials: MaterialX needs a
plugin of its own, textures are large. The radar takes from them a name at most.
"""

from __future__ import annotations

import re
from collections import defaultdict
from pathlib import Path, PurePosixPath

import numpy as np
from numpy.typing import NDArray

from datafactory.scenes.readers.common import AS_WRITTEN, MAXIMUM_NESTING, Y_UP_TO_Z_UP, Notes, Reading
from datafactory.scenes.usd_library import Pcp, Sdf, Usd, UsdGeom
from shared.physics.errors import InputError

UP_TO_Z_UP = {"X": np.eye(3)[[1, 2, 0]], "Y": Y_UP_TO_Z_UP, "Z": np.eye(3)}
"""Rotations to z up. X up is no value that USD defines, but older exporters wrote it: (x, y, z) becomes (y, z, x)."""
LEFT_OUT = (
    Pcp.ErrorInvalidAssetPath, Pcp.ErrorInvalidSublayerPath, Pcp.ErrorMutedAssetPath, Pcp.ErrorUnresolvedPrimPath,
)  # fmt: skip
"""Composition errors that leave out a part of the scene."""
MATERIAL_SUFFIXES = frozenset([
    ".mtlx", ".mdl", ".osl", ".oso", ".glslfx",
    ".png", ".jpg", ".jpeg", ".exr", ".hdr", ".tif", ".tiff", ".tga", ".tx", ".tex", ".webp",
])  # fmt: skip
MATERIAL_TYPES = frozenset(("Material", "Shader", "NodeGraph"))
MATERIAL_SCOPES = frozenset(
    ["material", "materials", "mat", "mats", "mtl", "mtls", "look", "looks", "shader", "shaders", "texture", "textures"]
)
BINDINGS = "material:binding"
EVEN_UNDEFINED = Usd.PrimIsActive & Usd.PrimIsLoaded
"""The prims of a point instancer's prototype are often overs or classes, for it alone to show them."""


def open_usd_stage(path: Path, notes: Notes, reading: Reading = AS_WRITTEN) -> Usd.Stage:
    """Open a USD stage with everything loaded.

    :raises InputError: a sublayer, reference or payload of geometry leads nowhere; a variant that there is not
    :raises pxr.Tf.ErrorException: the root layer cannot be parsed
    """
    usd_stage = Usd.Stage.Open(str(path))
    select_variants(usd_stage, reading.variants)
    for name, variant in reading.variants:
        notes.say(f"variant {name} = {variant} selected, as asked for")
    errors = usd_stage.GetCompositionErrors()
    missing = note_missing(usd_stage, errors, notes)
    if missing and not reading.allow_missing:
        more = f" (and {len(missing) - 1} more)" if len(missing) > 1 else ""
        raise InputError(path, f"{missing[0]}{more}", "every layer in its place, or --allow-missing to go on without")
    if missing:
        what = "# references to geometry cannot be opened and are left out"
        notes.count(f"{what}, the first: {missing[0]}", len(missing))
    errors = [error for error in errors if not isinstance(error, LEFT_OUT)]
    # The name of an anonymous layer is its address in memory, which differs from run to run.
    errors.sort(key=str)
    first = re.sub(r"@anon:[^@]*@,?|@,@anon:[^@]*(?=@)", "", " ".join(str(errors[0]).split())) if errors else ""
    notes.count(f"# composition errors, the first: {first}", len(errors))
    return usd_stage


def select_variants(usd_stage: Usd.Stage, variants: tuple[tuple[str, str], ...]) -> None:
    """Select variants on every prim that has them, in a layer of this session.

    A variant may bring in prims with further sets, so that it is repeated until nothing changes. Instances that have
    such a prim in them become plain prims: nothing can be selected within an instance.

    :param variants: (set, variant)
    :raises InputError: no prim has the set, or none of its sets has the variant
    """
    if not variants:
        return
    usd_stage.SetEditTarget(Usd.EditTarget(usd_stage.GetSessionLayer()))
    known: dict[str, set[str]] = defaultdict(set)
    for _ in range(MAXIMUM_NESTING):
        changed = False
        for prim in list(usd_stage.Traverse(EVEN_UNDEFINED)):
            for name, variant in _differing(prim, variants, known):
                prim.GetVariantSet(name).SetVariantSelection(variant)
                changed = True
        for prototype in usd_stage.GetPrototypes():
            inner = (prim for prim in Usd.PrimRange(prototype) if prim != prototype)
            if any([_differing(prim, variants, known) for prim in inner]):
                for instance in prototype.GetInstances():
                    if not instance.IsInPrototype():
                        instance.SetInstanceable(False)
                        changed = True
        if not changed:
            break
    for name, variant in variants:
        if name not in known:
            sets = ", ".join(sorted(known)) or "none: the file has no variant sets"
            raise InputError("--variant", f"no prim has a variant set {name!r}", sets)
        if variant not in known[name]:
            raise InputError("--variant", f"{name} has no variant {variant!r}", ", ".join(sorted(known[name])))


def _differing(
    prim: Usd.Prim, variants: tuple[tuple[str, str], ...], known: dict[str, set[str]]
) -> list[tuple[str, str]]:
    """Those of the variants that the prim has and does not select; ``known`` takes all that it has."""
    if not prim or not prim.HasVariantSets():
        return []
    sets = prim.GetVariantSets()
    for name in sets.GetNames():
        known[name].update(sets.GetVariantSet(name).GetVariantNames())
    return [
        (name, variant)
        for name, variant in variants
        if sets.HasVariantSet(name)
        and variant in sets.GetVariantSet(name).GetVariantNames()
        and sets.GetVariantSet(name).GetVariantSelection() != variant
    ]


def usd_stage_to_world(path: Path, usd_stage: Usd.Stage, notes: Notes) -> NDArray[np.float64]:
    """[4, 4] from USD stage units and axes to metres and z up.

    :raises InputError: metersPerUnit or timeCodesPerSecond is not a positive number, startTimeCode is not finite
    """
    metres = float(UsdGeom.GetStageMetersPerUnit(usd_stage))
    if not 1e-12 <= metres <= 1e12:
        raise InputError(path, f"metersPerUnit = {metres:g}", "a positive number, 1 for metres, 0.01 for centimetres")
    if not UsdGeom.StageHasAuthoredMetersPerUnit(usd_stage):
        notes.say(f"no metersPerUnit: USD's default of {metres:g} m is used")
    codes_per_second = usd_stage.GetTimeCodesPerSecond()
    if not (np.isfinite(codes_per_second) and codes_per_second > 0):
        raise InputError(path, f"timeCodesPerSecond = {codes_per_second:g}", "a positive number")
    if not np.isfinite(usd_stage.GetStartTimeCode()):
        raise InputError(path, f"startTimeCode = {usd_stage.GetStartTimeCode()}", "a finite number")
    axis = str(UsdGeom.GetStageUpAxis(usd_stage))
    if axis not in UP_TO_Z_UP:
        raise InputError(path, f"upAxis = {axis!r}", "X, Y or Z")
    if not usd_stage.HasAuthoredMetadata(UsdGeom.Tokens.upAxis):
        notes.say(f"no upAxis: USD's default {axis} is used")
    _note_other_units(usd_stage, metres, axis, notes)
    matrix = np.eye(4)
    matrix[:3, :3] = metres * UP_TO_Z_UP[axis]
    return matrix


def _note_other_units(usd_stage: Usd.Stage, metres: float, axis: str, notes: Notes) -> None:
    """Note layers in other units or axes than the USD stage's: USD converts neither."""
    for layer in sorted(usd_stage.GetUsedLayers(), key=lambda layer: layer.identifier):
        top = layer.pseudoRoot
        other = top.GetInfo(UsdGeom.Tokens.metersPerUnit) if top.HasInfo(UsdGeom.Tokens.metersPerUnit) else metres
        if not np.isclose(other, metres, rtol=1e-6):
            notes.count(
                f"# layers are in units of {other:g} m within a stage of {metres:g} m, which USD does not convert"
            )
        other_axis = top.GetInfo(UsdGeom.Tokens.upAxis) if top.HasInfo(UsdGeom.Tokens.upAxis) else axis
        if other_axis != axis:
            notes.count(f"# layers have {other_axis} up within a stage with {axis} up, which USD does not convert")


def note_missing(usd_stage: Usd.Stage, errors: list[Pcp.ErrorBase], notes: Notes) -> list[str]:
    """The geometry that cannot be opened, a sentence each, always in the same order; lost materials are noted.

    :param errors: of the stage's composition
    """
    lost = [error for error in errors if isinstance(error, LEFT_OUT)]
    if not lost:
        return []
    bound = {  # paths that material bindings lead to
        target
        for prim in usd_stage.Traverse()
        for relationship in prim.GetRelationships()
        if relationship.GetName().startswith(BINDINGS)
        for target in relationship.GetTargets()
    }
    materials, geometry = set[str](), set[str]()
    for error in lost:
        sentence = " ".join(str(error).split()).rstrip(".")
        (materials if _is_material(usd_stage, error, sentence, bound) else geometry).add(sentence)
    if materials:
        first = _asset(min(materials)) or min(materials)
        what = "# references to materials, shaders or textures cannot be opened"
        notes.count(f"{what}, the first {first}: defaults stand for them", len(materials))
    return sorted(geometry)


def _asset(sentence: str) -> str:
    """The file that a composition error is about."""
    found = re.search(r"@([^@]*)@", sentence)
    return PurePosixPath(found.group(1)).name if found else ""


def _is_material(usd_stage: Usd.Stage, error: Pcp.ErrorBase, sentence: str, bound: set[Sdf.Path]) -> bool:
    if PurePosixPath(_asset(sentence)).suffix.lower() in MATERIAL_SUFFIXES:
        return True
    path = error.rootSite.path
    prim = usd_stage.GetPrimAtPath(path)
    if isinstance(error, Pcp.ErrorInvalidSublayerPath) or not prim:
        return False
    if any(item.IsA(UsdGeom.Gprim) for item in Usd.PrimRange(prim)):
        return False
    if any(target.HasPrefix(path) for target in bound):
        return True
    while prim and not prim.IsPseudoRoot():
        if str(prim.GetTypeName()) in MATERIAL_TYPES or prim.GetName().lower() in MATERIAL_SCOPES:
            return True
        prim = prim.GetParent()
    return False
