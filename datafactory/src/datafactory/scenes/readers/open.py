"""One entrance for every scene, whatever its format."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from datafactory.scenes.readers.common import AS_WRITTEN, Reading
from datafactory.scenes.readers.named import SHIPPED_PREFIX, SIONNA_PREFIX, named_file
from datafactory.scenes.scene import Scene
from shared.physics.errors import InputError, meant, require_utf8

USD_SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")
MITSUBA_SUFFIXES = (".xml",)
MESH_SUFFIXES = (".glb", ".gltf", ".obj", ".ply", ".stl")
KNOWN_SUFFIXES = USD_SUFFIXES + MITSUBA_SUFFIXES + MESH_SUFFIXES


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
        scene = _read(path, name, reading)
        scene = Scene(name, scene.objects, scene.targets, source, scene.warnings)
    else:
        path = Path(source)
        if path.suffix.lower() not in KNOWN_SUFFIXES:
            expected = f"one of {' '.join(KNOWN_SUFFIXES)}, or {SHIPPED_PREFIX}NAME or {SIONNA_PREFIX}NAME"
            raise InputError(source, f"unknown scene format {path.suffix!r}", expected)
        if not path.is_file():
            raise InputError(source, "no such file", f"an existing scene file{_meant_file(path)}")
        try:
            with path.open("rb"):
                pass
        except OSError as error:
            raise InputError(source, f"cannot be opened ({error.strerror})", "a readable file") from error
        scene = _read(path, path.stem, reading)
    if not scene.objects and not scene.targets:
        found = f" ({'; '.join(scene.warnings)})" if scene.warnings else ""
        raise InputError(source, f"the scene is empty{found}", "at least one triangle mesh or point target")
    return scene


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
