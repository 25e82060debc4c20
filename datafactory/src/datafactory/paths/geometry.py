"""What rays meet: Mitsuba's scene of a merged scene, kept in a process from frame to frame.

Meshes, triangles and materials of a merged scene are the same in all frames. Its vertices are not, for they stand in
the radar frame. They are rewritten in place, and Mitsuba builds its acceleration structure of them anew, whatever it
was before: what rays meet does not depend on the frames that went before. That structure is what a frame pays for, a
microsecond a triangle; everything else is made once.

Sionna's radio scene stands on the same meshes and has an acceleration structure of its own. It takes the place of
Mitsuba's where the path solver first runs (:mod:`datafactory.paths.solver`); a scene whose frames need no solver has
none. A kept scene shows one pose at a time: what was asked of an earlier frame's has to be read before the next.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datafactory.paths.backend import select_variant
from datafactory.paths.merged_scene import MergedScene
from datafactory.scenes.poses import Pose

KEPT = 4
"""Scenes that a process keeps: the frames of several are dealt in turn."""


class Geometry:
    """A merged scene's meshes in Mitsuba, in the radar frame of one pose at a time.

    :param merged: at any time
    """

    def __init__(self, merged: MergedScene) -> None:
        self.meshes = [
            _mesh(name_of(index), len(mesh.vertices), mesh.triangles) for index, mesh in enumerate(merged.meshes)
        ]
        self.radio: Any = None
        """Sionna's scene, where the solver has made one."""
        self._plain: Any = None

    @property
    def mi_scene(self) -> Any:
        """Mitsuba's scene; its shape ``part-N`` is the merged scene's mesh N."""
        return self._plain if self.radio is None else self.radio.mi_scene

    def stand_on(self, radio: Any) -> None:
        """Show Sionna's scene of these meshes from now on."""
        self.radio, self._plain = radio, None

    def place(self, merged: MergedScene, pose: Pose) -> Geometry:
        """This geometry, seen from a pose.

        :param merged: the scene that it was made of, at the pose's time
        """
        import mitsuba as mi

        for kept, mesh in zip(self.meshes, merged.meshes, strict=True):
            parameters = mi.traverse(kept)
            parameters["vertex_positions"] = mesh.seen_from(pose).ravel()
            parameters.update()
        if self.mi_scene is None:
            self._plain = mi.load_dict({"type": "scene", **{mesh.id(): mesh for mesh in self.meshes}})
        else:
            self.mi_scene.parameters_changed()
        return self


def placed(merged: MergedScene, pose: Pose) -> Geometry:
    """The kept geometry of a scene, seen from a pose at its time.

    :param merged: at the pose's time
    """
    rest = merged.at_rest or merged
    return _kept(rest, select_variant()).place(merged, pose)


@lru_cache(maxsize=KEPT)
def _kept(rest: MergedScene, variant: str) -> Geometry:
    return Geometry(rest)


def name_of(mesh: int) -> str:
    """The name of a merged mesh's shape."""
    return f"part-{mesh}"


def mesh_of_shape(mi_scene: Any) -> dict[int, int]:
    """Index into ``MergedScene.meshes`` by the number with which a ray names the shape it met."""
    import drjit as dr
    import mitsuba as mi

    shapes = mi_scene.shapes()
    numbers = mi.UInt32(dr.reinterpret_array(mi.UInt32, mi_scene.shapes_dr())).numpy() if shapes else ()
    names = (int(shape.id().removeprefix(name_of(0)[:-1])) for shape in shapes)
    return {int(number): name for number, name in zip(numbers, names, strict=True)}


def _mesh(name: str, vertices: int, triangles: NDArray[np.int32]) -> Any:
    """Mitsuba's mesh of so many vertices, which have no places yet, and triangles [T, 3]."""
    import mitsuba as mi

    mesh = mi.Mesh(name, vertex_count=vertices, face_count=len(triangles))
    mesh.set_id(name)
    parameters = mi.traverse(mesh)
    parameters["faces"] = triangles.astype(np.uint32).ravel()
    parameters.update()
    return mesh
