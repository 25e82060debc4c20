"""Lanes: lines along a scene's streets that a car could follow, drawn from its free ground.

No map says where the streets of a mesh run. A way that keeps to where there is most room runs along their middle: the
cheapest way over the grid of free ground, where a metre costs more the nearer its side is. Ways that are drawn one by
one so share their middle lines, and a lane on the right of each keeps those who meet apart (right-hand traffic).

A :class:`Lane` is a line on the ground with a direction, and says nothing of time.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from datafactory.scenes.ground import Ground
from datafactory.scenes.motion import Real
from datafactory.scenes.streets import Mask

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline

GRID_M = 1.0
"""Ways are sought on cells of this side or a little more: finer ground is taken in strides."""
WIDE_M = 8.0
"""Where the side is this far, a metre costs twice as much as in the open."""
MIDDLE_SHARE = 0.9
MIDDLE_REACH_M = 6.0
"""A cell is in the middle of its street if nowhere within this reach there is more than 1 / 0.9 of its room."""
LANE_OFFSET_M = 1.75
"""Of a lane from the middle line, to the right: half of a lane 3.5 m wide. Half of the room, where that is less."""
STEP_M = 0.5
"""Between the points of a lane."""
SMOOTHING_M = 5.0
"""Standard deviation of the mean that rounds the grid's corners; a street corner of 90 deg is then 8 m in radius."""
WAYS_TRIED = 6
STARTS_TRIED = 12


@dataclass(frozen=True, eq=False)
class Lane:
    """A line to drive along, in this direction.

    :param points: [n, 2] world x, y [m], about ``STEP_M`` apart, smooth
    """

    points: Real

    @cached_property
    def distance_m(self) -> Real:
        """[n] way driven from the first point to each [m]."""
        steps = np.hypot(*np.diff(self.points, axis=0).T)
        return np.concatenate([[0.0], np.cumsum(steps)])

    @property
    def length_m(self) -> float:
        return float(self.distance_m[-1])

    def course(self, beside: Real | None = None) -> CubicSpline:
        """The line that is driven, by the way from the first point [m]: x, y, and values [n, k] ``beside`` them."""
        from scipy.interpolate import CubicSpline  # where needed: it takes a fifth of a second

        values = self.points if beside is None else np.column_stack([self.points, beside])
        return CubicSpline(self.distance_m, values)

    @cached_property
    def curvature(self) -> Real:
        """[n] rate of turn of the line that is driven, positive to the left [rad/m]."""
        course = self.course()
        (x, y), (turning_x, turning_y) = course(self.distance_m, 1).T, course(self.distance_m, 2).T
        bend: Real = (x * turning_y - y * turning_x) / np.hypot(x, y) ** 3
        return bend


def draw_lane(ground: Ground, length_m: float, rng: np.random.Generator, allowed: Mask | None = None) -> Lane | None:
    """Draw a lane along the streets of a scene's free ground.

    It starts in the middle of a street, goes to a drawn place along the middle of the streets between, and keeps to
    their right side. Every point lies on an allowed cell.

    :param length_m: wanted [m]; the longest that was found is taken where none is as long
    :param rng: the same state draws the same lane
    :param allowed: [nx, ny] cells it may use, by default all free ground
    :returns: None where the cells are too scattered for a lane of 2 m
    """
    allowed = ground.free if allowed is None else allowed & ground.free
    stride = max(1, round(GRID_M / ground.cell_m))
    used, side_m = allowed[::stride, ::stride], stride * ground.cell_m
    longest: Lane | None = None
    # The middle of a street; where the allowed cells do not hold it, their own.
    for free in (ground.free, allowed):
        room = _room(free, ground.cell_m)
        centre = used & _middle(room[::stride, ::stride], side_m)
        middle, grid = np.argwhere(centre), np.where(used, room[::stride, ::stride], 0.0)
        for _ in range(STARTS_TRIED if len(middle) else 0):
            start = middle[rng.integers(len(middle))]
            for way in _ways(grid, centre, side_m, start, length_m, rng):
                lane = _lane_along(way * stride, ground, allowed, room, length_m)
                if lane is not None and (longest is None or lane.length_m > longest.length_m):
                    longest = lane
                if longest is not None and longest.length_m >= length_m:
                    return longest
        if longest is not None:
            break
    return longest


def _room(free: Mask, cell_m: float) -> Real:
    """[nx, ny] distance from each free cell's centre to the nearest that is not [m]; beyond the grid is none."""
    padded = np.pad(free, 1)
    return np.asarray(ndimage.distance_transform_edt(padded)[1:-1, 1:-1] * cell_m)


def _middle(room: Real, side_m: float) -> Mask:
    """Cells in the middle of a street."""
    reach = 2 * max(1, round(MIDDLE_REACH_M / side_m)) + 1
    return (room > 0.0) & (room >= MIDDLE_SHARE * ndimage.maximum_filter(room, size=reach))


