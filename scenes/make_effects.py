"""Write the effect scenes into ``effects/``: ``.venv/bin/python scenes/make_effects.py``.

Each scene calls for a known set of effects. ``tests/effect_scenes/expected.json`` says which and why, by hand
calculation. Metres, z up; the sensor stands about 0.5 m high near the origin and looks along +x. There is no
ground except where a scene says so: the bodies hang in free space, because a road under the sensor alone would call for
half of the effects. Faces are set a little aside, so that no line of sight runs along the diagonal that cuts them into
triangles. Everything follows from the numbers below: the same versions write the same bytes.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Gf, Sdf, Usd, UsdGeom

from datafactory.scenes.city.shapes import Polygon, Surface, box, prism, welded
from datafactory.scenes.city.site import Placement

Vector = tuple[float, float, float]

SENSOR: Vector = (0.0, 0.0, 0.5)
STEPS_M = (0.0, -0.5, -1.0)
YAWS_DEG = (0.0, 2.0, -2.0)
"""Where the poses of a scene stand along x, and how far they look aside: nothing may hang on one spot."""
CORNER_AT: Vector = (60.165, 0.47, 0.0)
"""Of small meshes that lie in one resolution cell: at the far end of a range bin, in the middle of a cell of u [m]."""
EGO_VELOCITY: Vector = (11.0, 0.0, 0.0)
"""Below the 12 m/s from which the default radar's Doppler axis wraps."""
ROAD = [(-20.0, -10.0), (0.0, -60.0), (150.0, -64.0), (150.0, 64.0), (0.0, 60.0), (-20.0, 10.0)]
FIELD = [(1.0, 0.0), (60.0, -50.0), (120.0, 0.0), (60.0, 50.0)]
"""Outlines of the ground [m]. No side ahead of the sensor has a point within 94 m in which the line of sight meets it
at a right angle, so that none sends an edge's echo back; the field begins 1 m ahead of the sensor."""


@dataclass(frozen=True)
class EffectScene:
    """A scene and where it is seen from.

    :param shows: what it is, one sentence; stands in the header of its file
    :param pieces: its bodies, each of one material; a surface with a cross section beside it is a picture
    :param poses: entries of a ``--poses`` file
    """

    name: str
    shows: str
    pieces: tuple[Placement, ...]
    poses: list[dict[str, Any]] = field(default_factory=lambda: standing())


def poses(
    steps_m: Sequence[float],
    yaws_deg: Sequence[float] = (0.0, 0.0, 0.0),
    times_s: Sequence[float] = (0.0, 0.0, 0.0),
    velocity: Vector = (0.0, 0.0, 0.0),
) -> list[dict[str, Any]]:
    """Entries of a ``--poses`` file: how far along x from ``SENSOR`` [m], how far aside it looks, and when."""
    return [
        {"position": [SENSOR[0] + step, SENSOR[1], SENSOR[2]], "yaw_deg": yaw, "velocity": list(velocity), "time": time}
        for step, yaw, time in zip(steps_m, yaws_deg, times_s, strict=True)
    ]


def standing(times_s: Sequence[float] = (0.0, 0.0, 0.0)) -> list[dict[str, Any]]:
    """Poses at rest, on boresight of what stands ahead within +-2 deg: the pattern loses less than 0.01 dB."""
    return poses(STEPS_M, YAWS_DEG, times_s)


LEVEL = poses((0.0, -0.45, -0.9))
"""At rest in steps of three range bins: what fills one resolution cell does so from all of them."""
DRIVING = poses((0.0, 0.55, 1.1), times_s=(0.0, 0.05, 0.1), velocity=EGO_VELOCITY)
"""The sensor moves along its boresight."""


def sheet(corners: Sequence[Sequence[float]], material: str) -> Surface:
    """One plane face without thickness: the slab that the tracer assumes behind a facet is then the pane itself."""
    return welded([Polygon(np.array(corners, dtype=np.float64), material)])


def upright(width: float, lower: float, upper: float, material: str) -> Surface:
    """A sheet across the x axis that faces the sensor, from z = lower to upper [m]."""
    half = 0.5 * width
    return sheet([(0, half, lower), (0, -half, lower), (0, -half, upper), (0, half, upper)], material)


def corner_reflector(edge: float) -> Surface:
    """A trihedral for the eye: three right-angled triangles about the origin, open towards -x."""
    a = edge / math.sqrt(3.0)  # the opening's corners lie on a circle about the axis
    tips = [
        (-a, a * math.sqrt(2.0) * math.sin(turn), a * math.sqrt(2.0) * math.cos(turn)) for turn in (0.0, 2.0944, 4.1888)
    ]
    return welded([Polygon(np.array([(0.0, 0.0, 0.0), tips[i], tips[(i + 1) % 3]]), "metal") for i in range(3)])


