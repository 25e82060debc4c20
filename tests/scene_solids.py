"""The solid things of a procedural city and of a populated scene, in their places at any time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from solids import Shape, Standing

from datafactory.scenes.city.placement import Placement
from datafactory.scenes.city.shapes import yaw_rotation
from datafactory.scenes.scene import Scene, SceneObject
from datafactory.scenes.things import Thing

FLAT = ("Ground/", "Covers/")
"""Sheets that everything stands on: no bodies."""


def placed(item: Placement, time_s: float) -> tuple[tuple[float, float, float], float]:
    """Where a placement is at a time, by its keyframes: linear between them, at rest beyond them."""
    if not item.keyframes:
        return item.position, item.yaw_deg
    times = [key.time_s for key in item.keyframes]
    x, y, z = (float(np.interp(time_s, times, [key.position[axis] for key in item.keyframes])) for axis in range(3))
    return (x, y, z), float(np.interp(time_s, times, [key.yaw_deg for key in item.keyframes]))


class CitySolids:
    """Of a city's placements."""

    def __init__(self, placements: Sequence[Placement]) -> None:
        self.placements = [item for item in placements if item.surface is not None and not item.path.startswith(FLAT)]
        surfaces = {item.model or item.path: item.surface for item in self.placements}
        self.shapes = {key: Shape.of(of.vertices, of.triangles()) for key, of in surfaces.items() if of is not None}
        self.still = {item.path: self._standing(item, 0.0) for item in self.placements if not item.keyframes}

    def at(self, time_s: float) -> list[Standing]:
        return [self.still.get(item.path) or self._standing(item, time_s) for item in self.placements]

    def _standing(self, item: Placement, time_s: float) -> Standing:
        position, yaw_deg = placed(item, time_s)
        shape = self.shapes[item.model or item.path]
        return Standing(item.path, shape, yaw_rotation(yaw_deg), np.array(position), bool(item.keyframes))


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
