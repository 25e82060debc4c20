"""glTF files in the form that trimesh reads right; what it reads wrongly in any form is refused, what it ignores noted.

trimesh names the nodes of a mesh's primitives at random where there are several, so that each reading of such a file
would have another hash. It leaves out the node of the first camera, without which what is below it has no place. It
takes a URI for a file's name as it is written.
"""

from __future__ import annotations

import json
from io import BytesIO
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import trimesh

from datafactory.scenes.readers.common import MAXIMUM_TRIANGLES, Notes
from shared.physics.errors import InputError

INSTANCING = "EXT_mesh_gpu_instancing"
# Extensions that change vertex positions and that trimesh does not decode.
GEOMETRY_EXTENSIONS = (
    "KHR_draco_mesh_compression",
    "EXT_meshopt_compression",
    "KHR_meshopt_compression",
    "KHR_mesh_quantization",
    INSTANCING,
)
TRIANGLES = 4
DROPPED = {2: "line loops", 3: "line strips", 6: "triangle fans"}
"""The modes of primitives that trimesh leaves out without a word (glTF 2.0, section 5.24.4)."""


def check_gltf(path: Path, notes: Notes) -> None:
    """Refuse or note what trimesh does not read.

    :raises InputError: a file that is not intact, compressed or sparse geometry, more elements than a scene may hold
    """
    try:
        header = _header(path.read_bytes())
        required = set(header.get("extensionsRequired", ()))
        if any(INSTANCING in node.get("extensions", ()) for node in header.get("nodes", ())):
            required.add(INSTANCING)  # a file need not say so, and a reader without it sees one of all
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


def load_gltf(path: Path, notes: Notes) -> trimesh.Scene:
    """What trimesh makes of a glTF file that :func:`check_gltf` has passed."""
    data = path.read_bytes()
    header = _header(data)
    for node in header.get("nodes", ()):
        node.pop("camera", None)
        if not node.get("extensions", {}).get("KHR_node_visibility", {}).get("visible", True):
            notes.count("# invisible glTF nodes skipped, with everything below them")
            node.clear()
    for item in (*header.get("buffers", ()), *header.get("images", ())):
        if "uri" in item:
            item["uri"] = unquote(item["uri"])
    _part_primitives(header)
    written = json.dumps(header).encode()
    binary = data[:4] == b"glTF"
    if binary:
        written += b" " * (-len(written) % 4)
        rest = data[20 + int.from_bytes(data[12:16], "little") :]
        start = (20 + len(written) + len(rest)).to_bytes(4, "little") + len(written).to_bytes(4, "little")
        written = data[:8] + start + b"JSON" + written + rest
    resolver = trimesh.resolvers.FilePathResolver(str(path), allow_anywhere=True)  # as ../buffers/m.bin
    return trimesh.load_scene(BytesIO(written), file_type="glb" if binary else "gltf", resolver=resolver, process=False)


def _part_primitives(header: dict[str, Any]) -> None:
    """Make each primitive the only one of a mesh: the first stays, the others become meshes of nodes below."""
    meshes, nodes = header.get("meshes", []), header.get("nodes", [])
    others: list[range] = []  # of each mesh, the meshes that its other primitives become
    for mesh in list(meshes):
        first, more = mesh["primitives"][:1], mesh["primitives"][1:]
        others.append(range(len(meshes), len(meshes) + len(more)))
        meshes += [{**mesh, "primitives": [primitive]} for primitive in more]
        mesh["primitives"] = first
    for number, node in enumerate(list(nodes)):
        below = others[node["mesh"]] if "mesh" in node else ()
        if below:
            node["children"] = [*node.get("children", ()), *range(len(nodes), len(nodes) + len(below))]
            name = node.get("name", number)
            nodes += [{"name": f"{name}_{place}", "mesh": mesh} for place, mesh in enumerate(below, start=1)]


def _header(data: bytes) -> dict[str, Any]:
    # A .glb is a 12-byte header, then chunks of (length, type, data), the JSON first (glTF 2.0, section 4.4).
    if data[:4] == b"glTF":
        data = data[20 : 20 + int.from_bytes(data[12:16], "little")]
    header: dict[str, Any] = json.loads(data)
    return header
