"""Which things a scene holds that a detector is to find: what moves, and what has a class.

A thing is one car, one pedestrian, one gate: whatever meshes and point targets it is made of. A reader labels each of
them with its thing (:class:`Label`); what moves without a label is a thing by itself. The class is the one that the
source states, of a target with the model of a road user that of the road user, of everything else ``"other"``.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from datafactory.scenes.chain import Chain
from datafactory.scenes.targets.models import MODELS

if TYPE_CHECKING:
    from datafactory.scenes.scene import PointTarget, Scene, SceneObject

OTHER = "other"
"""Class of what moves and states none."""
OF_MODELS = {"car": "car", "pedestrian": "pedestrian", "cyclist": "bicycle"}
"""Classes that the models of road users imply; a bicycle has its rider."""


@dataclass(frozen=True, eq=False)
class Label:
    """What a mesh or a point target is a part of.

    :param thing: name of the thing, unique in the scene: all of its parts have it
    :param frame: from the thing's own coordinates to the world, at all times
    :param class_name: as the source states it; "" where it states none
    """

    thing: str
    frame: Chain
    class_name: str = ""

    def fingerprint(self) -> bytes:
        """Equal for equal labels: what its boxes depend on that the meshes do not say."""
        home = np.ascontiguousarray(self.frame.at(0.0)[0], dtype="<f8")
        return repr((self.thing, self.class_name)).encode() + home.tobytes()


@dataclass(frozen=True, eq=False)
class Parts:
    """The parts of one thing.

    :param name: of the thing
    :param class_name: never ""
    :param frame: see :class:`Label`; None where none is known
    :param indices: their places among the scene's objects, the point targets after them
    """

    name: str
    class_name: str
    frame: Chain | None
    objects: tuple[SceneObject, ...]
    targets: tuple[PointTarget, ...]
    indices: tuple[int, ...]


def parts_of_things(scene: Scene) -> tuple[Parts, ...]:
    """The things of a scene that move or have a class, in the order of their first parts."""
    members: dict[Hashable, list[int]] = {}
    items: tuple[SceneObject | PointTarget, ...] = (*scene.objects, *scene.targets)
    for index, item in enumerate(items):
        key: Hashable = index if item.label is None else item.label.thing
        members.setdefault(key, []).append(index)
    things = []
    for indices in members.values():
        own = [items[index] for index in indices]
        class_name = next((name for name in map(_class_of, own) if name), "")
        if not class_name and not any(item.moves for item in own):
            continue
        label = own[0].label
        objects = tuple(scene.objects[index] for index in indices if index < len(scene.objects))
        targets = tuple(scene.targets[i - len(scene.objects)] for i in indices if i >= len(scene.objects))
        name, frame = (own[0].name, None) if label is None else (label.thing, label.frame)
        things.append(Parts(name, class_name or OTHER, frame, objects, targets, tuple(indices)))
    return tuple(things)


def _class_of(item: SceneObject | PointTarget) -> str:
    """The class that a part states, or that its model implies; "" without either."""
    if item.label is not None and item.label.class_name:
        return item.label.class_name
    model = getattr(item, "model", None)
    return next((name for kind, name in OF_MODELS.items() if isinstance(model, MODELS[kind])), "")
