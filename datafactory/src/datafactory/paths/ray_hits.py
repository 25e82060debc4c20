"""Mitsuba's rays: what each of them meets first, and whether it meets anything.

Whatever is asked of a cast is evaluated in one kernel. Dr.Jit evaluates what is read and keeps nothing else: read one
after another, shape, triangle and distance would each follow all the rays again.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shared.physics.compiled import compiled

Real = NDArray[np.float64]
Index = NDArray[np.int64]

MARGIN_M, MARGIN_SHARE = 1e-4, 2e-5
"""Error of a ray's float32 distance [m], nearby and as a share of the distance."""


@dataclass(frozen=True)
class RayHits:
    """What K rays met first.

    :param valid: [K] whether there was anything; the other values mean nothing where there was not
    :param distance: [K] [m]
    :param shape: [K] number by which a ray names a shape; :param primitive: [K] triangle of the shape
    :param normal: [K, 3] unit, on either side; [0, 3] where it was not asked for
    """

    valid: NDArray[np.bool_]
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

    ray = _rays(start.T.astype(np.float32), direction.T.astype(np.float32), reach.astype(np.float32))
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


def clear_between(mi_scene: Any, start: Real, end: Real) -> NDArray[np.bool_]:
    """[K] whether nothing stands on the straight lines from ``start`` to ``end``, [K, 3] each, in the scene's frame.

    Surfaces nearer to either end than the ray caster's own error do not count.
    """
    start, end = np.broadcast_arrays(np.asarray(start, dtype=np.float64), np.asarray(end, dtype=np.float64))
    if not len(start):
        return np.zeros(0, dtype=bool)
    return ~mi_scene.ray_test(_rays(*_lines(np.ascontiguousarray(start), np.ascontiguousarray(end)))).numpy()


@compiled()
def ray_margin_m(distance_m):
    """Error of a ray's float32 distance [m], of a number or of an array: 0.1 mm nearby, 2 mm at 100 m."""
    return MARGIN_M + MARGIN_SHARE * distance_m


def _rays(start: NDArray[np.float32], direction: NDArray[np.float32], reach: NDArray[np.float32]) -> Any:
    """Mitsuba's rays from ``start`` [3, K] along ``direction`` [3, K], no longer than ``reach`` [K]."""
    import mitsuba as mi

    ray: Any = mi.Ray3f(mi.Point3f(*start), mi.Vector3f(*direction))
    ray.maxt = reach
    return ray


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
