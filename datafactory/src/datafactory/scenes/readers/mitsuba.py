"""Mitsuba 3 scenes, as Sionna uses them: triangle meshes and the names of their materials.

The reader creates no Mitsuba object, so that it needs no plugin: of a BSDF it reads only the id. It skips cameras,
lights and integrators. A Mitsuba file states no unit. Sionna's scenes are in metres with z up, and every file is read
so.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from datafactory.scenes.readers import primitives
from datafactory.scenes.readers.common import Notes, check_counts, with_remarks
from datafactory.scenes.readers.mesh_files import load_mesh
from datafactory.scenes.readers.meshes import note_coarse_vertices, place_mesh, vertex_spacing_m
from datafactory.scenes.readers.mitsuba_xml import Shape, read_shapes
from datafactory.scenes.scene import Scene, SceneObject

ORIGIN = (0.0, 0.0, 0.0)

Mesh = tuple[NDArray[np.floating], NDArray[np.int64]]


def read_mitsuba(path: str | Path, name: str | None = None) -> Scene:
    """Read a Mitsuba XML file.

    :param path: the file; mesh files in it are relative to its folder
    :param name: the scene's name, by default the file's
    :raises InputError: malformed XML, an unresolved reference, a value that is no number, a missing or unreadable
        mesh, more objects or triangles than a scene may hold
    """
    path = Path(path)
    notes = Notes()
    objects: list[SceneObject] = []
    spacings: list[float] = []
    total = 0
    known: dict[tuple[str, str], Mesh] = {}
    for shape in read_shapes(path):
        mesh = _mesh(shape, known)
        if mesh is None:
            notes.count(f"# shapes of type {shape.kind!r} ignored")
            continue
        points, triangles = mesh
        triangles = triangles[:, ::-1] if shape.flag("flip_normals") else triangles
        spacings.append(vertex_spacing_m(points, shape.to_world))
        vertices, kept, _ = place_mesh(points, triangles, shape.to_world, notes)
        if len(kept):
            objects.append(SceneObject(shape.name, vertices, kept, shape.material))
            total += len(kept)
            check_counts(path, f"the scene as far as shape {shape.name!r}", len(objects), total)
        else:
            notes.count("# shapes without a usable triangle ignored")
    note_coarse_vertices(spacings, notes)
    scene = Scene(name or path.stem, tuple(objects), source=str(path))
    return with_remarks(scene, notes, "its units, which are taken as metres")


def _mesh(shape: Shape, known: dict[tuple[str, str], Mesh]) -> Mesh | None:
    """Vertices, in the file's precision, and triangles before to_world; None for a plugin that is not supported.

    Defaults are Mitsuba's.

    :param known: takes meshes that do not depend on the shape's numbers, by plugin and file
    """
    if shape.kind == "sphere":
        vertices, triangles = primitives.sphere(shape.number("radius", 1.0))
        return vertices + shape.point("center", ORIGIN), triangles
    if shape.kind == "cylinder":
        return _tube(shape)
    file = shape.text("filename") if shape.kind in ("ply", "obj") else ""
    if (shape.kind, file) not in known:
        if file:
            mesh = load_mesh(shape.path.parent / file, f"{shape.path}, shape {shape.name!r}")
        elif shape.kind == "rectangle":
            mesh = primitives.rectangle(2.0, 2.0)
        elif shape.kind == "cube":
            mesh = primitives.box(2.0)
        elif shape.kind == "disk":
            mesh = primitives.disk(1.0)
        else:
            return None
        known[shape.kind, file] = mesh
    return known[shape.kind, file]


def _tube(shape: Shape) -> primitives.Mesh:
    """Mitsuba's cylinder: an open tube from p0 to p1."""
    p0, p1 = shape.point("p0", ORIGIN), shape.point("p1", (0.0, 0.0, 1.0))
    length = float(np.linalg.norm(p1 - p0))
    if not length > 0:
        raise shape.error(f"p0 = p1 = {p0.tolist()}", "two different points")
    radius = shape.number("radius", 1.0)
    vertices, triangles = primitives.cylinder(radius, radius, length, closed=False)
    axis = (p1 - p0) / length
    side = np.cross(np.eye(3)[np.argmin(np.abs(axis))], axis)
    side /= np.linalg.norm(side)
    frame = np.column_stack([side, np.cross(axis, side), axis])
    return vertices @ frame.T + (p0 + p1) / 2, triangles
