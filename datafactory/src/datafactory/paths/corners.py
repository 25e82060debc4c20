"""The right-angled corners of a scene, found once: edges at which two plane faces meet, points in which three do.

docs/notes/corners.md says what counts. Each quarter of space between two faces that meet at a right angle
(:mod:`.planes`), both of which reach away from the edge, is a corner that sends a wave back; the winding of the
triangles is not used. Along the edge it consists of strips, in each of which the reach of either face is a straight
line (:mod:`.free_extent`). Strips that touch make one corner; beyond a gap another one begins.

Three faces of which each pair meets at a right angle have a point in common: a corner of each of the eight octants
around it in which all three begin. How far a face reaches from it, in directions between its two edges, is sampled.

Faces belong to bodies of one velocity. What stands on another body, such as a car on a road, makes no corner with it.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations, product

import numpy as np
from numpy.typing import NDArray

from datafactory.paths.bodies import Body, bodies_of
from datafactory.paths.columns import DIRECTION, POINT, WHOLE, Placed, one_after_another
from datafactory.paths.free_extent import all_strips, quarters
from datafactory.paths.merged_scene import MergedScene, barycentric, found_once
from datafactory.paths.planes import TOUCH_M, PlanarFaces, planar_faces_of
from shared.physics.vectors import Index, Mask, Real, dots, lengths, unit

LEAST_REACH_M = 0.005
"""Faces that reach less far from the edge, over all of a corner, or from a point, make none: they are narrower than a
wavelength [m]."""


@dataclass(frozen=True)
class CornerEdges(Placed):
    """C corners.

    :param origin: [C, 3] the point of the edge from which strips count [m]
    :param direction: [C, 3] unit vector along the edge
    :param into: [C, 2, 3] unit vectors from the edge into either face, across the edge
    :param normal: [C, 2, 3] unit normals of the faces, into the quarter between them
    :param face: [C, 2] numbers of the faces; :param face_mesh: [C, 2] index into ``MergedScene.meshes``
    :param object_index: [C] index into ``MergedScene.objects`` of the first face
    :param turn: [C, 3] by how much ``velocity``, that of ``origin``, changes for each metre along the edge [1/s]
    :param strips: [S, 6] start and end along the edge, the reach of the first face there, and that of the second [m]
    :param corner_of_strip: [S] rising
    :param face_of_triangle: [T] of the merged scene's triangles; -1 where a triangle has none
    """

    origin: Real = field(metadata=POINT)
    direction: Real = field(metadata=DIRECTION)
    into: Real = field(metadata=DIRECTION)
    normal: Real = field(metadata=DIRECTION)
    face: Index
    face_mesh: Index
    object_index: NDArray[np.int32]
    turn: Real = field(metadata=DIRECTION)
    strips: Real = field(metadata=WHOLE)
    corner_of_strip: Index = field(metadata=WHOLE)
    face_of_triangle: Index = field(metadata=WHOLE)

    @cached_property
    def opening(self) -> Real:
        """[C] psi, the angle between the faces [rad]."""
        return np.arccos(np.clip(dots(self.into[:, 0], self.into[:, 1]), -1.0, 1.0))

    @cached_property
    def foot_z(self) -> Real:
        """[C] place along the edge of the foot of the perpendicular from the origin [m]."""
        return -dots(self.origin, self.direction)

    @cached_property
    def foot(self) -> Real:
        """[C, 3] that foot on the edge's line [m]."""
        return self.origin + self.foot_z[:, None] * self.direction

    @cached_property
    def height(self) -> Real:
        """[C] h, its distance from the origin [m]."""
        return lengths(self.foot)

    @cached_property
    def angle(self) -> Real:
        """[C] phi of the origin from the first face [rad]."""
        towards = -unit(self.foot)
        normal, into = (dots(towards, axes[:, 0]) for axes in (self.normal, self.into))
        return np.arctan2(normal, into)

    @cached_property
    def beside(self) -> Real:
        """[C] how far along the edge the corner begins from the foot [m]; 0 where the foot lies on it."""
        return np.clip(self.foot_z, *self.extent()) - self.foot_z

    def take(self, index: NDArray) -> CornerEdges:
        """The corners at these rising indices, or where a mask is true, with their strips."""
        chosen = np.arange(len(self))[index]
        place = np.full(len(self), -1, dtype=np.int64)
        place[chosen] = np.arange(len(chosen))
        stay = place[self.corner_of_strip] >= 0
        strips, corner_of_strip = self.strips[stay], place[self.corner_of_strip[stay]]
        return replace(super().take(chosen), strips=strips, corner_of_strip=corner_of_strip)

    def velocity_at(self, point: Real) -> Real:
        """[C, 3] of points [C, 3] of the edges [m/s]."""
        return self.velocity + dots(point - self.origin, self.direction)[:, None] * self.turn

    def extent(self) -> tuple[Real, Real]:
        """Start [C] and end [C] of each corner along its edge [m]."""
        low, high = np.full(len(self), np.inf), np.full(len(self), -np.inf)
        np.minimum.at(low, self.corner_of_strip, self.strips[:, 0])
        np.maximum.at(high, self.corner_of_strip, self.strips[:, 1])
        return low, high

    def nearest(self) -> Real:
        """[C, 3] the point of each edge that lies nearest to the origin [m]."""
        return self.foot + self.beside[:, None] * self.direction

    @cached_property
    def _joined_faces(self) -> tuple[Index, int]:
        """Numbers of the pairs of faces that make corners, rising, and what the lower face counts in them."""
        count, pairs = int(self.face_of_triangle.max(initial=-1)) + 1, np.sort(self.face, axis=1)
        return np.sort(pairs[:, 0] * count + pairs[:, 1]), count

    def hold(self, triangles: Index) -> Mask:
        """[n] whether of the faces of triangles [n, m] each pair makes a corner."""
        joined = np.ones(len(triangles), dtype=bool)
        for one, other in combinations(triangles.T, 2):
            joined &= self.joins(one, other)
        return joined

    def joins(self, triangle: Index, other: Index) -> Mask:
        """[n] whether two triangles [n] each belong to the two faces of one corner."""
        known, count = self._joined_faces
        one, two = self.face_of_triangle[triangle], self.face_of_triangle[other]
        low = np.minimum(one, two)
        asked = low * count + np.maximum(one, two)
        place = np.searchsorted(known, asked)
        return (low >= 0) & (np.append(known, -1)[place] == asked)


