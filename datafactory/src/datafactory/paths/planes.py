"""The planes of a body's triangles: their boundaries, the faces in them, and which of these meet at a right angle.

Triangles lie in the plane of another one whether they touch or not: slats of one blind are one mirror. Its boundary
comes in stretches that are looked at as one from afar. Triangles of one plane that touch form one face, however it is
cut and of however many meshes. Two faces meet where a triangle of either reaches the line in which their planes
intersect, within ``TOUCH_M``, over a common piece of it: a wall meets the ground whether they share vertices, stand on
each other or cross. All tests compare neighbouring triangles alone, so that a scene may lie far from its origin.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from hashlib import sha256
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from datafactory.paths.bodies import Body, components
from datafactory.paths.merged_scene import found_once
from shared.physics.compiled import compiled
from shared.physics.vectors import Index, Real, dots

COPLANAR_COSINE = np.cos(np.radians(0.2))
COPLANAR_M = 1e-3
"""Of one plane are triangles with normals parallel within 0.2 deg and corners within 1 mm of it [m]: room for what
modelling tools round, chosen and not measured."""
STRETCH = 16
"""Edges of a stretch, at most; a rim of no more is one. On munich's ground of 644 edges 8 to 64 are alike, and 4 take
twice as long (a trial script, four frames)."""
TOUCH_M = 0.01
"""Faces that end nearer than this to the line in which their planes meet reach it [m]: a wall that hovers 1 cm over the
road loses no more than the strip of 1 cm at its foot.
"""
OFF_SQUARE_DEG = 3.0
"""Largest difference from a right angle of two faces that make a corner [deg]. See :mod:`.corner_echoes`."""
LEAST_CONTACT_M = 1e-4
"""Triangles that share a shorter piece of the line have a point in common, at most [m]."""
SAME_FACE_COSINE = np.cos(np.radians(1.0))
"""Triangles whose normal is farther off that of their face are left out of it: the face is a chain that bends."""


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


@dataclass(frozen=True)
class PlanarFaces:
    """F faces, and P pairs of faces that meet at a right angle.

    :param of_triangle: [T] face of each triangle of the body; -1 where it has none
    :param normal: [F, 3] unit; :param centre: [F, 3] a point of the plane, world [m] at time 0
    :param pairs: [P, 2] faces, each pair once, the smaller number first
    :param contact: [P, 2] of either face the triangle with the longest contact
    """

    of_triangle: Index
    normal: Real
    centre: Real
    pairs: Index
    contact: Index

    def members(self) -> tuple[Index, Index]:
        """The triangles, face by face, and where each face begins among them [F + 1]."""
        order = np.argsort(self.of_triangle, kind="stable")
        return order, np.searchsorted(self.of_triangle[order], np.arange(len(self.normal) + 1))


@found_once
def planar_faces_of(body: Body) -> PlanarFaces:
    """The faces of a body, found once."""
    corners, normals, area = body.corners, body.normals, np.linalg.norm(body.areas, axis=1)
    together, square, length = _neighbours(corners, normals, area)
    label = components(len(corners), together)
    normal, centre = _planes(label, corners, normals, area)
    label[np.abs(dots(normals, normal[label])) < SAME_FACE_COSINE] = -1
    return PlanarFaces(label, normal, centre, *_face_pairs(label, square, length))


def _neighbours(corners: Real, normals: Real, area: Real) -> tuple[Index, Index, Real]:
    """Pairs of triangles in one plane [A, 2], pairs that meet at a right angle [B, 2], and their contact [B] [m]."""
    if not len(corners):
        return np.zeros((0, 2), np.int64), np.zeros((0, 2), np.int64), np.zeros(0)
    box = np.stack([corners.min(axis=1) - 0.5 * TOUCH_M, corners.max(axis=1) + 0.5 * TOUCH_M], axis=1)
    axis = int(np.argmax(np.std(box[:, 0], axis=0)))
    order = np.argsort(box[:, 0, axis], kind="stable")
    first, second, contact = _sweep(corners, normals, area, box, order, axis, np.sin(np.radians(OFF_SQUARE_DEG)))
    pairs = np.stack([first, second], axis=1)
    square = contact > 0.0
    return pairs[~square], pairs[square], contact[square]


def _planes(label: Index, corners: Real, normals: Real, area: Real) -> tuple[Real, Real]:
    """Normals and centres of the faces, weighted with the triangles' areas."""
    count = int(label.max(initial=-1)) + 1
    lead = np.zeros(count, dtype=np.int64)
    order = np.argsort(area, kind="stable")
    lead[label[order]] = order  # the largest triangle is written last
    side = np.sign(dots(normals, normals[lead][label]))
    origin = corners[lead, 0]
    normal, centre = np.zeros((2, count, 3))
    np.add.at(normal, label, (side * area)[:, None] * normals)
    np.add.at(centre, label, area[:, None] * (corners.mean(axis=1) - origin[label]))
    total = np.bincount(label, area, count)[:, None]
    return normal / np.linalg.norm(normal, axis=1, keepdims=True), origin + centre / total


