"""The page: the scene in three dimensions, in one file that a browser opens from disk and that loads nothing.

trimesh's viewer holds three.js itself and the meshes as GLB; ``overlay.html`` beside this module adds what is no mesh:
paths, sensor, field of view, motion, point targets, and the legend. Everything stands in the radar frame of the pose,
so that coordinates stay small wherever the scene lies in its world.
"""

from __future__ import annotations

import json
import math
from importlib.resources import files
from typing import Any

import numpy as np
import trimesh
from numpy.typing import ArrayLike
from trimesh.viewer.notebook import scene_to_html
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial

from datafactory.view.strongest import Shown, ShownPath, shown_paths
from datafactory.view.subject import KINDS, MOTION, SENSOR, TARGET, Subject, css, material_colour

DECIMALS = 3
"""Of the places in the page [m]."""
END_OF_BODY = "</body>"


def view_page(subject: Subject) -> str:
    """The page's HTML."""
    shown = None
    if subject.table is not None:
        shown = shown_paths(subject.table, subject.caster, subject.targets())
    # No name of a scene can end the script: "<" is written as its escape.
    data = json.dumps(page_data(subject, shown)).replace("<", "\\u003c")
    overlay = files("datafactory.view").joinpath("overlay.html").read_text(encoding="utf-8").replace("$DATA", data)
    before, end, after = scene_to_html(meshes_of(subject)).rpartition(END_OF_BODY)
    if not end:
        raise ValueError(f"trimesh {trimesh.__version__}: its viewer has no {END_OF_BODY}")
    return before + overlay + end + after


def meshes_of(subject: Subject) -> trimesh.Scene:
    """The meshes, one for each material and velocity, named ``mesh-N`` as :attr:`MergedScene.meshes` has them."""
    scene = trimesh.Scene()
    for index, mesh in enumerate(subject.scene.merged.meshes):
        colour = [channel / 255.0 for channel in material_colour(mesh.material)]
        material = PBRMaterial(
            name=mesh.material,
            baseColorFactor=[*colour, 1.0],
            metallicFactor=0.0,
            roughnessFactor=1.0,
            doubleSided=True,
        )
        solid = trimesh.Trimesh(subject.vertices(index), mesh.triangles, process=False, validate=False)
        solid.visual = TextureVisuals(material=material)
        scene.add_geometry(solid, node_name=f"mesh-{index}", geom_name=f"mesh-{index}")
    if not scene.geometry:  # the viewer needs something to look at
        scene.add_geometry(trimesh.creation.icosphere(radius=0.1), node_name="sensor", geom_name="sensor")
    scene.set_camera()
    return scene


def page_data(subject: Subject, shown: Shown | None) -> dict[str, Any]:
    """What the page shows beside the meshes, as JSON values; places in the radar frame [m]."""
    merged, pose = subject.merged, subject.pose
    by_material: dict[str, list[str]] = {}
    for index, mesh in enumerate(merged.meshes):
        by_material.setdefault(mesh.material, []).append(f"mesh-{index}")
    return {
        "title": subject.title,
        "pose": f"sensor at ({', '.join(f'{value:.1f}' for value in pose.position)}) m, yaw {pose.yaw_deg:.0f} deg, "
        f"{float(np.linalg.norm(pose.velocity)):.1f} m/s; radar {subject.radar.name}",
        "up": (np.array([0.0, 0.0, 1.0]) @ pose.rotation()).tolist(),
        "materials": [
            {"name": name, "colour": css(material_colour(name)), "nodes": nodes} for name, nodes in by_material.items()
        ],
        "kinds": [] if shown is None else _kinds(shown),
        "not_drawn": 0 if shown is None else shown.not_drawn,
        "sensor": css(SENSOR),
        "field": [_rounded(line) for line in subject.field_of_view()],
        "motion": css(MOTION),
        "movers": [
            {"name": name, "at": _rounded(place), "velocity": _rounded(velocity),
             "speed": round(math.hypot(*velocity), 2)}
            for name, place, velocity in subject.movers()
        ],
        "target": css(TARGET),
        "targets": [
            {"name": target.name, "at": _rounded(place), "rcs_dbsm": round(target.rcs_dbsm, 1)}
            for target, place in zip(merged.targets, subject.targets(), strict=True)
        ],
    }  # fmt: skip


def _kinds(shown: Shown) -> list[dict[str, Any]]:
    return [
        {"name": kind, "colour": css(colour), "found": shown.found[kind],
         "paths": [{"points": _rounded(path.points), "text": _said(path)} for path in shown.paths if path.kind == kind]}
        for kind, colour in KINDS.items()
    ]  # fmt: skip


def _said(path: ShownPath) -> str:
    bounces = f"{path.bounces} bounce{'s' if path.bounces != 1 else ''}"
    parts = [path.kind, f"{path.range_m:.2f} m", f"{path.level_db:.1f} dBW", bounces, path.object]
    return ", ".join(filter(None, parts))


def _rounded(places: ArrayLike) -> Any:
    """As JSON values, to a millimetre."""
    return np.round(np.asarray(places, dtype=np.float64), DECIMALS).tolist()
