"""The solid things of a procedural city and of a populated scene, in their places at any time."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from solids import Shape, Standing

from datafactory.scenes.boxes import BoxedThing, boxed_things
from datafactory.scenes.city.shapes import Surface
from datafactory.scenes.city.site import Placement
from datafactory.scenes.scene import Scene, SceneObject
from datafactory.scenes.things import FOLDER

FLAT = ("Ground/", "Covers/")
"""Sheets that everything stands on: no bodies."""


def triangles_of(surface: Surface) -> NDArray[np.int64]:
    """[T, 3] vertex indices of all faces, as fans: the faces are convex."""
    return np.array([(face[0], face[i], face[i + 1]) for face in surface.faces for i in range(1, len(face) - 1)])


def city_solids(placements: Sequence[Placement]) -> list[Standing]:
    """Of a city's placements, none of which moves."""
    shapes: dict[str, Shape] = {}
    found = []
    for item in placements:
        if item.surface is None or item.path.startswith(FLAT):
            continue
        key = item.model or item.path
        if key not in shapes:
            shapes[key] = Shape.of(item.surface.vertices, triangles_of(item.surface))
        found.append(
            Standing(
                item.path,
                shapes[key],
                Rotation.from_euler("z", item.yaw_deg, degrees=True).as_matrix(),
                np.array(item.position),
            )
        )
    return found


@dataclass(frozen=True, eq=False)
class Thing:
    """What was put into a scene, as its box has it."""

    boxed: BoxedThing

    @property
    def name(self) -> str:
        return self.boxed.name

    @property
    def label(self) -> str:
        return self.boxed.class_name

    @property
    def size_m(self) -> np.ndarray:
        return self.boxed.start.size

    @property
    def axes(self) -> np.ndarray:
        """Rows ahead, left, up."""
        return self.boxed.start.axes

    @property
    def moves(self) -> bool:
        return any(item.moves for item in self.boxed.items)

    def at(self, time_s: float) -> tuple[np.ndarray, np.ndarray]:
        """Where the middle of its underside is [3] m, and its velocity [3] m/s."""
        box = self.boxed.at(time_s)
        return box.center - 0.5 * box.size[2] * box.axes[2], box.velocity


def things_of(scene: Scene) -> list[Thing]:
    """Everything that was put into a scene."""
    return [Thing(boxed) for boxed in boxed_things(scene) if boxed.name.startswith(f"{FOLDER}/")]


class PopulationSolids:
    """Of what was put into a scene; who walks or rides is the box of the model's size."""

    def __init__(self, scene: Scene) -> None:
        self.things = things_of(scene)
        meshes: dict[str, list[SceneObject]] = {}
        for item in scene.objects:
            meshes.setdefault(item.name.rpartition("/")[0], []).append(item)
        self.shapes = {}
        for thing in self.things:
            axes, foot, half = thing.axes, thing.at(0.0)[0], 0.5 * thing.size_m
            self.shapes[thing.name] = (
                Shape.around([((item.vertices - foot) @ axes.T, item.triangles) for item in meshes[thing.name]])
                if thing.name in meshes
                else Shape.box((-half[0], -half[1], 0.0), (half[0], half[1], 2.0 * half[2]))
            )
        self.still = {thing.name: self._standing(thing, 0.0) for thing in self.things if not thing.moves}

    def at(self, time_s: float) -> list[Standing]:
        return [self.still.get(thing.name) or self._standing(thing, time_s) for thing in self.things]

    def _standing(self, thing: Thing, time_s: float) -> Standing:
        return Standing(thing.name, self.shapes[thing.name], thing.axes.T, thing.at(time_s)[0], thing.moves)