def _ways(
    room: Real, centre: Mask, side_m: float, start: NDArray[np.int64], length_m: float, rng: np.random.Generator
) -> list[Real]:
    """Ways [n, 2] in cells from a start to drawn places in the middle of streets, at least as far as is wanted.

    :param room: [nx, ny] of the cells that may be used, 0 for all others
    :param centre: [nx, ny] those in the middle of a street
    """
    reach = int(np.ceil(1.5 * length_m / side_m)) + 2
    corner = np.maximum(start - reach, 0)
    cut = tuple(slice(low, at + reach + 1) for low, at in zip(corner, start, strict=True))
    window = room[cut]
    begin = int(np.ravel_multi_index(tuple(start - corner), window.shape))
    cost, before = dijkstra(_neighbours(window, side_m), indices=begin, return_predecessors=True)
    ends = np.flatnonzero(centre[cut].ravel() & np.isfinite(cost))
    # A metre costs at least one: what costs less than the length is nearer than it.
    far = ends[cost[ends] >= length_m]
    if not len(far):
        far = ends[cost[ends] >= 0.5 * cost[ends].max(initial=0.0)]
    chosen = rng.permutation(far)[:WAYS_TRIED]
    return [_traced_back(before, int(end), window.shape) + corner for end in chosen if end != begin]


def _neighbours(room: Real, side_m: float) -> csr_array:
    """What a step to each of the eight neighbours costs, between cells that have room."""
    cells = np.arange(room.size).reshape(room.shape)
    rows, columns, costs = [], [], []
    for shift in ((0, 1), (1, 0), (1, 1), (1, -1)):
        here = tuple(slice(max(0, -by), size - max(0, by)) for by, size in zip(shift, room.shape, strict=True))
        there = tuple(slice(max(0, by), size - max(0, -by)) for by, size in zip(shift, room.shape, strict=True))
        both = (room[here] > 0.0) & (room[there] > 0.0)
        narrow = np.minimum(room[here], room[there])[both]
        cost = side_m * float(np.hypot(*shift)) * (1.0 + WIDE_M / narrow)
        one, other = cells[here][both], cells[there][both]
        rows += [one, other]
        columns += [other, one]
        costs += [cost, cost]
    shape = (room.size, room.size)
    return csr_array((np.concatenate(costs), (np.concatenate(rows), np.concatenate(columns))), shape=shape)


def _traced_back(before: NDArray[np.int32], end: int, shape: tuple[int, ...]) -> Real:
    """[n, 2] cells from the start to an end, by each cell's predecessor."""
    found = [end]
    while (previous := int(before[found[-1]])) >= 0:
        found.append(previous)
    return np.stack(np.unravel_index(found[::-1], shape), axis=1).astype(np.float64)


def _lane_along(way: Real, ground: Ground, allowed: Mask, room: Real, length_m: float) -> Lane | None:
    """The right lane of a way [n, 2] in cells, as far as it stays on allowed cells; None if that is less than 2 m."""
    if len(way) < 3:
        return None
    middle = smoothed(_even(np.asarray(ground.origin) + (way + 0.5) * ground.cell_m), SMOOTHING_M)
    if len(middle) < 5:
        return None
    along = np.gradient(middle, axis=0)
    right = np.stack([along[:, 1], -along[:, 0]], axis=1) / np.maximum(np.hypot(*along.T), 1e-9)[:, None]
    here = ground.values_at(room, *middle.T)
    offset = ndimage.gaussian_filter1d(np.minimum(LANE_OFFSET_M, 0.5 * here), SMOOTHING_M / STEP_M, mode="nearest")
    points = _even(middle + offset[:, None] * right)
    good = ground.values_at(allowed, *points.T)
    points = points if good.all() else points[: int(np.argmin(good))]
    points = points[: int(np.ceil(length_m / STEP_M)) + 2]
    return Lane(points) if len(points) > 2.0 / STEP_M else None


def _even(points: Real) -> Real:
    """The same line with a point every ``STEP_M``."""
    line = Lane(points)
    at = np.arange(0.0, line.length_m, STEP_M)
    return np.stack([np.interp(at, line.distance_m, points[:, axis]) for axis in (0, 1)], axis=1)


def smoothed(points: Real, deviation_m: float) -> Real:
    """Values [n, k] along a line with a point every ``STEP_M``, smoothed by a Gaussian of this standard deviation.

    Beyond the ends they go on as straight as they came, so that the ends keep value and slope.
    """
    pad = int(4.0 * deviation_m / STEP_M)
    if len(points) < 2:
        return points
    # Point reflection at each end: value and direction are kept.
    index = np.arange(-pad, len(points) + pad)
    last = len(points) - 1
    folded = np.abs(index)
    folded = np.clip(np.where(folded > last, 2 * last - folded, folded), 0, last)
    extended = points[folded]
    extended[index < 0] = 2.0 * points[0] - extended[index < 0]
    extended[index > last] = 2.0 * points[last] - extended[index > last]
    return np.asarray(ndimage.gaussian_filter1d(extended, deviation_m / STEP_M, axis=0)[pad : pad + len(points)])
