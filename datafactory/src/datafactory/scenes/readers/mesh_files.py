"""The mesh files that trimesh reads (.glb .gltf .obj .ply .stl).

glTF is in metres with y up (glTF 2.0, section 3.4) and is turned to z up. OBJ, PLY and STL say neither unit nor up
axis: they are taken as metres and z up, and the scene's warnings say so.
"""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

from datafactory.scenes.readers.common import Y_UP_TO_Z_UP, Notes, check_counts, scene_at_rest
from datafactory.scenes.readers.gltf import check_gltf, load_gltf
from datafactory.scenes.readers.obj import load_obj
from datafactory.scenes.readers.ply import load_ply
from datafactory.scenes.scene import Scene
from shared.physics.errors import InputError

logging.getLogger("trimesh").setLevel(logging.CRITICAL)  # it would print remarks about textures


def load_mesh(path: Path, source: object, notes: Notes) -> tuple[NDArray[np.floating], NDArray[np.int64]]:
    """The one mesh of a PLY or OBJ file that another scene file refers to, its vertices not merged.

    :param source: what an error is to name, e.g. the scene file and the shape
    :return: vertices [V, 3] in the file's precision and triangles [T, 3]; both empty for a file of points alone
    :raises InputError: the file is absent or cannot be read
    """
    parts = [
        (_in_file_precision(part, path), part.faces)  # neither format places its meshes
        for _, _, part in _placed_geometries(path, source, notes)
        if isinstance(part, trimesh.Trimesh)
    ]
    if not parts:
        return np.empty((0, 3)), np.empty((0, 3), dtype=np.int64)
    offsets = np.cumsum([0] + [len(vertices) for vertices, _ in parts[:-1]])
    return (
        np.concatenate([vertices for vertices, _ in parts]),
        np.concatenate([faces + offset for (_, faces), offset in zip(parts, offsets, strict=True)]),
    )


def read_mesh_file(path: Path) -> Scene:
    """Read a mesh file as a scene: one object for each mesh and material.

    :param path: a .glb, .gltf, .obj, .ply or .stl file
    :raises InputError: unreadable, compressed beyond what trimesh reads, or without any triangle
    """
    notes = Notes()
    suffix = path.suffix.lower()
    to_world = np.eye(4)
    if suffix in (".glb", ".gltf"):
        to_world[:3, :3] = Y_UP_TO_Z_UP
        check_gltf(path, notes)
    parts = _placed_geometries(path, path, notes)
    meshes = [(name, matrix, part) for name, matrix, part in parts if isinstance(part, trimesh.Trimesh)]
    for _, _, part in parts:
        if not isinstance(part, trimesh.Trimesh):
            notes.count(f"# geometries of type {type(part).__name__} ignored (only triangle meshes are used)")
    check_counts(path, "the scene", len(meshes), sum(len(part.faces) for _, _, part in meshes))
    if meshes and suffix not in (".glb", ".gltf"):
        notes.say(f"{suffix} files state no units and no up axis: taken as metres, z up")
    points = {id(part): _in_file_precision(part, path) for _, _, part in meshes}  # one mesh may be in several places
    plain = (
        (_text(name), _material(part), points[id(part)], part.faces, to_world @ in_file)
        for name, in_file, part in meshes
    )
    return scene_at_rest(path, path.stem, "mesh", plain, notes)


def _material(part: trimesh.Trimesh) -> str:
    return _text(str(getattr(getattr(part.visual, "material", None), "name", None) or ""))


def _placed_geometries(
    path: Path, source: object, notes: Notes
) -> list[tuple[str, NDArray[np.float64], trimesh.parent.Geometry]]:
    """Every node with geometry: its name (unique), its [4, 4] matrix in column convention, the geometry.

    :param source: what an error is to name
    """
    if not path.is_file():
        raise InputError(source, f"mesh file {str(path)!r} does not exist", "an existing file")
    parts = []
    try:
        own = {".obj": load_obj, ".ply": load_ply, ".glb": load_gltf, ".gltf": load_gltf}.get(path.suffix.lower())
        scene = trimesh.load_scene(path, process=False) if own is None else own(path, notes)
        for node in scene.graph.nodes_geometry:
            matrix, geometry = scene.graph[node]
            placement = np.asarray(matrix, dtype=np.float64).reshape(4, 4)
            parts.append((str(node), placement, scene.geometry[geometry]))
    except Exception as error:  # trimesh's loaders raise many types, from KeyError to struct.error
        # trimesh reads an unknown STL as text and guesses its encoding with a library that is not installed.
        reason = "unknown content" if isinstance(error, ImportError) else f"{type(error).__name__}: {error}"
        raise InputError(
            source, f"mesh file {str(path)!r} cannot be read ({_text(reason)})", "an intact file"
        ) from error
    return parts


def _in_file_precision(mesh: trimesh.Trimesh, path: Path) -> NDArray[np.floating]:
    """[V, 3] vertices in the precision of the file; trimesh makes float64 of everything.

    glTF and STL hold float32 alone, PLY says what it holds, OBJ is text.

    :raises InputError: vertices of another number of coordinates than three, which trimesh lets through
    """
    if mesh.vertices.shape[1:] != (3,):
        raise InputError(path, f"a mesh has vertices of shape {list(mesh.vertices.shape)}", "x, y and z for each")
    properties = mesh.metadata.get("_ply_raw", {}).get("vertex", {}).get("properties", {})
    if path.suffix.lower() not in (".glb", ".gltf", ".stl") and not str(properties.get("x", "")).endswith("f4"):
        return mesh.vertices
    single = mesh.vertices.astype(np.float32)
    return single if np.array_equal(single, mesh.vertices, equal_nan=True) else mesh.vertices


def _text(name: str) -> str:
    """The name with lone surrogates, which JSON may hold and UTF-8 may not, written as escapes."""
    return name.encode("utf-8", "backslashreplace").decode("utf-8")
