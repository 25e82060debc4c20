"""One entrance for every scene, whatever its format."""

from __future__ import annotations

import importlib.util
from pathlib import Path

from datafactory.scenes.readers.mesh_files import MESH_SUFFIXES, read_mesh_file
from datafactory.scenes.readers.mitsuba import read_mitsuba
from datafactory.scenes.readers.reading import AS_WRITTEN, Reading
from datafactory.scenes.scene import Scene
from shared.physics.errors import InputError, meant, require_utf8

USD_SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")
MITSUBA_SUFFIXES = (".xml",)
KNOWN_SUFFIXES = USD_SUFFIXES + MITSUBA_SUFFIXES + MESH_SUFFIXES
SIONNA_PREFIX = "sionna:"


def open_scene(source: str, reading: Reading = AS_WRITTEN) -> Scene:
    """Read a scene in metres and z up.

    :param source: a path with one of ``KNOWN_SUFFIXES``, or ``sionna:NAME`` for a scene that Sionna ships
    :param reading: what the user decides of it
    :raises InputError: an unknown suffix or name, a file that is missing or unreadable, a path that is not UTF-8, a
        scene with nothing in it
    """
    source = str(source)
    require_utf8(source)
    if source.startswith(SIONNA_PREFIX):
        name = source.removeprefix(SIONNA_PREFIX)
        scene = _read(_sionna_file(name), name, reading)
        scene = Scene(name, scene.objects, scene.targets, source, scene.warnings)
    else:
        path = Path(source)
        if path.suffix.lower() not in KNOWN_SUFFIXES:
            expected = f"one of {' '.join(KNOWN_SUFFIXES)}, or {SIONNA_PREFIX}NAME"
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


def sionna_scenes() -> dict[str, Path]:
    """Name and file of every scene that the installed Sionna ships, found without importing it."""
    spec = importlib.util.find_spec("sionna")
    roots = spec.submodule_search_locations if spec is not None and spec.submodule_search_locations else ()
    files = (file for root in roots for file in sorted(Path(root, "rt", "scenes").glob("*/*.xml")))
    return {file.stem: file for file in files if file.stem == file.parent.name}


def _sionna_file(name: str) -> Path:
    known = sionna_scenes()
    if name not in known:
        expected = f"{', '.join(known)}{meant(name, known)}" if known else "Sionna installed"
        raise InputError(f"{SIONNA_PREFIX}{name}", "unknown Sionna scene", expected)
    return known[name]


def _read(path: Path, name: str, reading: Reading) -> Scene:
    suffix = path.suffix.lower()
    if suffix in USD_SUFFIXES:
        # Imported where needed: the other formats do without USD's libraries.
        from datafactory.scenes.readers.usd import read_usd

        return read_usd(path, reading)
    if reading.variants:
        raise InputError("--variant", f"{path} has no variants", "a USD file")
    if suffix in MITSUBA_SUFFIXES:
        return read_mitsuba(path, name)
    return read_mesh_file(path)


def _meant_file(path: Path) -> str:
    """The scene in the same folder whose name is like a missing one's."""
    try:
        beside = sorted(path.parent.iterdir())
    except OSError:
        beside = []
    return meant(path.name, (other.name for other in beside if other.suffix.lower() in KNOWN_SUFFIXES))
