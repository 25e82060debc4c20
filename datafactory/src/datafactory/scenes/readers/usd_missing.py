"""What a USD stage refers to and cannot be opened: a material's loss is a remark, that of geometry an error.

Files are often passed on without their materials: MaterialX needs a plugin of its own, textures are large. The radar
takes from them a name at most. Whether something is a material's follows from the type of the prim and of those above
it, from the suffix of the file, from a material binding that leads there, and at last from the names of its scopes.
"""

from __future__ import annotations

import re
from pathlib import PurePosixPath

from datafactory.scenes.readers.common import Notes
from datafactory.scenes.usd_library import Pcp, Sdf, Usd, UsdGeom

LEFT_OUT = (
    Pcp.ErrorInvalidAssetPath,
    Pcp.ErrorInvalidSublayerPath,
    Pcp.ErrorMutedAssetPath,
    Pcp.ErrorUnresolvedPrimPath,
)
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


def note_missing(usd_stage: Usd.Stage, errors: list[Pcp.ErrorBase], notes: Notes) -> list[str]:
    """The geometry that cannot be opened, a sentence each, always in the same order; lost materials are noted.

    :param errors: of the stage's composition
    """
    lost = [error for error in errors if isinstance(error, LEFT_OUT)]
    if not lost:
        return []
    bound = _bound_paths(usd_stage)
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


def _bound_paths(usd_stage: Usd.Stage) -> set[Sdf.Path]:
    """Paths that material bindings lead to."""
    return {
        target
        for prim in usd_stage.Traverse()
        for relationship in prim.GetRelationships()
        if relationship.GetName().startswith(BINDINGS)
        for target in relationship.GetTargets()
    }


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
