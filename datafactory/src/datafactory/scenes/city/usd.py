"""Writes placed surfaces as a USD stage, for the shipped scenes and the procedural city.

The USD stage is in metres and z up. Each placement is an Xform with a mesh named Geometry below it. Surfaces that share
a model are written once and referenced as instances. The attributes for the radar are those of the USD reader:
``radar:velocity`` (double3, world frame, m/s), ``radar:rcs_dbsm`` (float, dBsm: a point target in place of the meshes
below it), and ``radar:class`` (string: what a detector is to find).
"""

from __future__ import annotations

import errno
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from datafactory.scenes.city.shapes import Surface
from datafactory.scenes.city.site import Placement
from datafactory.scenes.usd_library import Gf, Sdf, Tf, Usd, UsdGeom, UsdShade
from shared.dataset.writing import atomic, make_folder, require_folder
from shared.physics.errors import InputError

SUFFIXES = (".usd", ".usda", ".usdc")

CODES_PER_SECOND = 10.0

MATERIAL_COLOURS = {
    "concrete": (0.62, 0.61, 0.58), "brick": (0.55, 0.27, 0.2), "glass": (0.45, 0.6, 0.7), "metal": (0.55, 0.57, 0.6),
    "asphalt": (0.2, 0.2, 0.21), "plasterboard": (0.88, 0.85, 0.76), "wood": (0.45, 0.32, 0.2),
    "bitumen": (0.25, 0.25, 0.26), "vegetation": (0.3, 0.45, 0.2), "marble": (0.85, 0.84, 0.82),
    "rubber": (0.08, 0.08, 0.08),
}  # fmt: skip
"""The material keys and the colours that viewers show; the radar does not use the colours."""


def check_output(path: Path) -> Path:
    """The path, if a USD file can be written there.

    :raises InputError: unknown suffix, a folder, or a file in place of a folder above it
    """
    path = Path(path)
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(path, f"suffix {path.suffix!r}", f"one of {', '.join(SUFFIXES)}")
    require_folder(path.parent, "--out", "a file in a folder")
    if os.path.isdir(path):  # unlike Path.is_dir it also answers for a name that the file system refuses
        raise InputError(path, "is a folder", "the name of a file")
    return path


