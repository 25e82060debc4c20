"""Scenes by name: those that this package ships, and those that Sionna ships; what their files say of themselves.

The files of this package lie in ``datafactory/scenes/shipped``. In a checkout its entries are links to the folder
``scenes`` at the root; a wheel has the files themselves.
"""

from __future__ import annotations

import importlib.util
from dataclasses import dataclass
from pathlib import Path

from shared.physics.errors import InputError, meant

SHIPPED_PREFIX = "shipped:"
SIONNA_PREFIX = "sionna:"
SHIPPED_FOLDER = Path(__file__).resolve().parents[1] / "shipped"
SHIPPED_SUFFIXES = (".usda", ".xml")
"""Of two files of one name the first of these has the bare name, and the other its suffix."""

FORMATS = {".usda": "USD", ".xml": "Mitsuba"}


@dataclass(frozen=True)
class NamedScene:
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
    for suffix in SHIPPED_SUFFIXES:
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
            found.append(NamedScene(f"{prefix}{name}", FORMATS[file.suffix], _bytes(file), _about(file)))
    return found


def _bytes(file: Path) -> int:
    meshes = sorted((file.parent / "meshes").glob("*.ply")) if file.suffix == ".xml" else []
    return sum(path.stat().st_size for path in (file, *meshes))


def _about(file: Path) -> str:
    """The documentation in a USD layer's header, on one line."""
    if file.suffix != ".usda":
        return ""
    from datafactory.scenes.usd_library import Sdf

    layer = Sdf.Layer.FindOrOpen(str(file))
    return " ".join(layer.documentation.split()) if layer is not None else ""
