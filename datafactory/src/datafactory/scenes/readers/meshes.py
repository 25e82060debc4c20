"""Triangle meshes: cleaning, placing, and the files that trimesh reads (.glb .gltf .obj .ply .stl).

glTF is in metres with y up (glTF 2.0, section 3.4) and is turned to z up. OBJ, PLY and STL say neither unit nor up
axis: they are taken as metres and z up, and the scene's warnings say so.
"""

from __future__ import annotations

import json
import logging
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

from datafactory.scenes.readers.notes import Notes
from datafactory.scenes.readers.scale import note_coarse_vertices, size_remark, vertex_spacing_m
from datafactory.scenes.scene import Scene, SceneObject, placed
from shared.physics.errors import InputError
from shared.physics.units import FARTHEST_M

MESH_SUFFIXES = (".glb", ".gltf", ".obj", ".ply", ".stl")
Y_UP_TO_Z_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])  # (x, y, z) -> (x, -z, y)
FLAT = 1e-12  # twice a triangle's area over its longest edge squared: below this float64 cannot tell it from a line
# glTF extensions that change vertex positions and that trimesh does not decode.
GLTF_GEOMETRY_EXTENSIONS = (
    "KHR_draco_mesh_compression",
    "EXT_meshopt_compression",
    "KHR_meshopt_compression",
    "KHR_mesh_quantization",
    "EXT_mesh_gpu_instancing",
)
logging.getLogger("trimesh").setLevel(logging.CRITICAL)  # it would print remarks about textures


@dataclass(frozen=True)
class Dropped:
    """Triangles that a mesh lost in cleaning, by reason."""

    out_of_range: int = 0
    not_finite: int = 0
    beyond: int = 0
    no_area: int = 0

    def add_to(self, notes: Notes) -> None:
        notes.count("# triangles with a vertex index out of range dropped", self.out_of_range)
        notes.count("# triangles with a NaN or infinite vertex dropped", self.not_finite)
        notes.count(f"# triangles with a vertex beyond {FARTHEST_M:g} m dropped", self.beyond)
        notes.count("# triangles without area dropped", self.no_area)


def clean_mesh(
    vertices: NDArray[np.floating], triangles: NDArray[np.integer]
) -> tuple[NDArray[np.float64], NDArray[np.int32], Dropped]:
    """Drop triangles that no ray tracer can use, and vertices that no triangle uses.

    :param vertices: [V, 3]
    :param triangles: [T, 3] vertex indices
    :return: vertices [V', 3] float64, triangles [T', 3] int32 in the order given, and what was dropped
    """
    vertices = np.asarray(vertices, dtype=np.float64).reshape(-1, 3)
    triangles = np.asarray(triangles, dtype=np.int64).reshape(-1, 3)
    inside = np.all((triangles >= 0) & (triangles < len(vertices)), axis=1)
    kept = triangles[inside]
    finite = np.isfinite(vertices[kept]).all(axis=(1, 2))
    kept = kept[finite]
    near = (np.abs(vertices[kept]) <= FARTHEST_M).all(axis=(1, 2))
    kept = kept[near]
    solid = _has_area(vertices[kept])
    kept = kept[solid]
    used, compact = np.unique(kept, return_inverse=True)
    dropped = Dropped(*(int((~mask).sum()) for mask in (inside, finite, near, solid)))
    return vertices[used], compact.reshape(-1, 3).astype(np.int32), dropped


def usable(corners: NDArray[np.float64]) -> NDArray[np.bool_]:
    """[T] whether :func:`clean_mesh` keeps triangles with these corners [T, 3, 3]."""
    with np.errstate(invalid="ignore", over="ignore"):
        solid = _has_area(corners)
    near = np.all(np.abs(corners) <= FARTHEST_M, axis=(1, 2))  # false for NaN
    kept: NDArray[np.bool_] = solid & near
    return kept


def _has_area(corners: NDArray[np.float64]) -> NDArray[np.bool_]:
    edges = np.roll(corners, -1, axis=1) - corners  # [T, 3, 3]
    doubled_area = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    solid: NDArray[np.bool_] = doubled_area > FLAT * np.square(edges).sum(axis=2).max(axis=1, initial=0.0)
    return solid


def place_mesh(
    vertices: NDArray[np.floating], triangles: NDArray[np.integer], matrix: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.integer]]:
    """Apply an affine transform in float64, and keep outer sides outside under a mirror.

    :param vertices: [V, 3]
    :param triangles: [T, 3] vertex indices; counter-clockwise seen from outside
    :param matrix: [4, 4] acting on column vectors; a negative determinant reverses the winding
    """
    with np.errstate(invalid="ignore", over="ignore"):
        mirrored = np.linalg.det(matrix[:3, :3]) < 0
    # NaN, infinite and absurdly far vertices are dropped and counted in ``clean_mesh``.
    return placed(vertices, matrix), triangles[:, ::-1] if mirrored else triangles


