"""A scene made ready once, for all of its frames."""

from __future__ import annotations

from dataclasses import dataclass

from datafactory.paths.merged_scene import MergedScene
from datafactory.scenes.boxes import BoxedThing
from datafactory.scenes.materials.table import MaterialMapping


@dataclass(frozen=True)
class PreparedScene:
    """What a trace needs of a scene.

    :param name: as the ``scene`` column has it
    :param content: hash of the scene
    :param merged: its meshes and targets as the ray tracer takes them
    :param things: what of it gets a box in each frame
    """

    name: str
    content: str
    merged: MergedScene
    materials: MaterialMapping
    things: tuple[BoxedThing, ...] = ()
