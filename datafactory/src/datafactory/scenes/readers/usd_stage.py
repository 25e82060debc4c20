"""A USD stage as a whole: is it complete, what are its units and axes, is its size plausible."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pxr import Pcp, Usd, UsdGeom

from datafactory.scenes.readers.meshes import Y_UP_TO_Z_UP
from datafactory.scenes.readers.notes import Notes
from datafactory.scenes.readers.scale import size_remark
from datafactory.scenes.scene import Scene
from shared.physics.errors import InputError

# Composition errors after which part of the scene is not there.
MISSING = (
    Pcp.ErrorInvalidAssetPath,
    Pcp.ErrorInvalidSublayerPath,
    Pcp.ErrorMutedAssetPath,
    Pcp.ErrorUnresolvedPrimPath,
)


def open_stage(path: Path, notes: Notes) -> Usd.Stage:
    """Open a stage with everything loaded.

    :raises InputError: a sublayer, reference or payload leads nowhere
    :raises pxr.Tf.ErrorException: the root layer cannot be parsed
    """
    stage = Usd.Stage.Open(str(path))
    errors = stage.GetCompositionErrors()
    missing = [error for error in errors if isinstance(error, MISSING)]
    if missing:
        more = f" (and {len(missing) - 1} more)" if len(missing) > 1 else ""
        raise InputError(path, f"{str(missing[0]).rstrip('.')}{more}", "every layer in its place")
    # Anonymous layers are named by their address in memory, which would differ from run to run.
    first = re.sub(r"@anon:[^@]*@,?|@,@anon:[^@]*(?=@)", "", " ".join(str(errors[0]).split())) if errors else ""
    notes.count(f"# composition errors, the first: {first}", len(errors))
    return stage


def stage_to_world(path: Path, stage: Usd.Stage, notes: Notes) -> NDArray[np.float64]:
    """[4, 4] from stage units and axes to metres and z up.

    :raises InputError: metersPerUnit is not a positive number, or timeCodesPerSecond
    """
    metres = float(UsdGeom.GetStageMetersPerUnit(stage))
    if not 1e-12 <= metres <= 1e12:
        raise InputError(path, f"metersPerUnit = {metres:g}", "a positive number, 1 for metres, 0.01 for centimetres")
    if not UsdGeom.StageHasAuthoredMetersPerUnit(stage):
        notes.say(f"no metersPerUnit: USD's default of {metres:g} m is used")
    codes_per_second = stage.GetTimeCodesPerSecond()
    if not (np.isfinite(codes_per_second) and codes_per_second > 0):
        raise InputError(path, f"timeCodesPerSecond = {codes_per_second:g}", "a positive number")
    axis = str(UsdGeom.GetStageUpAxis(stage))
    if axis not in (UsdGeom.Tokens.y, UsdGeom.Tokens.z):
        raise InputError(path, f"upAxis = {axis!r}", "Y or Z")
    if not stage.HasAuthoredMetadata(UsdGeom.Tokens.upAxis):
        notes.say(f"no upAxis: USD's default {axis} is used")
    _note_other_units(stage, metres, axis, notes)
    matrix = np.eye(4)
    matrix[:3, :3] = metres * (Y_UP_TO_Z_UP if axis == UsdGeom.Tokens.y else np.eye(3))
    return matrix


def _note_other_units(stage: Usd.Stage, metres: float, axis: str, notes: Notes) -> None:
    """USD does not convert a referenced layer's units: a file that mixes them is easily 100 times too large."""
    for layer in stage.GetUsedLayers():
        top = layer.pseudoRoot
        other = top.GetInfo(UsdGeom.Tokens.metersPerUnit) if top.HasInfo(UsdGeom.Tokens.metersPerUnit) else metres
        if not np.isclose(other, metres, rtol=1e-6):
            notes.count(
                f"# layers are in units of {other:g} m within a stage of {metres:g} m, which USD does not convert"
            )
        other_axis = top.GetInfo(UsdGeom.Tokens.upAxis) if top.HasInfo(UsdGeom.Tokens.upAxis) else axis
        if other_axis != axis:
            notes.count(f"# layers have {other_axis} up within a stage with {axis} up, which USD does not convert")


def check_sizes(scene: Scene, notes: Notes) -> None:
    """Say how large the scene is where its units look wrong."""
    mixed = any("which USD does not convert" in sentence for sentence in notes.sentences())
    if remark := size_remark(scene, "metersPerUnit", always=mixed):
        notes.say(remark)
