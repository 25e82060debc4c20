"""The trihedral corners of a scene: points in which three plane faces meet at right angles, found once.

Three faces of which each pair meets at a right angle (:mod:`.planar_faces`) have one point in common. It is a corner of
each of the eight octants around it in which all three faces begin at it. How far a face reaches from the point, in
directions between its two edges, is sampled (:mod:`.free_extent`).
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field, fields, replace
from functools import lru_cache
from itertools import product

import numpy as np
from numpy.typing import NDArray

from datafactory.paths.facets import mirrors_of
from datafactory.paths.free_extent import reach_around
from datafactory.paths.merged_scene import MergedScene, motions_of
from datafactory.paths.planar_faces import PlanarFaces, planar_faces_of
from datafactory.scenes.poses import Pose

Real = NDArray[np.float64]
Index = NDArray[np.int64]

DIRECTIONS = 90
"""In which the reach of a face is sampled over a right angle: every degree."""
LEAST_REACH_M = 0.005
"""Faces that reach less far make no corner: they are narrower than a wavelength [m]."""
FARTHEST_M = 50.0
"""Triangles that begin farther from the point are not looked at [m]."""


@dataclass(frozen=True)
class CornerPoints:
    """Q points. In world coordinates at time 0 as :func:`points_of` finds them, in the radar's after :meth:`seen_from`.

    :param apex: [Q, 3] [m]
    :param axes: [Q, 3, 3] rows: unit vectors along the three edges, away from the apex; face i lies between the others
    :param reach: [Q, 3, N] of face i in the directions (k + 1/2) 90 deg / N from edge i + 1 towards edge i + 2 [m]
    :param off_square: [Q] largest difference of two edges from a right angle [rad]
    :param face_mesh: [Q, 3] index into ``MergedScene.meshes``
    :param object_index: [Q] index into ``MergedScene.objects`` of the first face
    :param velocity: [Q, 3] [m/s]
    :param shift: [Q, 3] what is to be added to the points [m]: the displacement of a body that does not turn
    :param counts: ``corner_points``
    """

    apex: Real
    axes: Real
    reach: Real
    off_square: Real
    face_mesh: Index
    object_index: NDArray[np.int32]
    velocity: Real
    shift: Real
    counts: dict[str, int] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.apex)

    def take(self, index: NDArray) -> CornerPoints:
        """The points at these indices, or where a mask is true."""
        kept = {item.name: getattr(self, item.name)[index] for item in fields(self) if item.name != "counts"}
        return CornerPoints(**kept, counts=self.counts)

    def seen_from(self, pose: Pose) -> CornerPoints:
        """The same points in the radar frame at the pose's time, velocities relative to the radar."""
        rotation = pose.rotation()
        return replace(
            self,
            apex=(self.apex + self.shift - np.asarray(pose.position)) @ rotation,
            shift=np.zeros_like(self.shift),
            axes=self.axes @ rotation,
            velocity=(self.velocity - np.asarray(pose.velocity)) @ rotation,
        )

    def within(self, distance_m: float) -> CornerPoints:
        """The points nearer than this to the origin [m]: in the radar frame, those in range."""
        return self.take(np.linalg.norm(self.apex, axis=1) < distance_m)


@lru_cache(maxsize=8)
def points_of(merged_scene: MergedScene) -> CornerPoints:
    """All trihedral corners of a merged scene at its time, found once; where something turns, for each time."""
    at_rest = merged_scene.at_rest
    found = points_of(at_rest) if at_rest is not None and not merged_scene.turns else _found(merged_scene)
    velocity, shift = motions_of(merged_scene, found.face_mesh[:, 0])
    return replace(found, velocity=velocity, shift=shift)


