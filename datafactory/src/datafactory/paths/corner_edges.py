"""The right-angled corners of a scene: straight edges at which two plane faces face each other, found once.

Two faces that meet at a right angle (:mod:`.planar_faces`) divide space into four quarters. Each quarter whose two
faces both reach away from the edge is a corner that sends a wave back: an inner corner of two walls, a wall on the
ground, a kerb. A fold of one mesh has one such quarter, a sheet that stands on the ground two. The winding of the
triangles is not used. A box has corners only on its inside; a sensor outside does not see them, because the box itself
is in the way.

Along the edge a corner consists of strips. In each strip the reach of either face, away from the edge, is a straight
line (:mod:`.free_extent`). Strips that touch make one corner; beyond a gap another one begins.

Faces belong to bodies of one velocity. What stands on another body, such as a car on a road, makes no corner with it.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from datafactory.paths.facets import mirrors_of
from datafactory.paths.free_extent import strips
from datafactory.paths.merged_scene import MergedScene, motions_of
from datafactory.paths.planar_faces import TOUCH_M, PlanarFaces, planar_faces_of
from datafactory.paths.unfold import unit
from datafactory.scenes.poses import Pose

Real = NDArray[np.float64]
Index = NDArray[np.int64]

LEAST_REACH_M = 0.005
"""Faces that reach less far from the edge, over all of a corner, make none: they are narrower than a wavelength [m]."""


@dataclass(frozen=True)
class CornerEdges:
    """C corners. In world coordinates at time 0 as :func:`corners_of` finds them, in the radar's after
    :meth:`seen_from`.

    :param origin: [C, 3] the point of the edge from which strips count [m]
    :param direction: [C, 3] unit vector along the edge
    :param into: [C, 2, 3] unit vectors from the edge into either face, across the edge
    :param normal: [C, 2, 3] unit normals of the faces, into the quarter between them
    :param face: [C, 2] numbers of the faces; :param face_mesh: [C, 2] index into ``MergedScene.meshes``
    :param object_index: [C] index into ``MergedScene.objects`` of the first face
    :param velocity: [C, 3] [m/s]
    :param shift: [C, 3] what is to be added to the points [m]: the displacement of a body that does not turn
    :param strips: [S, 6] start and end along the edge, the reach of the first face there, and that of the second [m]
    :param corner_of_strip: [S] rising
    :param face_of_triangle: [T] of the merged scene's triangles; -1 where a triangle has none
    :param counts: ``right_angles`` (pairs of faces), ``corner_edges``
    """

    origin: Real
    direction: Real
    into: Real
    normal: Real
    face: Index
    face_mesh: Index
    object_index: NDArray[np.int32]
    velocity: Real
    shift: Real
    strips: Real
    corner_of_strip: Index
    face_of_triangle: Index
    counts: dict[str, int] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.origin)

    @property
    def opening(self) -> Real:
        """[C] angle between the faces [rad]."""
        return np.arccos(np.clip(np.einsum("ci,ci->c", self.into[:, 0], self.into[:, 1]), -1.0, 1.0))

    def take(self, index: NDArray) -> CornerEdges:
        """The corners at these rising indices, or where a mask is true."""
        chosen = np.arange(len(self))[index]
        place = np.full(len(self), -1, dtype=np.int64)
        place[chosen] = np.arange(len(chosen))
        whole = ("strips", "corner_of_strip", "face_of_triangle", "counts")
        kept = {item.name: getattr(self, item.name)[chosen] for item in fields(self) if item.name not in whole}
        stay = place[self.corner_of_strip] >= 0
        return CornerEdges(
            **kept,
            strips=self.strips[stay],
            corner_of_strip=place[self.corner_of_strip[stay]],
            face_of_triangle=self.face_of_triangle,
            counts=self.counts,
        )

    def seen_from(self, pose: Pose) -> CornerEdges:
        """The same corners in the radar frame at the pose's time, velocities relative to the radar."""
        rotation = pose.rotation()
        return replace(
            self,
            origin=(self.origin + self.shift - np.asarray(pose.position)) @ rotation,
            shift=np.zeros_like(self.shift),
            direction=self.direction @ rotation,
            into=self.into @ rotation,
            normal=self.normal @ rotation,
            velocity=(self.velocity - np.asarray(pose.velocity)) @ rotation,
        )

    def extent(self) -> tuple[Real, Real]:
        """Start [C] and end [C] of each corner along its edge [m]."""
        low, high = np.full(len(self), np.inf), np.full(len(self), -np.inf)
        np.minimum.at(low, self.corner_of_strip, self.strips[:, 0])
        np.maximum.at(high, self.corner_of_strip, self.strips[:, 1])
        return low, high

    def within(self, distance_m: float) -> CornerEdges:
        """The corners of which a part lies nearer than this to the origin [m]: in the radar frame, those in range."""
        low, high = self.extent()
        nearest = np.clip(-np.einsum("ci,ci->c", self.origin, self.direction), low, high)
        return self.take(np.linalg.norm(self.origin + nearest[:, None] * self.direction, axis=1) < distance_m)

    def joins(self, triangle: Index, other: Index) -> NDArray[np.bool_]:
        """[n] whether two triangles [n] each belong to the two faces of one corner."""
        count = int(self.face_of_triangle.max(initial=-1)) + 1
        faces = np.sort(np.stack([self.face_of_triangle[triangle], self.face_of_triangle[other]], axis=1), axis=1)
        pairs = np.sort(self.face, axis=1)
        return (faces[:, 0] >= 0) & np.isin(faces[:, 0] * count + faces[:, 1], pairs[:, 0] * count + pairs[:, 1])


