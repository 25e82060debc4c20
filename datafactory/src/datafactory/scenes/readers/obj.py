"""OBJ files in the form that trimesh reads right: what it drops, refuses or takes wrongly is written anew.

trimesh fans every polygon, takes indices relative to the end of the file, wants each statement at the start of its
line, and forgets a material that no .mtl file describes. A file without any of this goes to it as it is.
"""

from __future__ import annotations

import re
from io import BytesIO
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

from datafactory.scenes.readers.common import Notes
from datafactory.scenes.readers.polygons import find_concave, triangulate

ODD = tuple(
    re.compile(pattern)
    for pattern in (
        r"\\",  # a continued line
        r"\t",
        r"\n ",  # indented
        r" #",  # a comment behind a statement
        r"\n#[^\n]*usemtl",  # trimesh obeys it
        r"\nf(?! ++[0-9/]++ ++[0-9/]++ ++[0-9/]++ *+\r?\n)",  # not a triangle of indices from the beginning
    )
)
MATERIAL = re.compile(r"\nusemtl +([^\n]*)")
POINTS = ("v", "vt", "vn")  # what a corner's indices refer to, in this order
NAMES = ("usemtl", "o", "g", "s", "mtllib")


def load_obj(path: Path, notes: Notes) -> trimesh.Scene:
    """What trimesh makes of an OBJ file: a mesh for each material, with the name that the file gives to it."""
    text = readable(trimesh.util.decode_text(path.read_bytes()), notes)
    materials = _Materials(path, {name.strip() for name in MATERIAL.findall(text)})
    if "mtllib" not in text:
        text = f"mtllib {path.stem}.mtl{text}"  # or trimesh would not ask for the names; the file need not be there
    return trimesh.load_scene(BytesIO(text.encode()), file_type="obj", resolver=materials, process=False)


class _Materials(trimesh.resolvers.FilePathResolver):
    """Hands out the names in a .mtl file and those in use, for trimesh keeps none that the file lacks."""

    def __init__(self, path: Path, used: set[str]) -> None:
        super().__init__(str(path))
        self._used = sorted(used)

    def get(self, name: str) -> str:
        try:
            described = trimesh.util.decode_text(super().get(name)).splitlines()
        except (OSError, ValueError, ImportError):  # not there, outside of the folder, in an unknown encoding
            described = []
        names = [line for line in described if line.strip().lower().startswith("newmtl")]
        return "\n".join([*names, *(f"newmtl {material}" for material in self._used)])


def readable(text: str, notes: Notes) -> str:
    """The text of an OBJ file without what trimesh does not read right, a line's end before each line and at the end.

    Concave faces are cut into triangles; convex ones stay, for trimesh to fan.

    :raises ValueError: a relative index before the first vertex, a coordinate or an index that is no number
    """
    text = f"\n{text}\n"
    if not any(odd.search(text) for odd in ODD):
        return text
    lines: list[str] = []
    read = dict.fromkeys(POINTS, 0)  # so far
    vertices: list[float] = []
    polygons: list[tuple[int, list[str]]] = []  # the line of each, and its corners
    for line in text.replace("\r\n", "\n").replace("\\\n", " ").split("\n"):
        words = line.split()
        keyword = words[0] if words else ""
        if keyword in NAMES:  # "Material #25" is a name
            words = words[: words.index("#")] if "#" in words else words
        elif keyword == "f" or keyword in read:
            words = line.partition("#")[0].split() if "#" in line else words
        else:
            continue
        if keyword in read:
            read[keyword] += 1
        if keyword == "v":
            x, y, z = words[1:4]
            vertices += float(x), float(y), float(z)
        elif keyword == "f":
            if "-" in line:
                words[1:] = (_absolute(corner, read) for corner in words[1:])
            if len(words) > 4:
                polygons.append((len(lines), words[1:]))
        lines.append(" ".join(words))
    if polygons:
        _cut_concave(lines, np.array(vertices).reshape(-1, 3), polygons, notes)
    return "\n".join(["", *lines, ""])


def _absolute(corner: str, read: dict[str, int]) -> str:
    """A corner, e.g. ``-1//4``, with indices that count from the file's first vertex.

    :param read: how many of each of ``POINTS`` came before
    """
    indices = corner.split("/")
    for place, (index, keyword) in enumerate(zip(indices, POINTS, strict=False)):
        if index.startswith("-"):
            if int(index) < -read[keyword]:
                raise ValueError(f"a face's corner {corner} counts back beyond the first {keyword}")
            indices[place] = str(read[keyword] + 1 + int(index))
    return "/".join(indices)


def _cut_concave(
    lines: list[str], points: NDArray[np.float64], polygons: list[tuple[int, list[str]]], notes: Notes
) -> None:
    """Replace the lines of concave polygons by lines of triangles.

    :param points: [V, 3] all vertices
    """
    counts = np.array([len(corners) for _, corners in polygons])
    indices = np.array([int(corner.partition("/")[0]) - 1 for _, corners in polygons for corner in corners])
    first = np.cumsum(counts) - counts
    for number in np.flatnonzero(find_concave(points, counts, indices)):
        place, corners = polygons[number]
        outline = points[indices[first[number] : first[number] + len(corners)]]
        remarks = Notes()
        triangles, _ = triangulate(outline, counts[[number]], np.arange(len(corners)), remarks)
        notes.repeat(remarks)
        if remarks.sentences():  # cut into a fan, as trimesh does
            continue
        lines[place] = "\n".join(f"f {corners[a]} {corners[b]} {corners[c]}" for a, b, c in triangles)
