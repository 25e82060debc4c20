"""The solid things of a procedural city and of a populated scene, in their places at any time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from solids import Shape, Standing

from datafactory.scenes.city.shapes import yaw_rotation
from datafactory.scenes.city.site import Placement
from datafactory.scenes.scene import Scene, SceneObject
from datafactory.scenes.things import Thing

FLAT = ("Ground/", "Covers/")
"""Sheets that everything stands on: no bodies."""


def city_solids(placements: Sequence[Placement]) -> list[Standing]:
    """Of a city's placements, none of which moves."""
    shapes: dict[str, Shape] = {}
    found = []
    for item in placements:
        if item.surface is None or item.path.startswith(FLAT):
            continue
        key = item.model or item.path
        if key not in shapes:
            shapes[key] = Shape.of(item.surface.vertices, item.surface.triangles())
        found.append(Standing(item.path, shapes[key], yaw_rotation(item.yaw_deg), np.array(item.position)))
    return found


class PopulationSolids:
    """Of what was put into a scene; who walks or rides is the box of the model's size."""

    def __init__(self, scene: Scene) -> None:
        assert scene.population is not None
        self.things = scene.population.things
        meshes: dict[str, list[SceneObject]] = {}
        for item in scene.objects:
            meshes.setdefault(item.name.rpartition("/")[0], []).append(item)
        self.shapes = {}
        for thing in self.things:
            axes, foot = np.array(thing.axes), np.array(thing.position)
            half = 0.5 * np.array(thing.size_m)
            self.shapes[thing.name] = (
                Shape.around([((item.vertices - foot) @ axes.T, item.triangles) for item in meshes[thing.name]])
                if thing.name in meshes
                else Shape.box((-half[0], -half[1], 0.0), (half[0], half[1], 2.0 * half[2]))
            )
        self.still = {thing.name: self._standing(thing, 0.0) for thing in self.things if thing.motion is None}

    def at(self, time_s: float) -> list[Standing]:
        return [self.still.get(thing.name) or self._standing(thing, time_s) for thing in self.things]

    def _standing(self, thing: Thing, time_s: float) -> Standing:
        shape, axes = self.shapes[thing.name], np.array(thing.axes)
        return Standing(thing.name, shape, axes.T, thing.at(time_s)[0], thing.motion is not None)