def corners_of(merged_scene: MergedScene) -> CornerEdges:
    """All corners of a merged scene at its time, found once; those of bodies that turn for each time."""
    found = _found_edges(merged_scene.shapes)
    return found.moving_with(merged_scene, found.face_mesh[:, 0])


@found_once
def _found_edges(merged_scene: MergedScene) -> CornerEdges:
    face_of_triangle = np.full(len(merged_scene.mesh_of_triangle), -1)
    faces, before, placed = 0, 0, []
    for body in bodies_of(merged_scene):
        own = _edges_of_body(body)
        numbers = np.where(own.face_of_triangle >= 0, own.face_of_triangle + faces, -1)
        face_of_triangle[body.source] = numbers
        face_of_triangle[body.doubles[:, 0]] = numbers[body.doubles[:, 1]]  # a double is of the face that it lies on
        placed.append(replace(own, face=own.face + faces, corner_of_strip=own.corner_of_strip + before))
        faces += int(own.face_of_triangle.max(initial=-1)) + 1
        before += len(own)
    return CornerEdges.of_bodies(
        placed,
        strips=one_after_another([own.strips for own in placed]),
        corner_of_strip=one_after_another([own.corner_of_strip for own in placed]),
        face_of_triangle=face_of_triangle,
    )


@found_once
def _edges_of_body(body: Body) -> CornerEdges:
    """The corners of one body, whose faces and triangles count from 0."""
    faces, triangles = planar_faces_of(body), body.corners
    origin, along, across = _lines(faces, triangles)
    pieces, pair, sides = all_strips(
        triangles, *faces.members(), faces.pairs, origin, along, np.ascontiguousarray(across)
    )
    into = across[pair] * sides[:, :, None]
    # The strips count along into_0 x into_1.
    turned = dots(np.cross(into[:, 0], into[:, 1]), along[pair]) < 0.0
    pieces[turned] = np.stack([-pieces[turned, 1], -pieces[turned, 0], *pieces[turned][:, [3, 2, 5, 4]].T], axis=1)
    corner_of_strip, lead = _runs(pair, sides, pieces, turned)
    wide = np.zeros(len(lead), dtype=bool)
    np.logical_or.at(wide, corner_of_strip, np.minimum(pieces[:, 2:4], pieces[:, 4:6]).max(axis=1, initial=0.0)
                     >= LEAST_REACH_M)  # fmt: skip
    stay = wide[corner_of_strip]
    pieces, corner_of_strip, lead = pieces[stay], (np.cumsum(wide) - 1)[corner_of_strip[stay]], lead[wide]
    pair, into, origin = pair[lead], into[lead], origin[pair[lead]]
    normal = unit(into[:, ::-1] - dots(into[:, 0], into[:, 1])[:, None, None] * into)
    contact, direction = faces.contact[pair], unit(np.cross(into[:, 0], into[:, 1]))
    velocity, further = (_carried(body, contact[:, 0], point) for point in (origin, origin + direction))
    return CornerEdges(
        origin=origin,
        direction=direction,
        into=into,
        normal=normal,
        face=faces.pairs[pair],
        face_mesh=body.mesh[contact],
        object_index=body.owner[contact[:, 0]],
        velocity=velocity,
        turn=further - velocity,
        shift=np.zeros((len(lead), 3)),
        strips=pieces,
        corner_of_strip=corner_of_strip,
        face_of_triangle=faces.of_triangle,
        counts={"right_angles": len(faces.pairs), "corner_edges": len(lead)},
    )