def dihedral(face: float, opening_deg: float, lower: float, upper: float) -> Surface:
    """Two metal sheets that meet in the z axis and open towards -x, symmetric about it."""
    half = math.radians(0.5 * opening_deg)
    x, y = -face * math.cos(half), face * math.sin(half)
    faces = [
        [(x, y, lower), (0, 0, lower), (0, 0, upper), (x, y, upper)],
        [(0, 0, lower), (x, -y, lower), (x, -y, upper), (0, 0, upper)],
    ]
    return welded([Polygon(np.array(face, dtype=np.float64), "metal") for face in faces])


def car_body() -> Surface:
    """4.4 x 1.8 m of metal, 0.6 to 1.5 m high: above the sensor, so that no upright edge has a point at its height."""
    return box((-2.2, -0.9, 0.6), (2.2, 0.9, 1.5), "metal")


def retaining_wall(side: float, start: float, stop: float, material: str) -> Surface:
    """A wall along x at y = side [m], 3 m high, 0.4 m thick, with ramped ends: no edge is upright."""
    outline = np.array([(start, 0.0), (stop, 0.0), (stop - 6.0, 3.0), (start + 6.0, 3.0)])  # (x, z)
    lying = prism(outline, 0.0, 0.4, material)
    x, z, depth = lying.vertices.T
    outward = math.copysign(1.0, side)
    vertices = np.column_stack([x, side + outward * depth, z])
    faces = lying.faces if outward < 0.0 else tuple(face[::-1] for face in lying.faces)
    return Surface(vertices, faces, lying.materials)


def ground(outline: Sequence[tuple[float, float]], material: str) -> Surface:
    """A sheet at z = 0 with a convex outline (x, y) [m], counter-clockwise from above."""
    return sheet([(x, y, 0.0) for x, y in outline], material)


def street() -> tuple[Placement, ...]:
    """A road in a cutting: walls at y = +-6 m from x = 4 m, a van and a car at the kerb; nothing moves."""
    return (
        Placement("Road", ground(ROAD, "asphalt")),
        Placement("Wall_left", retaining_wall(6.0, 4.0, 66.0, "concrete")),
        Placement("Wall_right", retaining_wall(-6.0, 4.0, 66.0, "concrete")),
        Placement("Van", box((7.0, -4.8, 0.6), (12.0, -2.8, 2.4), "metal")),
        Placement("Car", car_body(), (26.0, 4.0, 0.0)),
    )


