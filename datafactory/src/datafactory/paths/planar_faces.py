"""Plane faces of a body, and which of them meet at a right angle.

Triangles that lie in one plane and touch form one face, however the plane is cut. A face may be of several meshes. Two
faces meet where a triangle of one and a triangle of the other reach the line in which their planes intersect, within
``TOUCH_M``, over a common piece of it. So a wall meets the ground whether they share vertices, stand on each other or
cross. All tests compare neighbouring triangles alone, so that a scene may lie far from its origin.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from datafactory.paths.bodies import Body, components
from datafactory.paths.merged_scene import found_once
from datafactory.paths.rims import COPLANAR_COSINE, COPLANAR_M, height_over
from shared.physics.compiled import compiled
from shared.physics.vectors import Index, Real

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
    label[np.abs(np.einsum("ki,ki->k", normals, normal[label])) < SAME_FACE_COSINE] = -1
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
    side = np.sign(np.einsum("ki,ki->k", normals, normals[lead][label]))
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