def _carried(body: Body, triangle: Index, point: Real) -> Real:
    """[n, 3] velocities of points [n, 3] in the planes of a body's triangles [n], of what turns [m/s]."""
    weights = barycentric(body.corners[triangle], point)
    return np.einsum("nc,nci->ni", weights, body.velocities[body.triangles[triangle]])


def _lines(faces: PlanarFaces, triangles: Real) -> tuple[Real, Real, Real]:
    """Of each pair of faces the line in which they meet: a point [P, 3], its direction [P, 3], and the unit vectors
    across it in either face [P, 2, 3].

    The point is the one nearest to where the faces touch. The planes' heights are measured from there.
    """
    normals, centres = faces.normal[faces.pairs], faces.centre[faces.pairs]
    along = unit(np.cross(normals[:, 0], normals[:, 1]))
    near = triangles[faces.contact[:, 0]].mean(axis=1)
    heights = np.einsum("pfi,pfi->pf", normals, centres - near[:, None])
    rows = np.concatenate([normals, along[:, None]], axis=1)
    off = np.linalg.solve(rows, np.pad(heights, ((0, 0), (0, 1)))[..., None])[..., 0]
    return near + off, along, np.cross(normals, along[:, None])


def _runs(pair: Index, sides: Real, pieces: Real, turned: Mask) -> tuple[Index, Index]:
    """Number of the corner of each strip [S], and the first strip of each corner: strips without gaps along the edge.

    Strips come pair by pair and quarter by quarter, in order along the line; ``turned`` ones in the reverse order.
    """
    if not len(pair):
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    gap = np.where(turned[1:], pieces[:-1, 0] - pieces[1:, 1], pieces[1:, 0] - pieces[:-1, 1])
    begins = np.append(True, (np.diff(pair) != 0) | (np.diff(sides, axis=0) != 0.0).any(axis=1) | (gap > TOUCH_M))
    return np.cumsum(begins) - 1, np.flatnonzero(begins)


@dataclass(frozen=True)
class CornerPoints(Placed):
    """Q points.

    :param apex: [Q, 3] [m]
    :param axes: [Q, 3, 3] rows: unit vectors along the three edges, away from the apex; face i lies between the others
    :param reach: [Q, 3, N] of face i in the directions (k + 1/2) 90 deg / N from edge i + 1 towards edge i + 2 [m]
    :param off_square: [Q] largest difference of two edges from a right angle [rad]
    :param face_mesh: [Q, 3] index into ``MergedScene.meshes``
    :param object_index: [Q] index into ``MergedScene.objects`` of the first face
    """

    apex: Real = field(metadata=POINT)
    axes: Real = field(metadata=DIRECTION)
    reach: Real
    off_square: Real
    face_mesh: Index
    object_index: NDArray[np.int32]

    def nearest(self) -> Real:
        """[Q, 3] the points themselves."""
        return self.apex


