"""What rays meet: Mitsuba's scene of a merged scene, kept in a process from frame to frame.

Meshes, triangles and materials of a merged scene are the same in all frames. Its vertices, which stand in the radar
frame, are rewritten in place, and Mitsuba builds its acceleration structure of them anew: what rays meet does not
depend on the frames that went before. That is what a frame pays for, a microsecond a triangle. A kept scene shows one
pose at a time: what was asked of an earlier frame's has to be read before the next.

Sionna's radio scene stands on the same meshes and has an acceleration structure of its own, which takes the place of
Mitsuba's where the path solver first runs (:mod:`datafactory.paths.solver`).

Whatever is asked of a cast is evaluated in one kernel. Dr.Jit evaluates what is read and keeps nothing else: read one
after another, shape, triangle and distance would each follow all the rays again.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from datafactory.paths.backend import select_variant
from datafactory.paths.merged_scene import MergedScene
from datafactory.scenes.poses import Pose
from shared.physics.compiled import compiled
from shared.physics.vectors import ALIGNMENT, Index, Mask, Real, aligned

MARGIN_M, MARGIN_SHARE = 1e-4, 2e-5
"""Error of a ray's float32 distance [m], nearby and as a share of the distance."""


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


_KEPT: WeakKeyDictionary[MergedScene, dict[str, Geometry]] = WeakKeyDictionary()
"""Of each scene that there is, by Mitsuba's variant: the frames of several are dealt in turn."""


def placed(merged: MergedScene, pose: Pose) -> Geometry:
    """The kept geometry of a scene, seen from a pose at its time.

    :param merged: at the pose's time
    """
    rest, variant = merged.at_rest or merged, select_variant()
    known = _KEPT.setdefault(rest, {})
    if variant not in known:
        known[variant] = Geometry(rest)
    return known[variant].place(merged, pose)


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


@dataclass(frozen=True)
class RayHits:
    """What K rays met first.

    :param valid: [K] whether there was anything; the other values mean nothing where there was not
    :param distance: [K] [m]
    :param shape: [K] number by which a ray names a shape; :param primitive: [K] triangle of the shape
    :param normal: [K, 3] unit, on either side; [0, 3] where it was not asked for
    """

    valid: Mask
    distance: Real
    shape: Index
    primitive: Index
    normal: Real


def first_hits(mi_scene: Any, start: Real, direction: Real, reach: Real, normals: bool = True) -> RayHits:
    """What rays from ``start`` [K, 3] [m] along unit vectors [K, 3], no longer than ``reach`` [K] [m], meet first.

    :param mi_scene: Mitsuba's scene in the frame of the rays; K is at least 1, for no array of Mitsuba may be empty
    """
    import drjit as dr
    import mitsuba as mi

    ray = _rays(start.T, direction.T, reach)
    met = mi_scene.ray_intersect(ray) if normals else mi_scene.ray_intersect_preliminary(ray)
    valid, shape = met.is_valid(), mi.UInt32(dr.reinterpret_array(mi.UInt32, met.shape))
    dr.eval(valid, shape, met.prim_index, met.t, *(met.n if normals else ()))
    normal = np.stack([axis.numpy() for axis in met.n], axis=1) if normals else np.zeros((0, 3))
    return RayHits(
        valid=valid.numpy(),
        distance=met.t.numpy().astype(np.float64),
        shape=shape.numpy().astype(np.int64),
        primitive=met.prim_index.numpy().astype(np.int64),
        normal=normal.astype(np.float64),
    )


def clear_between(mi_scene: Any, start: Real, end: Real) -> Mask:
    """[K] whether nothing stands on the straight lines from ``start`` to ``end``, [K, 3] each, in the scene's frame.

    Surfaces nearer to either end than the ray caster's own error do not count.
    """
    start, end = np.broadcast_arrays(np.asarray(start, dtype=np.float64), np.asarray(end, dtype=np.float64))
    if not len(start):
        return np.zeros(0, dtype=bool)
    return ~mi_scene.ray_test(_rays(*_lines(np.array(start), np.array(end)))).numpy()


@compiled()
def ray_margin_m(distance_m):
    """Error of a ray's float32 distance [m], of a number or of an array: 0.1 mm nearby, 2 mm at 100 m."""
    return MARGIN_M + MARGIN_SHARE * distance_m


def _rays(start: NDArray[np.floating], direction: NDArray[np.floating], reach: NDArray[np.floating]) -> Any:
    """Mitsuba's rays from ``start`` [3, K] along ``direction`` [3, K], no longer than ``reach`` [K]."""
    import mitsuba as mi

    ray: Any = mi.Ray3f(mi.Point3f(*aligned_rows(start)), mi.Vector3f(*aligned_rows(direction)))
    (ray.maxt,) = aligned_rows(reach[None])
    return ray


def aligned_rows(values: NDArray[np.floating]) -> NDArray[np.float32]:
    """[n, K] numbers as float32, each row of which begins at a multiple of ``ALIGNMENT`` bytes.

    Dr.Jit works on NumPy's memory where it lies, and has a kernel of its own for every choice of rows that do not begin
    there: of a ray's seven there could be 128, each compiled when it is first met.
    """
    count, numbers = values.shape[1], ALIGNMENT // np.dtype(np.float32).itemsize
    rows = aligned((len(values), -(-count // numbers) * numbers), np.float32)[:, :count]
    rows[...] = values
    return np.asarray(rows, dtype=np.float32)


@compiled()
def _lines(start, end):
    """Where lines from ``start`` to ``end`` [K, 3] leave their margin [3, K], their directions [3, K], and how long
    they are to the margin of their end [K]: in float64, then rounded to float32."""
    count = len(start)
    first, direction = np.empty((3, count), np.float32), np.empty((3, count), np.float32)
    reach = np.empty(count, np.float32)
    for k in range(count):
        x, y, z = start[k]
        far_x, far_y, far_z = end[k]
        along_x, along_y, along_z = far_x - x, far_y - y, far_z - z
        distance = np.sqrt(along_x * along_x + along_y * along_y + along_z * along_z)
        length = distance if distance > 0.0 else 1.0
        along_x, along_y, along_z = along_x / length, along_y / length, along_z / length
        ahead = ray_margin_m(np.sqrt(x * x + y * y + z * z))
        behind = ray_margin_m(np.sqrt(far_x * far_x + far_y * far_y + far_z * far_z))
        first[0, k], first[1, k], first[2, k] = x + ahead * along_x, y + ahead * along_y, z + ahead * along_z
        direction[0, k], direction[1, k], direction[2, k] = along_x, along_y, along_z
        reach[k] = max(distance - ahead - behind, 0.0)
    return first, direction, reach