def scenes() -> tuple[EffectScene, ...]:
    """All effect scenes, in the order of ``tests/effect_scenes/expected.json``."""
    ahead: Vector = (60.0, 0.0, SENSOR[2])
    trihedral = Placement("Trihedral", corner_reflector(0.2), ahead, rcs_dbsm=26.51)
    return (
        EffectScene(
            "wall", "A concrete wall 40 m wide and 10 m high, square to the radar at 60 m.",
            (Placement("Wall", box((60.0, -19.0, -4.5), (60.3, 21.0, 5.5), "concrete")),),
        ),
        EffectScene(
            "plate", "A metal plate of 0.2 x 0.2 m, square to the radar at 50 m: smaller than a Fresnel zone.",
            (Placement("Plate", upright(0.2, 0.4, 0.6, "metal"), (50.0, 0.02, 0.0)),),
        ),
        EffectScene(
            "dihedral", "Two metal walls of 14 m that meet at 85 deg, 60 m away; seen only by bounces on both.",
            (Placement("Corner", dihedral(14.0, 85.0, -3.5, 4.5), (60.0, 0.0, 0.0)),),
        ),
        EffectScene(
            "square_corner", "Two metal walls of 0.1 m that meet at a right angle, 60 m away.",
            (Placement("Corner", dihedral(0.1, 90.0, 0.44, 0.56), CORNER_AT),), LEVEL,
        ),
        EffectScene(
            "three_faces", "A trihedral of 0.1 m, as a mesh of three metal triangles at 60 m.",
            (Placement("Trihedral", corner_reflector(0.1), (*CORNER_AT[:2], SENSOR[2])),), LEVEL,
        ),
        EffectScene(
            "trihedral", "A trihedral of 0.2 m, as a point target at 60 m.", (trihedral,),
        ),
        EffectScene(
            "reflector_behind_pane", "A large metal wall at 80 m behind a front of glass at 75 m turned by 30 deg.",
            (
                Placement("Pane", upright(16.0, -5.0, 6.0, "glass"), (75.0, 0.8, 0.0), yaw_deg=30.0),
                Placement("Reflector", box((80.0, -5.0, -4.5), (80.2, 7.0, 5.5), "metal")),
            ),
        ),
        EffectScene(
            "target_behind_pane", "A trihedral at 60 m behind a pane of acrylic at 50 m turned by 30 deg.",
            (Placement("Pane", upright(10.0, -3.5, 4.5, "acrylic"), (50.0, 0.4, 0.0), yaw_deg=30.0), trihedral),
        ),
        EffectScene(
            "corner", "A point target at 60 m in the shadow of a concrete wedge, 0.14 m behind its edge at 30 m.",
            (
                Placement("Wedge", prism([(30.0, 0.0), (34.0, 0.6), (31.5, 2.0)], -0.5, 1.5, "concrete")),
                Placement("Hidden", None, (60.0, 0.27, SENSOR[2]), rcs_dbsm=24.7),
            ),
        ),
        EffectScene(
            "parked_car", "A car body at 50 m, turned by 30 deg so that no face looks at the radar.",
            (Placement("Car", car_body(), (50.0, 0.0, 0.0), yaw_deg=30.0),),
        ),
        EffectScene(
            "moving_car", "A car as a point target, 14.6 dBsm from behind, driving away at 11 m/s from 36 m.",
            (Placement("Car", box((0.0, -0.9, -0.3), (4.4, 0.9, 0.9), "metal"), (36.0, 0.0, SENSOR[2]),
                   velocity=(11.0, 0.0, 0.0), rcs_dbsm=14.6),),
            standing((0.0, 0.2, 0.4)),
        ),
        EffectScene(
            "creeping_target", "A pedestrian as a point target at 60 m, approaching at 0.1 m/s: Doppler alone.",
            (Placement("Pedestrian", None, ahead, velocity=(-0.1, 0.0, 0.0), rcs_dbsm=-1.4),),
            standing((0.0, 0.2, 0.4)),
        ),
        EffectScene(
            "moving_ego", "A street in which nothing moves, seen from a car at 11 m/s.", street(), DRIVING,
        ),
        EffectScene(
            "target_1m", "A metal sphere of 2 cm radius as a point target, 1 to 2 m ahead.",
            (Placement("Sphere", None, (1.0, 0.0, SENSOR[2]), rcs_dbsm=-29.0),),
        ),
        EffectScene(
            "target_80m", "A pedestrian as a point target at 80 m.",
            (Placement("Pedestrian", None, (80.0, 0.0, SENSOR[2]), rcs_dbsm=-1.4),),
        ),
        EffectScene(
            "empty_field", "Grass from 1 m ahead of the sensor, and nothing on it.",
            (Placement("Field", ground(FIELD, "vegetation")),),
        ),
    )  # fmt: skip


def write_stage(path: Path, scene: EffectScene) -> None:
    """Write a scene as .usda; materials are named by ``radar:material``."""
    stage = Usd.Stage.CreateInMemory()
    stage.GetRootLayer().documentation = scene.shows
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, UsdGeom.LinearUnits.meters)
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/World").GetPrim())
    for piece in scene.pieces:
        xform = UsdGeom.Xform.Define(stage, f"/World/{piece.path}")
        if any(piece.position):
            xform.AddTranslateOp().Set(Gf.Vec3d(*piece.position))
        if piece.yaw_deg:
            xform.AddRotateZOp().Set(piece.yaw_deg)
        prim = xform.GetPrim()
        if any(piece.velocity):
            prim.CreateAttribute("radar:velocity", Sdf.ValueTypeNames.Double3).Set(Gf.Vec3d(*piece.velocity))
        if piece.rcs_dbsm is not None:
            prim.CreateAttribute("radar:rcs_dbsm", Sdf.ValueTypeNames.Double).Set(piece.rcs_dbsm)
        if piece.surface is not None:
            prim.CreateAttribute("radar:material", Sdf.ValueTypeNames.Token).Set(piece.surface.materials[0])
            mesh = UsdGeom.Mesh.Define(stage, f"/World/{piece.path}/Geometry")
            mesh.CreatePointsAttr(piece.surface.vertices.astype(np.float32))
            mesh.CreateFaceVertexCountsAttr([len(face) for face in piece.surface.faces])
            mesh.CreateFaceVertexIndicesAttr([vertex for face in piece.surface.faces for vertex in face])
            mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    stage.GetRootLayer().Export(str(path))


def write_effects(folder: Path) -> None:
    """Write all scenes and their poses into an existing folder."""
    for scene in scenes():
        write_stage(folder / f"{scene.name}.usda", scene)
        entries = ",\n".join(f"    {json.dumps(pose)}" for pose in scene.poses)
        (folder / f"{scene.name}.poses.json").write_text(f"[\n{entries}\n]\n", encoding="utf-8")


if __name__ == "__main__":
    write_effects(Path(__file__).resolve().parent / "effects")
