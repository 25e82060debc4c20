"""Mitsuba's rays, and what each of them meets first.

Whatever is asked of a cast is evaluated in one kernel. Dr.Jit evaluates what is read and keeps nothing else: read one
after another, shape, triangle and distance would each follow all the rays again.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Real = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass(frozen=True)
class RayHits:
    """What K rays met first.

    :param valid: [K] whether there was anything; the other values mean nothing where there was not
    :param distance: [K] [m]
    :param shape: [K] number by which a ray names a shape; :param primitive: [K] triangle of the shape
    :param normal: [K, 3] unit, on either side
    """

    valid: NDArray[np.bool_]
    distance: Real
    shape: Index
    primitive: Index
    normal: Real


def rays_of(start: Real, direction: Real, reach: Real) -> Any:
    """Mitsuba's rays from ``start`` [K, 3] along ``direction`` [K, 3], no longer than ``reach`` [K]."""
    import mitsuba as mi

    ray: Any = mi.Ray3f(mi.Point3f(*start.T.astype(np.float32)), mi.Vector3f(*direction.T.astype(np.float32)))
    ray.maxt = reach.astype(np.float32)
    return ray


def first_hits(mi_scene: Any, start: Real, direction: Real, reach: Real) -> RayHits:
    """What rays from ``start`` [K, 3] [m] along unit vectors [K, 3], no longer than ``reach`` [K] [m], meet first.

    :param mi_scene: Mitsuba's scene in the frame of the rays; K is at least 1, for no array of Mitsuba may be empty
    """
    import drjit as dr
    import mitsuba as mi

    met = mi_scene.ray_intersect(rays_of(start, direction, reach))
    valid, shape = met.is_valid(), mi.UInt32(dr.reinterpret_array(mi.UInt32, met.shape))
    dr.eval(valid, shape, met.prim_index, met.t, met.n)
    return RayHits(
        valid=valid.numpy(),
        distance=met.t.numpy().astype(np.float64),
        shape=shape.numpy().astype(np.int64),
        primitive=met.prim_index.numpy().astype(np.int64),
        normal=np.stack([axis.numpy() for axis in met.n], axis=1).astype(np.float64),
    )