def _found(merged_scene: MergedScene) -> CornerPoints:
    faces, corners = planar_faces_of(merged_scene), mirrors_of(merged_scene).corners
    members = faces.members()
    found = [
        (triple, *octant)
        for triple in _triples(faces.pairs)
        for octant in _octants(faces, triple, [corners[members[face]] for face in triple])
    ]
    contact = {tuple(pair): triangles for pair, triangles in zip(faces.pairs.tolist(), faces.contact, strict=True)}
    # Of each face the triangle at its edge with the next: (a, b) -> a, (b, c) -> b, (a, c) -> c.
    triangle = np.array(
        [[contact[a, b][0], contact[b, c][0], contact[a, c][1]] for (a, b, c), *_ in found], dtype=np.int64
    ).reshape(-1, 3)
    meshes = merged_scene.meshes
    mesh_of_triangle = merged_scene.mesh_of_triangle
    owner = np.concatenate([np.zeros(0, np.int32), *(mesh.object_of_triangle for mesh in meshes)])
    axes = np.array([item[2] for item in found]).reshape(-1, 3, 3)
    between = np.abs(np.einsum("qij,qij->qi", axes, np.roll(axes, 1, axis=1))).max(axis=1, initial=0.0)
    return CornerPoints(
        apex=np.array([item[1] for item in found]).reshape(-1, 3),
        axes=axes,
        reach=np.array([item[3] for item in found]).reshape(-1, 3, DIRECTIONS),
        off_square=np.arcsin(np.minimum(between, 1.0)),
        face_mesh=mesh_of_triangle[triangle].astype(np.int64).reshape(-1, 3),
        object_index=owner[triangle[:, 0]].astype(np.int32),
        velocity=np.zeros((len(found), 3)),
        shift=np.zeros((len(found), 3)),
        counts={"corner_points": len(found)},
    )


def _triples(pairs: Index) -> list[tuple[int, int, int]]:
    """Faces a < b < c of which each pair meets."""
    above = defaultdict(set)
    for one, other in pairs.tolist():
        above[one].add(other)
    return [(a, b, c) for a in sorted(above) for b in sorted(above[a]) for c in sorted(above[a] & above.get(b, set()))]


def _octants(faces: PlanarFaces, triple: tuple[int, int, int], triangles: list[Real]) -> list[tuple[Real, Real, Real]]:
    """Apex [3], edges [3, 3] and reach [3, N] of the octants in which three faces meet."""
    index = list(triple)
    normal, centre = faces.normal[index], faces.centre[index]
    apex = centre[0] + np.linalg.solve(normal, np.einsum("fi,fi->f", normal, centre - centre[0]))
    edges = np.stack([np.cross(normal[(i + 1) % 3], normal[(i + 2) % 3]) for i in range(3)])
    edges /= np.linalg.norm(edges, axis=1, keepdims=True)
    flat = [_in_plane(part - apex, edges[(i + 1) % 3], normal[i]) for i, part in enumerate(triangles)]
    angles = (np.arange(DIRECTIONS) + 0.5) * 0.5 * np.pi / DIRECTIONS
    quarters = []  # reach by face and by the signs of its two edges
    for i, part in enumerate(flat):
        sense = np.sign(np.cross(normal[i], edges[(i + 1) % 3]) @ edges[(i + 2) % 3])
        quarters.append(
            {
                signs: reach_around(part * np.array([signs[0], sense * signs[1]]), angles)
                for signs in product((1.0, -1.0), repeat=2)
            }
        )
    found = []
    for signs in product((1.0, -1.0), repeat=3):
        reach = np.stack([quarters[i][signs[(i + 1) % 3], signs[(i + 2) % 3]] for i in range(3)])
        if reach.max(axis=1).min() >= LEAST_REACH_M:
            found.append((apex, np.array(signs)[:, None] * edges, reach))
    return found


def _in_plane(triangles: Real, axis: Real, normal: Real) -> Real:
    """[n, 3, 2] triangles near the origin in coordinates along ``axis`` and across it, in the plane of a face."""
    across = np.cross(normal, axis)
    flat = np.stack([triangles @ axis, triangles @ across], axis=2)
    beyond = (flat.min(axis=1) > FARTHEST_M) | (flat.max(axis=1) < -FARTHEST_M)
    return np.ascontiguousarray(flat[~beyond.any(axis=1)])