@lru_cache(maxsize=8)
def corners_of(merged_scene: MergedScene) -> CornerEdges:
    """All corners of a merged scene at its time, found once; where something turns, for each time."""
    at_rest = merged_scene.at_rest
    found = corners_of(at_rest) if at_rest is not None and not merged_scene.turns else _found(merged_scene)
    velocity, shift = motions_of(merged_scene, found.face_mesh[:, 0])
    return replace(found, velocity=velocity, shift=shift)


def _found(merged_scene: MergedScene) -> CornerEdges:
    faces, triangles = planar_faces_of(merged_scene), mirrors_of(merged_scene).corners
    members = faces.members()
    parts = [_corners_of_pair(faces, pair, triangles, members) for pair in range(len(faces.pairs))]
    found = [(pair, *corner) for pair, corners in enumerate(parts) for corner in corners]
    pair = np.array([item[0] for item in found], dtype=np.int64)
    origin = np.array([item[1] for item in found]).reshape(-1, 3)
    into = np.array([item[2] for item in found]).reshape(-1, 2, 3)
    pieces = [item[3] for item in found]
    normal = unit(into[:, ::-1] - np.einsum("ci,ci->c", into[:, 0], into[:, 1])[:, None, None] * into)
    meshes = merged_scene.meshes
    mesh_of_triangle = merged_scene.mesh_of_triangle
    owner = np.concatenate([np.zeros(0, np.int32), *(mesh.object_of_triangle for mesh in meshes)])
    contact = faces.contact[pair]
    return CornerEdges(
        origin=origin,
        direction=unit(np.cross(into[:, 0], into[:, 1])),
        into=into,
        normal=normal,
        face=faces.pairs[pair],
        face_mesh=mesh_of_triangle[contact].astype(np.int64),
        object_index=owner[contact[:, 0]].astype(np.int32),
        velocity=np.zeros((len(found), 3)),
        shift=np.zeros((len(found), 3)),
        strips=np.concatenate([np.zeros((0, 6)), *pieces]),
        corner_of_strip=np.repeat(np.arange(len(pieces)), [len(piece) for piece in pieces]),
        face_of_triangle=faces.of_triangle,
        counts={"right_angles": len(faces.pairs), "corner_edges": len(found)},
    )


def _corners_of_pair(
    faces: PlanarFaces, pair: int, corners: Real, members: list[Index]
) -> list[tuple[Real, Real, Real]]:
    """Origin [3], vectors into the faces [2, 3] and strips [s, 6] of all corners of one pair of faces."""
    one, other = faces.pairs[pair]
    normals = faces.normal[[one, other]]
    along = unit(np.cross(*normals))
    near = corners[faces.contact[pair, 0]].mean(axis=0)
    # The point of the line nearest to the contact; heights of the planes over it are measured from there.
    heights = np.einsum("fi,fi->f", normals, faces.centre[[one, other]] - near)
    origin = near + np.linalg.solve(np.stack([*normals, along]), np.array([*heights, 0.0]))
    across = np.cross(normals, along)  # [2, 3], each in its own face
    flat = []
    for face, away in zip((one, other), across, strict=True):
        off = corners[members[face]] - origin
        flat.append(np.stack([off @ along, off @ away], axis=2))
    low, high = _common(flat)
    found = []
    for sides in ((1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)):
        for run in _runs(strips(flat, low, high, sides)):
            # The strips count along into_0 x into_1.
            into = across * np.array(sides)[:, None]
            turned = float(np.dot(np.cross(*into), along)) < 0.0
            found.append((origin, into, _reversed(run) if turned else run))
    return found


def _common(flat: list[Real]) -> tuple[float, float]:
    """From where to where along the line both faces have triangles at it."""
    low, high = -np.inf, np.inf
    for face in flat:
        at = (face[:, :, 1].min(axis=1) <= TOUCH_M) & (face[:, :, 1].max(axis=1) >= -TOUCH_M)
        low, high = max(low, face[at, :, 0].min(initial=np.inf)), min(high, face[at, :, 0].max(initial=-np.inf))
    return float(low), float(high)


def _runs(pieces: Real) -> list[Real]:
    """The strips in runs without gaps along the edge, without those in which a face is too narrow throughout."""
    if not len(pieces):
        return []
    gaps = np.flatnonzero(pieces[1:, 0] - pieces[:-1, 1] > TOUCH_M) + 1
    runs = np.split(pieces, gaps)
    return [run for run in runs if np.minimum(run[:, 2:4], run[:, 4:6]).max() >= LEAST_REACH_M]


def _reversed(run: Real) -> Real:
    """The same strips counted from the other end."""
    return np.stack([-run[:, 1], -run[:, 0], run[:, 3], run[:, 2], run[:, 5], run[:, 4]], axis=1)[::-1]
