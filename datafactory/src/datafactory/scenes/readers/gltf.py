"""What trimesh reads wrongly of a glTF file is refused; what it ignores is noted."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from datafactory.scenes.readers.common import MAXIMUM_TRIANGLES, Notes
from shared.physics.errors import InputError

# Extensions that change vertex positions and that trimesh does not decode.
GEOMETRY_EXTENSIONS = (
    "KHR_draco_mesh_compression",
    "EXT_meshopt_compression",
    "KHR_meshopt_compression",
    "KHR_mesh_quantization",
    "EXT_mesh_gpu_instancing",
)
TRIANGLES = 4
DROPPED = {2: "line loops", 3: "line strips", 6: "triangle fans"}
"""The modes of primitives that trimesh leaves out without a word (glTF 2.0, section 5.24.4)."""


def check_gltf(path: Path, notes: Notes) -> None:
    """Refuse or note what trimesh does not read.

    :raises InputError: a file that is not intact, compressed or sparse geometry, more elements than a scene may hold
    """
    try:
        header = _header(path)
        required = set(header.get("extensionsRequired", ()))
        animations, skins = len(header.get("animations", ())), len(header.get("skins", ()))
        accessors, meshes, nodes = (header.get(key, []) for key in ("accessors", "meshes", "nodes"))
        largest = max((int(accessor.get("count", 0)) for accessor in accessors), default=0)
        primitives = [primitive for mesh in meshes for primitive in mesh["primitives"]]
        modes = [primitive.get("mode", TRIANGLES) for primitive in primitives]
        used = [primitive.get("indices") for primitive in primitives]
        used += [primitive["attributes"].get("POSITION") for primitive in primitives]
        sparse = [number for number in used if number is not None and "sparse" in accessors[number]]
        # Deformed are a mesh of weights other than zero, and a node that gives it such.
        deformed = sum(any(item.get("weights", ())) for item in (*meshes, *nodes))
    except (OSError, ValueError, AttributeError, TypeError, LookupError, OverflowError, RecursionError) as error:
        raise InputError(path, f"not a readable glTF file ({error})", "an intact .glb or .gltf file") from error
    unread = sorted(required.intersection(GEOMETRY_EXTENSIONS))
    if unread:
        raise InputError(path, f"uses the glTF extension {unread[0]}", "a file exported without it")
    if largest > 3 * MAXIMUM_TRIANGLES:  # an accessor without a buffer has as many zeros
        raise InputError(path, f"an accessor of {largest} elements", f"at most {3 * MAXIMUM_TRIANGLES}")
    if sparse:
        raise InputError(path, f"accessor {sparse[0]} of a mesh is sparse", "a file exported without sparse accessors")
    notes.count("# glTF animations ignored: every object stands still", animations)
    notes.count("# glTF skins ignored: meshes taken in their rest pose", skins)
    notes.count("# glTF morph weights ignored: meshes taken without their morph targets", deformed)
    for mode, kind in DROPPED.items():
        notes.count(f"# glTF {kind} ignored", modes.count(mode))


def _header(path: Path) -> dict[str, Any]:
    data = path.read_bytes()
    # A .glb is a 12-byte header, then chunks of (length, type, data), the JSON first (glTF 2.0, section 4.4).
    if data[:4] == b"glTF":
        data = data[20 : 20 + int.from_bytes(data[12:16], "little")]
    header: dict[str, Any] = json.loads(data)
    return header