def points_of(merged_scene: MergedScene) -> CornerPoints:
    """All trihedral corners of a merged scene at its time, found once; those of bodies that turn for each time."""
    found = _found_points(merged_scene.shapes)
    return found.moving_with(merged_scene, found.face_mesh[:, 0])


@found_once
def _found_points(merged_scene: MergedScene) -> CornerPoints:
    return CornerPoints.of_bodies([_points_of_body(body) for body in bodies_of(merged_scene)])


@found_once
def _points_of_body(body: Body) -> CornerPoints:
    """The corners of one body, of which all three faces are."""
    faces, corners = planar_faces_of(body), body.corners
    triples = np.array(_triples(faces.pairs), dtype=np.int64).reshape(-1, 3)
    apex, edges = _apexes(faces, triples)
    around = quarters(corners, *faces.members(), triples, apex, edges, faces.normal[triples])
    number, signs, reach = _octants(around)
    contact = {tuple(pair): triangles for pair, triangles in zip(faces.pairs.tolist(), faces.contact, strict=True)}
    # Of each face the triangle at its edge with the next: (a, b) -> a, (b, c) -> b, (a, c) -> c.
    triangle = np.array(
        [[contact[a, b][0], contact[b, c][0], contact[a, c][1]] for a, b, c in triples[number].tolist()],
        dtype=np.int64,
    ).reshape(-1, 3)
    axes = signs[:, :, None] * edges[number]
    between = np.abs(np.einsum("qij,qij->qi", axes, np.roll(axes, 1, axis=1))).max(axis=1, initial=0.0)
    return CornerPoints(
        apex=apex[number],
        axes=axes,
        reach=reach,
        off_square=np.arcsin(np.minimum(between, 1.0)),
        face_mesh=body.mesh[triangle],
        object_index=body.owner[triangle[:, 0]],
        velocity=_carried(body, triangle[:, 0], apex[number]),
        shift=np.zeros((len(number), 3)),
        counts={"corner_points": len(number)},
    )


def _triples(pairs: Index) -> list[tuple[int, int, int]]:
    """Faces a < b < c of which each pair meets."""
    above = defaultdict(set)
    for one, other in pairs.tolist():
        above[one].add(other)
    return [(a, b, c) for a in sorted(above) for b in sorted(above[a]) for c in sorted(above[a] & above.get(b, set()))]


def _apexes(faces: PlanarFaces, triples: Index) -> tuple[Real, Real]:
    """The points [M, 3] in which three faces meet, and unit vectors [M, 3, 3] along the edges opposite to each face."""
    normal, centre = faces.normal[triples], faces.centre[triples]
    heights = np.einsum("mfi,mfi->mf", normal, centre - centre[:, :1])
    edges = np.cross(np.roll(normal, -1, axis=1), np.roll(normal, -2, axis=1))
    return centre[:, 0] + np.linalg.solve(normal, heights[..., None])[..., 0], unit(edges)


def _octants(around: Real) -> tuple[Index, Real, Real]:
    """The octants in which three faces meet: number of the triple [Q], signs of its edges [Q, 3], reach of its faces
    [Q, 3, N]. Triple by triple.

    :param around: [M, 3, 4, N], see :func:`.free_extent.quarters`
    """
    reversed_edges = np.array(list(product((0, 1), repeat=3)))  # [8, 3]
    quarter = 2 * np.roll(reversed_edges, -1, axis=1) + np.roll(reversed_edges, -2, axis=1)
    wide = around.max(axis=3) >= LEAST_REACH_M
    number, octant = np.nonzero(wide[:, np.arange(3), quarter].all(axis=2))
    reach = around[number[:, None], np.arange(3), quarter[octant]]
    return number, 1.0 - 2.0 * reversed_edges[octant], reach
