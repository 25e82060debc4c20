"""The planes in which a body's triangles lie, and their boundaries, in stretches that are looked at as one from afar.

Triangles lie in the plane of another one whether they touch or not: slats of one blind are one mirror.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from hashlib import sha256
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from datafactory.paths.bodies import Body
from datafactory.paths.merged_scene import found_once
from shared.physics.compiled import compiled
from shared.physics.vectors import Index, Real

COPLANAR_COSINE = np.cos(np.radians(0.2))
COPLANAR_M = 1e-3
"""Of one plane are triangles with normals parallel within 0.2 deg and corners within 1 mm of it [m]: room for what
modelling tools round, chosen and not measured."""
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
    def of(vertices: Real, ends: Index) -> Rim:
        """:param vertices: [V, 3] [m]; :param ends: [E, 2] vertices of the edges, in any order"""
        if len(ends) <= STRETCH:  # of one stretch, that is always near
            return Rim(vertices[ends], np.array([0, len(ends)]), np.zeros((1, 3)), np.full(1, np.inf))
        ends = ends[_one_after_another(ends)]
        edges = vertices[ends]
        run = np.concatenate([[0], np.cumsum(ends[1:, 0] != ends[:-1, 1])])
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


@dataclass(frozen=True, eq=False)
class Planes:
    """The planes of a body's triangles; the boundary of each is found once, on first use."""

    body: Body
    _of_triangle: dict[int, tuple[Rim, Real]] = field(default_factory=dict, repr=False)
    _of_members: dict[bytes, tuple[Rim, Real]] = field(default_factory=dict, repr=False)

    def rim(self, triangle: int, origin: Real, normal: Real) -> tuple[Rim, Real]:
        """The boundary of all that lies in the plane of a triangle, and the normal [3] of the side it is seen from.

        :param triangle: among all of the scene's; :param origin: [3] its first corner [m]; :param normal: [3] unit
        """
        if triangle not in self._of_triangle:
            body = self.body
            members = _coplanar(body.corners, body.normals, origin, normal)
            plane = sha256(members.tobytes()).digest()  # the members of a ground are a key of some hundred kilobytes
            if plane not in self._of_members:
                side = body.normals[members[:1]].sum(axis=0)
                away = body.normals[members] @ side < 0.0
                wound = np.where(away[:, None], body.triangles[members, ::-1], body.triangles[members])
                self._of_members[plane] = Rim.of(body.vertices, free_edges(wound)), side
            self._of_triangle[triangle] = self._of_members[plane]
        return self._of_triangle[triangle]


@found_once
def planes_of(body: Body) -> Planes:
    """The planes of a body, none of whose boundaries is known yet."""
    return Planes(body)


def free_edges(triangles: Index) -> Index:
    """[E, 2] the directed sides of triangles [T, 3] whose reverse is no side of another one."""
    start, end = triangles.reshape(-1), np.roll(triangles, -1, axis=1).reshape(-1)
    count = int(start.max(initial=0)) + 1
    forward, index = np.unique(start * count + end, return_index=True)
    back = end[index] * count + start[index]
    shared = np.append(forward, -1)[np.searchsorted(forward, back)] == back
    free = np.sort(index[~shared])
    return np.stack([start[free], end[free]], axis=1)


@compiled()
def _coplanar(corners, normals, origin, normal):
    """The triangles, rising, that lie in a plane."""
    found, count = np.empty(len(corners), np.int64), 0
    for t in range(len(corners)):
        cosine = normals[t, 0] * normal[0] + normals[t, 1] * normal[1] + normals[t, 2] * normal[2]
        if abs(cosine) > COPLANAR_COSINE and height_over(corners[t], origin, normal) < COPLANAR_M:
            found[count] = t
            count += 1
    return found[:count].copy()


@compiled(cache=False)
def height_over(triangle, origin, normal):
    """Largest distance of a triangle's corners from a plane."""
    largest = 0.0
    for c in range(3):
        height = 0.0
        for k in range(3):
            height += (triangle[c, k] - origin[k]) * normal[k]
        largest = max(largest, abs(height))
    return largest


def _one_after_another(ends: Index) -> Index:
    """[E] an order of edges between vertices [E, 2] in which most begin where the one before them ends."""
    start, end = ends.T.tolist()
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