def _face_pairs(label: Index, square: Index, length: Real) -> tuple[Index, Index]:
    """Pairs of faces and of either the triangle with the longest contact; ties go to the first triangles."""
    faces = label[square].reshape(-1, 2)
    known = (faces >= 0).all(axis=1) & (faces[:, 0] != faces[:, 1])
    faces, square, length = faces[known], square[known], length[known]
    turned = faces[:, 0] > faces[:, 1]
    faces[turned], square[turned] = faces[turned, ::-1], square[turned, ::-1]
    order = np.lexsort((square[:, 1], square[:, 0], -length, faces[:, 1], faces[:, 0]))
    faces, square = faces[order], square[order]
    pairs, first = np.unique(faces, axis=0, return_index=True)
    return pairs.reshape(-1, 2), square[first].reshape(-1, 2)


@compiled()
def _sweep(corners, normals, area, box, order, axis, off_square):
    """Neighbours among triangles whose boxes overlap: [N] first, [N] second, [N] contact, 0 for those of one plane.

    :param box: [T, 2, 3] least and largest coordinates; :param order: [T] by the least along ``axis``
    """
    first, second, contact = [0], [0], [0.0]
    for p in range(len(order)):
        i = order[p]
        for q in range(p + 1, len(order)):
            j = order[q]
            if box[j, 0, axis] > box[i, 1, axis]:
                break
            apart = False
            for k in range(3):
                apart |= box[j, 0, k] > box[i, 1, k] or box[i, 0, k] > box[j, 1, k]
            if apart:
                continue
            cosine = normals[i, 0] * normals[j, 0] + normals[i, 1] * normals[j, 1] + normals[i, 2] * normals[j, 2]
            if abs(cosine) > COPLANAR_COSINE:
                large, small = (i, j) if area[i] >= area[j] else (j, i)
                if height_over(corners[small], corners[large, 0], normals[large]) < COPLANAR_M:
                    first.append(i)
                    second.append(j)
                    contact.append(0.0)
            elif abs(cosine) <= off_square:
                length = _contact(corners[i], normals[i], corners[j], normals[j], cosine)
                if length > LEAST_CONTACT_M:
                    first.append(i)
                    second.append(j)
                    contact.append(length)
    return np.array(first[1:]), np.array(second[1:]), np.array(contact[1:])


@compiled(cache=False)
def _contact(one, normal_one, other, normal_other, cosine):
    """Length of the common piece of the line in which two triangles' planes meet that both reach; 0 without one.

    With heights d and d' of the planes over an origin and c = n . n', the line passes through
    ((d - d' c) n + (d' - d c) n') / (1 - c^2).
    """
    height = 0.0  # of the other plane over a corner of the first triangle, whose own plane has 0
    for k in range(3):
        height += (other[0, k] - one[0, k]) * normal_other[k]
    point, along = np.empty(3), np.empty(3)
    for k in range(3):
        point[k] = one[0, k] + height * (normal_other[k] - cosine * normal_one[k]) / (1.0 - cosine * cosine)
        after, last = (k + 1) % 3, (k + 2) % 3
        along[k] = normal_one[after] * normal_other[last] - normal_one[last] * normal_other[after]
    along /= np.sqrt(1.0 - cosine * cosine)
    low, high = _reached(one, point, along, normal_one)
    low_other, high_other = _reached(other, point, along, normal_other)
    return max(min(high, high_other) - max(low, low_other), 0.0)


@compiled(cache=False)
def _reached(triangle, point, along, normal):
    """From where to where along a line in its plane a triangle comes nearer than ``TOUCH_M``; (inf, -inf) without."""
    z, away = np.zeros(3), np.zeros(3)
    for c in range(3):
        for k in range(3):
            after, last = (k + 1) % 3, (k + 2) % 3
            off = triangle[c, k] - point[k]
            z[c] += off * along[k]
            away[c] += off * (along[after] * normal[last] - along[last] * normal[after])
    low, high = np.inf, -np.inf
    for c in range(3):
        d = (c + 1) % 3
        start, stop = 0.0, 1.0
        slope = away[d] - away[c]
        if slope == 0.0:
            if abs(away[c]) > TOUCH_M:
                continue
        else:
            enter, leave = (-TOUCH_M - away[c]) / slope, (TOUCH_M - away[c]) / slope
            start, stop = max(min(enter, leave), 0.0), min(max(enter, leave), 1.0)
            if start > stop:
                continue
        for share in (start, stop):
            here = z[c] + share * (z[d] - z[c])
            low, high = min(low, here), max(high, here)
    return low, high
