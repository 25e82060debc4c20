"""Mitsuba 3 scenes, as Sionna uses them: triangle meshes and the names of their materials.

The reader creates no Mitsuba object, so that it needs no plugin: of a BSDF it reads only the id. It skips cameras,
lights and integrators. A Mitsuba file states no unit. Sionna's scenes are in metres with z up, and every file is read
so.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from datafactory.scenes.readers import primitives
from datafactory.scenes.readers.limits import check_counts
from datafactory.scenes.readers.local_mesh import LocalMesh
from datafactory.scenes.readers.mesh_files import load_mesh
from datafactory.scenes.readers.mitsuba_xml import Shape, read_shapes
from datafactory.scenes.readers.notes import Notes
from datafactory.scenes.readers.scale import note_coarse_vertices, size_remark
from datafactory.scenes.scene import Scene, SceneObject
from shared.physics.errors import InputError

ORIGIN = (0.0, 0.0, 0.0)


def read_mitsuba(path: str | Path, name: str | None = None) -> Scene:
    """Read a Mitsuba XML file.

    :param path: the file; mesh files in it are relative to its folder
    :param name: the scene's name, by default the file's
    :raises InputError: malformed XML, an unresolved reference, a value that is no number, a missing or unreadable mesh
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(path, "no such file", "an existing Mitsuba XML file")
    notes = Notes()
    objects: list[SceneObject] = []
    spacings: list[float] = []
    for shape, mesh in _meshes(path, read_shapes(path)):
        if mesh is None:
            notes.count(f"# shapes of type {shape.kind!r} ignored")
            continue
        spacings.append(mesh.spacing_m(shape.to_world))
        vertices, triangles, dropped = mesh.placed(shape.to_world)
        dropped.add_to(notes)
        if len(triangles):
            objects.append(SceneObject.of(shape.name, vertices, triangles, shape.material))
        else:
            notes.count("# shapes without a usable triangle ignored")
    note_coarse_vertices(spacings, notes)
    scene = Scene(name or path.stem, tuple(objects), source=str(path))
    if remark := size_remark(scene, "its units, which are taken as metres"):
        notes.say(remark)
    return replace(scene, warnings=notes.sentences())


def _meshes(path: Path, shapes: Sequence[Shape]) -> Iterator[tuple[Shape, LocalMesh | None]]:
    """Every shape with its mesh, None for a plugin that is not supported; shapes of one file share their mesh.

    :raises InputError: more objects or triangles than a scene may hold, before any is placed
    """
    uses = Counter(_shared_by(shape) for shape in shapes)
    known: dict[tuple[str, ...], LocalMesh | None] = {}
    triangles: dict[str, int] = {}  # of one shape of each kind that is not shared
    total = 0
    for shape in shapes:
        key = _shared_by(shape)
        if key and key not in known:
            known[key] = _local_mesh(shape, shared=uses[key] > 1)
        elif not key and shape.kind not in triangles:
            mesh = _local_mesh(shape, shared=False)
            triangles[shape.kind] = 0 if mesh is None else len(mesh.triangles)
        mesh = known[key] if key else None
        total += triangles[shape.kind] if not key else 0 if mesh is None else len(mesh.triangles)
    check_counts(path, "the scene", len(shapes), total)
    for shape in shapes:
        key = _shared_by(shape)
        yield shape, known[key] if key else _local_mesh(shape, shared=False)


def _shared_by(shape: Shape) -> tuple[str, ...]:
    """What a shape's local mesh depends on; empty where it has parameters of its own."""
    if shape.kind in ("sphere", "cylinder"):
        return ()
    file = (shape.text("filename"),) if shape.kind in ("ply", "obj") else ()
    return shape.kind, *file, "flipped" if shape.flag("flip_normals") else ""


def _local_mesh(shape: Shape, shared: bool) -> LocalMesh | None:
    """The mesh before to_world; None for a plugin that is not supported."""
    mesh = _points_and_triangles(shape)
    if mesh is None:
        return None
    points, triangles = mesh
    return LocalMesh(points, triangles[:, ::-1] if shape.flag("flip_normals") else triangles, shared)


def _points_and_triangles(shape: Shape) -> tuple[NDArray[np.floating], NDArray[np.int64]] | None:
    """Vertices, in the file's precision, and triangles before to_world; None for a plugin that is not supported.

    Defaults are Mitsuba's.
    """
    if shape.kind in ("ply", "obj"):
        return load_mesh(shape.path.parent / shape.text("filename"), f"{shape.path}, shape {shape.name!r}")
    if shape.kind == "rectangle":
        return primitives.rectangle(2.0, 2.0)
    if shape.kind == "cube":
        return primitives.box(2.0)
    if shape.kind == "disk":
        return primitives.disk(1.0)
    if shape.kind == "sphere":
        vertices, triangles = primitives.sphere(shape.number("radius", 1.0))
        return vertices + shape.point("center", ORIGIN), triangles
    if shape.kind == "cylinder":
        return _tube(shape)
    return None


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
