"""The scenes that can be named, with what their files say of themselves."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from datafactory.scenes.readers.named import SHIPPED_PREFIX, SIONNA_PREFIX, shipped_scenes, sionna_scenes

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
