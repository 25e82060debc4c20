"""One entrance for every scene, whatever its format, and the scenes that have a name: this package's and Sionna's.

The files of this package lie in ``datafactory/scenes/shipped``. In a checkout its entries are links to the folder
``scenes`` at the root; a wheel has the files themselves.
"""

from __future__ import annotations

import importlib.util
import os
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from datafactory.scenes.readers.common import AS_WRITTEN, Reading
from datafactory.scenes.scene import Scene
from shared.physics.errors import InputError, meant, require_utf8

USD_SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")
MITSUBA_SUFFIXES = (".xml",)
MESH_SUFFIXES = (".glb", ".gltf", ".obj", ".ply", ".stl")
KNOWN_SUFFIXES = USD_SUFFIXES + MITSUBA_SUFFIXES + MESH_SUFFIXES
SHIPPED_PREFIX = "shipped:"
SIONNA_PREFIX = "sionna:"
SHIPPED_FOLDER = Path(__file__).resolve().parents[1] / "shipped"
FORMATS = {".usda": "USD", ".xml": "Mitsuba"}
"""Of shipped scenes. Of two files of one name the first of these has the bare name, and the other its suffix."""


def open_scene(source: str, reading: Reading = AS_WRITTEN) -> Scene:
    """Read a scene in metres and z up.

    :param source: a path with one of ``KNOWN_SUFFIXES``, or ``shipped:NAME`` or ``sionna:NAME`` for a scene that this
        package or Sionna ships
    :param reading: what the user decides of it
    :raises InputError: an unknown suffix or name, a file that is missing or unreadable, a path that is not UTF-8, a
        scene with nothing in it
    """
    source = str(source)
    require_utf8(source)
    named = named_file(source)
    if named is not None:
        name, path = named
        scene = replace(_read(path, name, reading), name=name, source=source)
    else:
        path = Path(source)
        if path.is_dir():
            raise InputError(source, "no such file: it is a folder", "a scene file")
        if path.suffix.lower() not in KNOWN_SUFFIXES:
            expected = f"one of {' '.join(KNOWN_SUFFIXES)}, or {SHIPPED_PREFIX}NAME or {SIONNA_PREFIX}NAME"
            raise InputError(source, f"unknown scene format {path.suffix!r}", expected)
        if not path.is_file():
            raise InputError(source, "no such file", f"an existing scene file{_meant_file(path)}")
        if not os.access(path, os.R_OK):
            raise InputError(source, "cannot be opened", "a readable file")
        scene = _read(path, path.stem, reading)
    if not scene.objects and not scene.targets:
        found = f" ({'; '.join(scene.warnings)})" if scene.warnings else ""
        raise InputError(source, f"the scene is empty{found}", "at least one triangle mesh or point target")
    return replace(scene, variants=reading.variants, allow_missing=reading.allow_missing)


@np.errstate(invalid="ignore", over="ignore")  # what is not finite is left out and counted, or refused
def _read(path: Path, name: str, reading: Reading) -> Scene:
    suffix = path.suffix.lower()
    if suffix in USD_SUFFIXES:
        # Imported where needed: each format does without the libraries of the others.
        from datafactory.scenes.readers.usd import read_usd

        return read_usd(path, reading)
    if reading.variants:
        raise InputError("--variant", f"{path} has no variants", "a USD file")
    if suffix in MITSUBA_SUFFIXES:
        from datafactory.scenes.readers.mitsuba import read_mitsuba

        return read_mitsuba(path, name)
    from datafactory.scenes.readers.mesh_files import read_mesh_file

    return read_mesh_file(path)


def _meant_file(path: Path) -> str:
    """The scene in the same folder whose name is like a missing one's."""
    try:
        beside = sorted(path.parent.iterdir())
    except OSError:
        beside = []
    return meant(path.name, (other.name for other in beside if other.suffix.lower() in KNOWN_SUFFIXES))


class NamedScene(NamedTuple):
    """One scene.

    :param name: what ``--scene`` takes
    :param bytes: of its file and, of Mitsuba's format, of its meshes
    :param about: the file's own documentation; "" where it has none
    """

    name: str
    kind: str
    bytes: int
    about: str


def shipped_scenes() -> dict[str, Path]:
    """Name and file of every scene that this package ships, by name."""
    found: dict[str, Path] = {}
    for suffix in FORMATS:
        for file in sorted([*SHIPPED_FOLDER.glob(f"*{suffix}"), *SHIPPED_FOLDER.glob(f"*/*{suffix}")]):
            name = file.relative_to(SHIPPED_FOLDER).with_suffix("").as_posix()
            found[name if name not in found else name + suffix] = file
    return dict(sorted(found.items(), key=lambda entry: ("/" in entry[0], entry[0])))


def sionna_scenes() -> dict[str, Path]:
    """Name and file of every scene that the installed Sionna ships, found without importing it."""
    spec = importlib.util.find_spec("sionna")
    roots = spec.submodule_search_locations if spec is not None and spec.submodule_search_locations else ()
    files = (file for root in roots for file in sorted(Path(root, "rt", "scenes").glob("*/*.xml")))
    return {file.stem: file for file in files if file.stem == file.parent.name}


def named_file(source: str) -> tuple[str, Path] | None:
    """Short name and file of ``shipped:NAME`` and ``sionna:NAME``; None for anything else.

    :raises InputError: no scene of that name
    """
    for prefix, scenes, owner, missing in (
        (SHIPPED_PREFIX, shipped_scenes, "shipped", "the package's own files in their place"),
        (SIONNA_PREFIX, sionna_scenes, "Sionna", "Sionna installed"),
    ):
        if source.startswith(prefix):
            known, name = scenes(), source.removeprefix(prefix)
            if name not in known:
                expected = f"{', '.join(known)}{meant(name, known)}" if known else missing
                raise InputError(source, f"unknown {owner} scene", expected)
            return known[name].stem if prefix == SHIPPED_PREFIX else name, known[name]
    return None


def named_scenes() -> list[NamedScene]:
    """All scenes that have a name: this package's, then Sionna's."""
    found = []
    for prefix, scenes in ((SHIPPED_PREFIX, shipped_scenes()), (SIONNA_PREFIX, sionna_scenes())):
        for name, file in scenes.items():
            meshes = (file.parent / "meshes").glob("*.ply") if file.suffix == ".xml" else ()
            size = sum(path.stat().st_size for path in (file, *meshes))
            found.append(NamedScene(f"{prefix}{name}", FORMATS[file.suffix], size, _about(file)))
    return found


def _about(file: Path) -> str:
    """The documentation in a USD layer's header, on one line."""
    if file.suffix != ".usda":
        return ""
    from datafactory.scenes.usd_library import Sdf

    layer = Sdf.Layer.FindOrOpen(str(file))
    return " ".join(layer.documentation.split()) if layer is not None else ""
