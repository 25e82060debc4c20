"""PLY files whose faces have more than three corners.

trimesh fans every polygon, and refuses a binary file whose faces have different numbers of corners, for it takes the
first face's number for all. Triangles and convex polygons stay as it reads them.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
import trimesh
from numpy.typing import NDArray

from datafactory.scenes.readers.common import Notes
from datafactory.scenes.readers.polygons import find_concave, triangulate

CORNERS = ("vertex_index", "vertex_indices")  # what programs call the list of a face's corners
TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4",
    "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4", "float32": "f4",
    "double": "f8", "float64": "f8",
}  # fmt: skip


class Polygons(NamedTuple):
    """A polygon mesh as :func:`triangulate` takes it: points [V, 3] in the file's precision, counts [F], indices."""

    points: NDArray[np.floating]
    counts: NDArray[np.integer]
    indices: NDArray[np.integer]


class Property(NamedTuple):
    """A number of each row of an element, or a list of numbers.

    :param length: numpy's name for the type of a list's length; "" for one number
    :param kind: numpy's name for the type of the numbers
    """

    name: str
    length: str
    kind: str


def load_ply(path: Path, notes: Notes) -> trimesh.Scene:
    """What trimesh makes of a PLY file; where that is wrong, or nothing, a mesh of triangles cut here."""
    try:
        scene = trimesh.load_scene(path, process=False)
        polygons = _polygons_of(scene)
        if polygons is None or not find_concave(*polygons).any():
            return scene
    except ValueError:  # faces of different sizes, or a file that is not intact
        read = _read_binary(path)
        if read is None:
            raise
        polygons = read
    triangles, _ = triangulate(*polygons, notes)
    precision = {"vertex": {"properties": {"x": polygons.points.dtype.str}}}  # as trimesh says it
    mesh = trimesh.Trimesh(polygons.points, triangles, process=False, metadata={"_ply_raw": precision})
    return trimesh.Scene({path.name: mesh})


def _polygons_of(scene: trimesh.Scene) -> Polygons | None:
    """The polygons that trimesh made triangles of; None where all faces are triangles, or there are none.

    :raises ValueError: a binary file with faces of different sizes that is by chance as long as trimesh expects
    """
    raw = next((part.metadata["_ply_raw"] for part in scene.geometry.values() if hasattr(part, "faces")), None)
    if raw is None:
        return None
    data = raw["face"]["data"]
    binary = isinstance(data, np.ndarray)
    fields = data.dtype.names if binary else tuple(data)
    faces = data[next((field for field in fields if field in CORNERS), fields[0])]
    if binary:  # lengths and entries
        if (faces["f0"] != faces["f1"].shape[1]).any():
            raise ValueError("faces of different sizes")
        faces = faces["f1"]
    if faces.ndim == 2 and faces.shape[1] == 3:
        return None
    points = np.column_stack([raw["vertex"]["data"][axis] for axis in "xyz"])
    return Polygons(points, np.array([len(face) for face in faces]), np.concatenate(list(faces)))


def _read_binary(path: Path) -> Polygons | None:
    """The mesh of a binary file, row by row; None for text.

    :raises ValueError: a file that is not intact
    """
    data = path.read_bytes()
    header, _, _ = data.partition(b"end_header")
    if b"format binary" not in header:
        return None
    place = data.index(b"\n", len(header)) + 1
    points = np.empty((0, 3))
    faces: list[NDArray[np.integer]] = []
    for element, count, properties in _elements(header.decode()):
        if not any(item.length for item in properties):
            rows = np.frombuffer(data, np.dtype([(item.name, item.kind) for item in properties]), count, place)
            place += rows.nbytes
            if element == "vertex":
                points = np.column_stack([rows[axis] for axis in "xyz"])
            continue
        for _ in range(count):
            for item in properties:
                length = 1
                if item.length:
                    length = int(np.frombuffer(data, item.length, 1, place)[0])
                    place += np.dtype(item.length).itemsize
                if length < 0:  # numpy would read to the end
                    raise ValueError("a list of negative length")
                values = np.frombuffer(data, item.kind, length, place)
                place += values.nbytes
                if element == "face" and item.name in CORNERS:
                    faces.append(values)
    if place != len(data) or not faces:
        raise ValueError(f"{len(data)} bytes, of which the header states {place}, {len(faces)} faces")
    return Polygons(points, np.array([len(face) for face in faces]), np.concatenate(faces))


def _elements(header: str) -> list[tuple[str, int, list[Property]]]:
    """Name, number of rows and properties of each element that a header states."""
    order = ">" if "binary_big_endian" in header else "<"
    elements: list[tuple[str, int, list[Property]]] = []
    for line in header.splitlines():
        match line.split():
            case ["element", name, count]:
                elements.append((name, int(count), []))
            case ["property", "list", length, kind, name]:
                elements[-1][2].append(Property(name, order + TYPES[length], order + TYPES[kind]))
            case ["property", kind, name]:
                elements[-1][2].append(Property(name, "", order + TYPES[kind]))
    return elements
