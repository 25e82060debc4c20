"""Rays from any place into a merged scene: what they meet first. Mitsuba does it, in the radar frame of one pose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from datafactory.paths.backend import select_variant
from datafactory.paths.geometry import Geometry, first_hits, mesh_of_shape
from datafactory.paths.merged_scene import MergedScene
from datafactory.scenes.poses import Pose

Real = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Met:
    """What n rays met.

    :param distance: [n] [m]; infinite where nothing was met
    :param mesh: [n] index into ``MergedScene.meshes``; -1 where nothing was met
    :param normal: [n, 3] of the surface, unit, towards the ray's start
    """

    distance: Real
    mesh: NDArray[np.int64]
    normal: Real


class RayCaster:
    """A merged scene from one pose, at that pose's time.

    Mitsuba traces in float32, in which a place 100 m away has an error of some 0.01 mm.

    :param merged: the scene; without meshes every ray goes on for ever
    """

    def __init__(self, merged: MergedScene, pose: Pose) -> None:
        self._scene, merged = None, merged.at(pose.time_s)
        if merged.meshes:
            select_variant()
            self._scene = Geometry(merged).place(merged, pose).mi_scene
            self._mesh_of_shape = mesh_of_shape(self._scene)

    def cast(self, start: Real, direction: Real) -> Met:
        """What rays from ``start`` [n, 3] [m] along the unit vectors ``direction`` [n, 3] meet first."""
        count = len(start)
        nothing = Met(np.full(count, np.inf), np.full(count, -1, dtype=np.int64), np.zeros((count, 3)))
        if self._scene is None or not count:
            return nothing
        met = first_hits(self._scene, start, direction, np.full(count, np.inf))
        for number, index in self._mesh_of_shape.items():
            nothing.mesh[met.valid & (met.shape == number)] = index
        towards = -np.sign(np.einsum("ni,ni->n", met.normal, direction))
        nothing.normal[met.valid] = (met.normal * towards[:, None])[met.valid]
        nothing.distance[met.valid] = met.distance[met.valid]
        return nothing
