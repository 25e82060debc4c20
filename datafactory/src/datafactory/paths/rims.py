"""Boundaries of planes, in stretches that are looked at as one edge from afar."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from shared.physics.vectors import Index, Real

SAME_POINT_M = 1e-4
STRETCH = 16
"""Edges of a stretch, at most; a rim of no more is one. On munich's ground of 644 edges 8 to 64 are alike, and 4 take
twice as long (a trial script, four frames)."""


class Rim(NamedTuple):
    """The boundary of a plane, in stretches of edges of which each begins where the one before it ends.

    A stretch lies in a ball. Seen from outside the ball it fills the angle of its chord, so that far stretches are
    looked at as one edge each: the ground of a city has hundreds of edges, and a wave meets it near a few.

    :param edges: [E, 2, 3] directed [m], inside on their left
    :param begins: [S + 1] first edge of every stretch, and E
    :param centre: [S, 3] of the balls [m]; :param radius: [S] [m]
    """

    edges: Real
    begins: Index
    centre: Real
    radius: Real

    @staticmethod
    def of(edges: Real) -> Rim:
        """:param edges: [E, 2, 3] in any order"""
        if len(edges) <= STRETCH:  # of one stretch, that is always near
            return Rim(edges, np.array([0, len(edges)]), np.zeros((1, 3)), np.full(1, np.inf))
        edges = edges[_one_after_another(edges)]
        broken = np.abs(edges[1:, 0] - edges[:-1, 1]).max(axis=1) > SAME_POINT_M
        run = np.concatenate([[0], np.cumsum(broken)])
        place = np.arange(len(edges)) - np.searchsorted(run, run)
        begins = np.append(np.flatnonzero(place % STRETCH == 0), len(edges))
        centre, radius = np.zeros((len(begins) - 1, 3)), np.zeros(len(begins) - 1)
        for stretch, (first, last) in enumerate(pairwise(begins)):
            points = edges[first:last].reshape(-1, 3)
            centre[stretch] = 0.5 * (points.min(axis=0) + points.max(axis=0))
            radius[stretch] = np.linalg.norm(points - centre[stretch], axis=1).max()
        return Rim(edges, begins, centre, radius)

    @staticmethod
    def joined(rims: Sequence[Rim]) -> Rim:
        """All stretches of one or more."""
        edges = np.cumsum([0, *(len(rim.edges) for rim in rims)])
        begins = [rim.begins[:-1] + first for rim, first in zip(rims, edges, strict=False)]
        every, _, centre, radius = (np.concatenate(parts) for parts in zip(*rims, strict=True))
        return Rim(every, np.append(np.concatenate(begins), edges[-1]), centre, radius)

    def turned(self) -> Rim:
        """The same, seen from the other side of the plane."""
        begins = len(self.edges) - self.begins[::-1]
        return Rim(self.edges[::-1, ::-1], begins, self.centre[::-1], self.radius[::-1])


def free_edges(edges: Real) -> Real:
    """The directed edges whose reverse is not in the list; doubled triangles count once."""
    start, end = _ends(edges)
    count = 2 * len(edges)
    forward, index = np.unique(start * count + end, return_index=True)
    back = end[index] * count + start[index]
    shared = np.append(forward, -1)[np.searchsorted(forward, back)] == back
    return edges[np.sort(index[(start[index] != end[index]) & ~shared])]


def _ends(edges: Real) -> Index:
    """[2, E] numbers of the points at which edges [E, 2, 3] begin and end."""
    points = np.rint(edges.reshape(-1, 3) / SAME_POINT_M).astype(np.int64)
    order = np.lexsort(points.T)
    number = np.zeros(len(points), dtype=np.int64)
    number[order[1:]] = np.cumsum((points[order[1:]] != points[order[:-1]]).any(axis=1))
    return number.reshape(-1, 2).T


def _one_after_another(edges: Real) -> Index:
    """[E] an order of edges [E, 2, 3] in which most begin where the one before them ends."""
    start, end = _ends(edges).tolist()
    waiting: dict[int, list[int]] = {}
    for edge in reversed(range(len(start))):
        waiting.setdefault(start[edge], []).append(edge)
    order = list[int]()
    for point in start:
        while waiting[point]:
            order.append(waiting[point].pop())
            point = end[order[-1]]
            if not waiting.get(point):
                break
    return np.array(order)