def load_mesh(path: Path, source: object) -> tuple[NDArray[np.floating], NDArray[np.int64]]:
    """The one mesh of a PLY or OBJ file that another scene file refers to, its vertices not merged.

    :param source: what an error is to name, e.g. the scene file and the shape
    :return: vertices [V, 3] in the file's precision and triangles [T, 3]; both empty for a file of points alone
    :raises InputError: the file is absent or cannot be read
    """
    loaded = _load(path, source)
    parts = [
        (_in_file_precision(part, path), part.faces)  # neither format places its meshes
        for _, _, part in _placed_geometries(loaded)
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
        _check_gltf(path, notes)
    objects, spacings = [], []
    for name, matrix, part in _placed_geometries(_load(path, path)):
        if not isinstance(part, trimesh.Trimesh):
            notes.count(f"# geometries of type {type(part).__name__} ignored (only triangle meshes are used)")
            continue
        written = _in_file_precision(part, path)
        spacings.append(vertex_spacing_m(written, to_world @ matrix))
        vertices, triangles = place_mesh(written, part.faces, to_world @ matrix)
        vertices, triangles, dropped = clean_mesh(vertices, triangles)
        dropped.add_to(notes)
        if len(triangles):
            objects.append(SceneObject(name, vertices, triangles, _material_name(part)))
        else:
            notes.count("# meshes without a usable triangle ignored")
    if objects and suffix not in (".glb", ".gltf"):
        notes.say(f"{suffix} files state no units and no up axis: taken as metres, z up")
    note_coarse_vertices(spacings, notes)
    scene = Scene(path.stem, tuple(objects), source=str(path))
    if remark := size_remark(scene, "its units, which are taken as metres"):
        notes.say(remark)
    return replace(scene, warnings=notes.sentences())


def _load(path: Path, source: object) -> trimesh.Scene:
    if not path.is_file():
        raise InputError(source, f"mesh file {str(path)!r} does not exist", "an existing file")
    try:
        return trimesh.load_scene(path, process=False, split_object=True, group_material=True)
    except Exception as error:  # trimesh's loaders raise many types, from KeyError to struct.error
        # trimesh reads an unknown STL as text and guesses its encoding with a library that is not installed.
        reason = "unknown content" if isinstance(error, ImportError) else f"{type(error).__name__}: {error}"
        raise InputError(source, f"mesh file {str(path)!r} cannot be read ({reason})", "an intact file") from error


def _placed_geometries(scene: trimesh.Scene) -> list[tuple[str, NDArray[np.float64], trimesh.parent.Geometry]]:
    """Every node with geometry: its name (unique), its [4, 4] matrix in column convention, the geometry."""
    parts = []
    for node in scene.graph.nodes_geometry:
        matrix, geometry = scene.graph[node]
        parts.append((str(node), np.asarray(matrix, dtype=np.float64), scene.geometry[geometry]))
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
    with np.errstate(over="ignore"):  # an STL of text may hold more than float32 does
        single = mesh.vertices.astype(np.float32)
    return single if np.array_equal(single, mesh.vertices, equal_nan=True) else mesh.vertices


def _material_name(mesh: trimesh.Trimesh) -> str:
    material = getattr(mesh.visual, "material", None)
    return str(getattr(material, "name", None) or "")


def _check_gltf(path: Path, notes: Notes) -> None:
    """Refuse extensions that trimesh reads wrongly, and note what it ignores."""
    try:
        data = path.read_bytes()
        # A .glb is a 12-byte header, then chunks of (length, type, data), the JSON first (glTF 2.0, section 4.4).
        if data[:4] == b"glTF":
            data = data[20 : 20 + int.from_bytes(data[12:16], "little")]
        header = json.loads(data)
        required = set(header.get("extensionsRequired", ()))
        animations, skins = len(header.get("animations", ())), len(header.get("skins", ()))
    except (OSError, ValueError, AttributeError, TypeError, RecursionError) as error:
        raise InputError(path, f"not a readable glTF file ({error})", "an intact .glb or .gltf file") from error
    unread = sorted(required.intersection(GLTF_GEOMETRY_EXTENSIONS))
    if unread:
        raise InputError(path, f"uses the glTF extension {unread[0]}", "a file exported without it")
    notes.count("# glTF animations ignored: every object stands still", animations)
    notes.count("# glTF skins ignored: meshes taken in their rest pose", skins)
