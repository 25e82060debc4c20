"""What a mesh or a point target is a part of, and the classes that there are.

A thing is one car, one pedestrian, one gate: whatever meshes and point targets it is made of. A reader labels each of
them with its thing. The class is the one that the source states, of a target with the model of a road user that of the
road user, of everything else ``"other"``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from datafactory.scenes.chain import Chain

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
