"""More rays where few would share a resolution cell: what the first look at a scene says of the elevations.

On flat ground a range cell covers less and less of the elevations with distance (docs/notes/speckle.md). So a few rays
are sent ahead, in the fan's own density. Each that arrives at r, on a surface with the normal n, says how many rays a
unit of z, the sine of elevation, has to have for its cell to hold K of them,

    dr/dz = -r (n . d') / (n . d),     p(z) = K / (N P_u dz),     dz = dr_cell / |dr/dz|,

with d' the change of the direction d by z at a fixed azimuth, and P_u the fan's share of rays in a cell of u. A strip
of elevations asks for what is enough for three quarters of its rays: what is rarer would take rays for walls that have
them. A cell costs K rays wherever it is, so the nearest come first: all strips are given what they ask for within the
largest range for which the rays suffice. Every strip keeps a share of the fan's density, for what lies beyond. The
look's lattice does not depend on the frame's offset: given what it says, the expected power is what it was.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from datafactory.paths.cells import RANGE_CELL_M, U_CELL
from datafactory.paths.rays import UNIFORM_IN_U, RayFan
from datafactory.paths.view import View, Waves
from shared.physics.vectors import Real, dots, lengths

STRIPS, RAYS_A_STRIP = 256, 64
"""Strips of equal shares of the beam; at the horizon 256 of them are 9e-4 wide, 1.4 m of ground at 30 m."""
RAYS_A_CELL = 6.0
"""K. One more than makes speckle (:data:`datafactory.paths.cells.FEW_PATHS`), for a lattice does not fall evenly."""
UNAIMED = 0.55
"""Least factor on the fan's density. More lights more cells far away and fills fewer near (docs/notes/speckle.md)."""
AGREEING = 0.75
"""Share of a strip's rays that what it asks for is enough for."""
SHARE_IN_U = UNIFORM_IN_U * U_CELL / 2.0
"""P_u, without the part of the fan that is uniform in azimuth."""


def aimed(fan: RayFan, view: View) -> RayFan:
    """The fan with more rays at the elevations that ask for them."""
    if not fan.aimable:
        return fan
    strips = _within_reach(*_asked(fan, view))
    return replace(fan, strips=tuple(strips / strips.mean()))


def _asked(fan: RayFan, view: View) -> tuple[Real, Real]:
    """What the rays of a look ask for, and where they arrive.

    :return: [STRIPS, RAYS_A_STRIP] factors on the fan's density, and ranges [m], infinite where nothing is met
    """
    look = RayFan(STRIPS * RAYS_A_STRIP, beam=fan.beam)
    direction = look.directions()
    index, hits = view.hit_by(Waves.departing(direction, np.zeros(direction.shape, dtype=np.complex128)))
    asked, range_m = np.zeros(look.count), np.full(look.count, np.inf)
    d = direction[index]
    distance = lengths(hits.point)
    level = np.maximum(np.hypot(d[:, 0], d[:, 1]), np.finfo(float).tiny)
    turned = np.column_stack([-d[:, :2] * (d[:, 2] / level**2)[:, None], np.ones(len(d))])
    slope = distance * np.abs(dots(hits.normal, turned)) / hits.cosine
    density = RAYS_A_CELL * slope / (fan.count * SHARE_IN_U * RANGE_CELL_M)
    asked[index] = density / look.elevation_density(d[:, 2])
    range_m[index] = distance
    # The look's lattice rises in z, so that its rays stand in the order of the strips.
    return asked.reshape(STRIPS, RAYS_A_STRIP), range_m.reshape(STRIPS, RAYS_A_STRIP)


def _within_reach(asked: Real, range_m: Real) -> Real:
    """[STRIPS] the factors asked for within the largest range for which they do not take more rays than there are."""
    ranges = np.unique(range_m[np.isfinite(range_m)])
    granted = np.full(len(asked), UNAIMED)
    low, high = 0, len(ranges)
    while low < high:
        middle = (low + high) // 2
        within = np.quantile(np.where(range_m <= ranges[middle], asked, 0.0), AGREEING, axis=1)
        if (strips := np.maximum(within, UNAIMED)).mean() <= 1.0:
            granted, low = strips, middle + 1
        else:
            high = middle
    return granted