def write_usd(
    path: Path, placements: Sequence[Placement], documentation: str, metadata: dict[str, Any] | None = None
) -> None:
    """Write the placements as one USD file; the same placements give the same bytes.

    :param path: ``.usda`` is text, ``.usdc`` and ``.usd`` are binary
    :param documentation: stands in the layer's header
    :param metadata: what made it, for the layer's ``customLayerData``, under the key ``sparseradar:city``
    :raises InputError: as :func:`check_output`, or where the file cannot be written
    """
    path = check_output(path)
    # The layer's own format decides between text and binary: the partial file's suffix is not that of USD.
    layer = Sdf.Layer.CreateAnonymous(path.suffix.lower())
    usd_stage = Usd.Stage.Open(layer)
    layer.documentation = documentation
    if metadata is not None:
        layer.customLayerData = {"sparseradar:city": metadata}
    ends_s = max((item.keyframes[-1].time_s for item in placements if item.keyframes), default=None)
    if ends_s is not None:
        usd_stage.SetTimeCodesPerSecond(CODES_PER_SECOND)
        usd_stage.SetStartTimeCode(0.0)
        usd_stage.SetEndTimeCode(_code(ends_s))
    UsdGeom.SetStageUpAxis(usd_stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(usd_stage, UsdGeom.LinearUnits.meters)
    usd_stage.SetDefaultPrim(UsdGeom.Xform.Define(usd_stage, "/World").GetPrim())
    used = {key for item in placements if item.surface is not None for key in item.surface.materials}
    for key in sorted(used):
        _define_material(usd_stage, key)

    for item in placements:
        xform = UsdGeom.Xform.Define(usd_stage, f"/World/{item.path}")
        prim = xform.GetPrim()
        for scope in prim.GetPath().GetPrefixes()[1:-1]:
            if not usd_stage.GetPrimAtPath(scope).GetTypeName():
                UsdGeom.Scope.Define(usd_stage, scope)
        _set_place(xform, item)
        if any(item.velocity):
            prim.CreateAttribute("radar:velocity", Sdf.ValueTypeNames.Double3).Set(Gf.Vec3d(*item.velocity))
        if item.rcs_dbsm is not None:
            prim.CreateAttribute("radar:rcs_dbsm", Sdf.ValueTypeNames.Float).Set(item.rcs_dbsm)
        if item.radar_class:
            prim.CreateAttribute("radar:class", Sdf.ValueTypeNames.String).Set(item.radar_class)
        if item.surface is None:
            continue
        if not item.model:
            _define_mesh(usd_stage, prim.GetPath(), item.surface)
            continue
        model = Sdf.Path(f"/World/Models/{item.model}")
        if not usd_stage.GetPrimAtPath(model):
            UsdGeom.Scope.Define(usd_stage, model.GetParentPath())
            usd_stage.CreateClassPrim(model).SetTypeName("Xform")
            _define_mesh(usd_stage, model, item.surface)
        prim.GetReferences().AddInternalReference(model)
        prim.SetInstanceable(True)

    try:
        make_folder(path.parent)
        with atomic(path) as partial:
            if not layer.Export(str(partial)):
                raise OSError(errno.EIO, "USD names no reason")
    except Tf.ErrorException as error:
        raise InputError(path, f"cannot be written ({error.args[0].commentary})", "a writable place") from None
    except OSError as error:
        raise InputError(path, f"cannot be written ({error.strerror})", "a writable place") from None


def _set_place(xform: UsdGeom.Xform, item: Placement) -> None:
    """Translation and rotation, with samples where the thing moves; what does not turn has no samples of its yaw."""
    if item.keyframes:
        turns = any(key.yaw_deg != item.keyframes[0].yaw_deg for key in item.keyframes)
        translation = xform.AddTranslateOp()
        for key in item.keyframes:
            translation.Set(Gf.Vec3d(*key.position), _code(key.time_s))
        if turns:
            rotation = xform.AddRotateZOp()
            for key in item.keyframes:
                rotation.Set(key.yaw_deg, _code(key.time_s))
        elif item.keyframes[0].yaw_deg:
            xform.AddRotateZOp().Set(item.keyframes[0].yaw_deg)
        return
    if any(item.position):
        xform.AddTranslateOp().Set(Gf.Vec3d(*item.position))
    if item.yaw_deg:
        xform.AddRotateZOp().Set(item.yaw_deg)


def _code(time_s: float) -> float:
    """The time code of a time [s], in hundredths: a file does not depend on the last digits of a sum."""
    return round(time_s * CODES_PER_SECOND, 2)


def _define_material(usd_stage: Usd.Stage, key: str) -> None:
    """A material prim named ``key`` with a preview surface, so that viewers show something."""
    material = UsdShade.Material.Define(usd_stage, f"/World/Materials/{key}")
    UsdGeom.Scope.Define(usd_stage, "/World/Materials")
    shader = UsdShade.Shader.Define(usd_stage, f"/World/Materials/{key}/Preview")
    shader.CreateIdAttr("UsdPreviewSurface")
    shader.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f).Set(Gf.Vec3f(*MATERIAL_COLOURS[key]))
    material.CreateSurfaceOutput().ConnectToSource(shader.ConnectableAPI(), "surface")


def _define_mesh(usd_stage: Usd.Stage, parent: Sdf.Path, surface: Surface) -> None:
    """The surface as a mesh below ``parent``: one material is bound to the mesh, several to a GeomSubset each."""
    mesh = UsdGeom.Mesh.Define(usd_stage, parent.AppendChild("Geometry"))
    points = surface.vertices.astype(np.float32)
    mesh.CreatePointsAttr(points)
    mesh.CreateFaceVertexCountsAttr([len(face) for face in surface.faces])
    mesh.CreateFaceVertexIndicesAttr([vertex for face in surface.faces for vertex in face])
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    mesh.CreateExtentAttr(np.stack([points.min(axis=0), points.max(axis=0)]))
    keys = list(dict.fromkeys(surface.materials))
    if len(keys) == 1:
        _bind(usd_stage, mesh.GetPrim(), keys[0])
        return
    for key in keys:
        faces = [i for i, other in enumerate(surface.materials) if other == key]
        binding = UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim())
        subset = binding.CreateMaterialBindSubset(key.capitalize(), faces)
        _bind(usd_stage, subset.GetPrim(), key)


def _bind(usd_stage: Usd.Stage, prim: Usd.Prim, key: str) -> None:
    material = UsdShade.Material.Get(usd_stage, f"/World/Materials/{key}")
    UsdShade.MaterialBindingAPI.Apply(prim).Bind(material)
