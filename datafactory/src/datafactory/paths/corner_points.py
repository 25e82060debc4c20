"""The trihedral corners of a scene: points in which three plane faces meet at right angles, found once.

Three faces of which each pair meets at a right angle (:mod:`.planar_faces`) have one point in common. It is a corner of
each of the eight octants around it in which all three faces begin at it. How far a face reaches from the point, in
directions between its two edges, is sampled (:mod:`.free_extent`).
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from datafactory.paths.bodies import Body, bodies_of
from datafactory.paths.columns import DIRECTION, POINT, WHOLE, Placed, counts_of
from datafactory.paths.corner_edges import LEAST_REACH_M
from datafactory.paths.free_extent import flattened, reach_around
from datafactory.paths.merged_scene import MergedScene, found_once, motions_of
from datafactory.paths.planar_faces import PlanarFaces, planar_faces_of
from shared.physics.compiled import compiled
from shared.physics.vectors import Index, Real, unit

DIRECTIONS = 45
"""In which the reach of a face is sampled over a right angle: every two degrees."""
FARTHEST_M = 50.0
"""Triangles that begin farther from the point are not looked at [m]."""


@dataclass(frozen=True)
class CornerPoints(Placed):
    """Q points.

    :param apex: [Q, 3] [m]
    :param axes: [Q, 3, 3] rows: unit vectors along the three edges, away from the apex; face i lies between the others
    :param reach: [Q, 3, N] of face i in the directions (k + 1/2) 90 deg / N from edge i + 1 towards edge i + 2 [m]
    :param off_square: [Q] largest difference of two edges from a right angle [rad]
    :param face_mesh: [Q, 3] index into ``MergedScene.meshes``
    :param object_index: [Q] index into ``MergedScene.objects`` of the first face
    :param counts: ``corner_points``
    """

    apex: Real = field(metadata=POINT)
    axes: Real = field(metadata=DIRECTION)
    reach: Real
    off_square: Real
    face_mesh: Index
    object_index: NDArray[np.int32]
    counts: dict[str, int] = field(metadata=WHOLE, default_factory=dict)

    def within(self, distance_m: float) -> CornerPoints:
        """The points nearer than this to the origin [m]: in the radar frame, those in range."""
        return self.take(np.linalg.norm(self.apex, axis=1) < distance_m)


def points_of(merged_scene: MergedScene) -> CornerPoints:
    """All trihedral corners of a merged scene at its time, found once; those of bodies that turn for each time."""
    found = _found(merged_scene.shapes)
    velocity, shift = motions_of(merged_scene, found.face_mesh[:, 0])
    return replace(found, velocity=velocity, shift=shift)


@found_once
def _found(merged_scene: MergedScene) -> CornerPoints:
    parts = [_of_body(body) for body in bodies_of(merged_scene)]
    return CornerPoints.joined(parts, counts=counts_of([part.counts for part in parts]))


@found_once
def _of_body(body: Body) -> CornerPoints:
    """The corners of one body, of which all three faces are."""
    faces, corners = planar_faces_of(body), body.corners
    triples = np.array(_triples(faces.pairs), dtype=np.int64).reshape(-1, 3)
    apex, edges = _apexes(faces, triples)
    quarters = _quarters(corners, *faces.members(), triples, apex, edges, faces.normal[triples])
    number, signs, reach = _octants(quarters)
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
        velocity=np.zeros((len(number), 3)),
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


def _octants(quarters: Real) -> tuple[Index, Real, Real]:
    """The octants in which three faces meet: number of the triple [Q], signs of its edges [Q, 3], reach of its faces
    [Q, 3, N]. Triple by triple.

    :param quarters: [M, 3, 4, N], see :func:`_quarters`
    """
    reversed_edges = np.array(list(product((0, 1), repeat=3)))  # [8, 3]
    quarter = 2 * np.roll(reversed_edges, -1, axis=1) + np.roll(reversed_edges, -2, axis=1)
    wide = quarters.max(axis=3) >= LEAST_REACH_M
    number, octant = np.nonzero(wide[:, np.arange(3), quarter].all(axis=2))
    reach = quarters[number[:, None], np.arange(3), quarter[octant]]
    return number, 1.0 - 2.0 * reversed_edges[octant], reach


@compiled()
def _quarters(triangles, order, starts, triples, apex, edges, normals):
    """[M, 3, 4, N] reach of each face in the four quarters between its edges: both edges, the second reversed, ..."""
    angles = (np.arange(DIRECTIONS) + 0.5) * 0.5 * np.pi / DIRECTIONS
    result = np.zeros((len(triples), 3, 4, DIRECTIONS))
    for m in range(len(triples)):
        for i in range(3):
            face, one, other = triples[m, i], edges[m, (i + 1) % 3], edges[m, (i + 2) % 3]
            members = order[starts[face] : starts[face + 1]]
            across, sense = np.empty(3), 0.0
            for k in range(3):
                after, last = (k + 1) % 3, (k + 2) % 3
                across[k] = normals[m, i, after] * one[last] - normals[m, i, last] * one[after]
                sense += across[k] * other[k]
            flat = flattened(triangles, members, apex[m], one, across)
            turned = np.empty_like(flat)
            for quarter in range(4):
                for t in range(len(flat)):  # by elements: slices and rows take seconds to compile
                    for c in range(3):
                        turned[t, c, 0] = flat[t, c, 0] * (1.0 - 2.0 * (quarter // 2))
                        turned[t, c, 1] = flat[t, c, 1] * (1.0 - 2.0 * (quarter % 2)) * np.sign(sense)
                reach = reach_around(_near(turned), angles)
                for n in range(DIRECTIONS):
                    result[m, i, quarter, n] = reach[n]
    return result


@compiled(cache=False)
def _near(flat):
    """The triangles of a face that begin near the origin and of which a part may lie in the first quarter."""
    kept = np.empty(len(flat), dtype=np.bool_)
    for t in range(len(flat)):
        kept[t] = True
        for k in range(2):
            kept[t] &= min(flat[t, 0, k], flat[t, 1, k], flat[t, 2, k]) <= FARTHEST_M
            kept[t] &= max(flat[t, 0, k], flat[t, 1, k], flat[t, 2, k]) >= 0.0
    return flat[kept]
