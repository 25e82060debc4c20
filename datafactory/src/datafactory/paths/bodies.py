"""The bodies of a scene: triangles of one motion on common vertices, and the edges at which they meet.

Meshes of one motion form one body, because a roof and its walls, or the panels of a car, are often meshes of
different materials. Their vertices are welded within ``WELD_M``. All that is found of a scene's shape is found body by
body: of a body that does not turn it stays the same, but for its shift.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from datafactory.paths.merged_scene import MergedScene, found_once
from shared.physics.vectors import Index, Mask, Real, dots, unit

WELD_M = 1e-4
"""Vertices nearer than this are one [m]."""


@dataclass(frozen=True, eq=False)
class Body:
    """T triangles of one motion on V common vertices, and the E edges that one or two of them have.

    :param meshes: whose triangles they are, indices into ``MergedScene.meshes``
    :param vertices: [V, 3] world [m], without the meshes' shift; :param triangles: [T, 3]
    :param corners: [T, 3, 3] of the triangles as their meshes have them, up to ``WELD_M`` off the vertices
    :param velocities: [V, 3] of the vertices of what turns [m/s]; 0 of all else
    :param mesh: [T] index into ``MergedScene.meshes``
    :param owner: [T] index into ``MergedScene.objects``
    :param source: [T] index among all triangles of the merged scene
    :param doubles: [D, 2] triangles that lie on another: index among all of the scene's, and of that other here
    :param pairs: [E, 2] vertices of each edge; :param faces: [E, 2] its triangles, twice the same on a rim
    :param rim: [E] whether only one triangle has the edge
    :param non_manifold: edges that more than two triangles share; they are in no other field
    :param collapsed: triangles without an area, left out
    :param found: what was found of it once, see :mod:`datafactory.paths.merged_scene`
    """

    meshes: Sequence[int]
    vertices: Real
    triangles: Index
    corners: Real
    velocities: Real
    mesh: Index
    owner: NDArray[np.int32]
    source: Index
    doubles: Index
    pairs: Index
    faces: Index
    rim: Mask
    non_manifold: int
    collapsed: int
    found: dict[str, Any] = field(default_factory=dict, init=False, repr=False)

    @cached_property
    def areas(self) -> Real:
        """[T, 3] twice the area of every triangle [m^2], along its normal."""
        return np.cross(self.corners[:, 1] - self.corners[:, 0], self.corners[:, 2] - self.corners[:, 0])

    @cached_property
    def normals(self) -> Real:
        """[T, 3] unit."""
        return self.areas / np.linalg.norm(self.areas, axis=1, keepdims=True)


@found_once
def bodies_of(merged_scene: MergedScene) -> tuple[Body, ...]:
    """The bodies of a merged scene at its time, in the order of their first meshes; an empty one if it has none.

    Made once; of another time than 0 those that turn are made anew.
    """
    known = None if merged_scene.at_rest is None else bodies_of(merged_scene.at_rest)
    if known is not None and not merged_scene.turns:
        return known
    members: dict[Hashable, list[int]] = {}
    for index, mesh in enumerate(merged_scene.meshes):
        members.setdefault(mesh.rigid_body, []).append(index)
    bodies = []
    for number, each in enumerate(members.values()):
        stays = known is not None and not merged_scene.meshes[each[0]].turning
        bodies.append(known[number] if known is not None and stays else _body(merged_scene, each))
    return tuple(bodies) or (_body(merged_scene, []),)


def components(count: int, links: Index) -> Index:
    """[count] number of the connected component of each item; links [L, 2]."""
    if not count:
        return np.zeros(0, dtype=np.int64)
    graph = coo_array((np.ones(len(links)), (links[:, 0], links[:, 1])), shape=(count, count))
    return connected_components(graph, directed=False)[1].astype(np.int64)


def fold_angles(body: Body) -> Real:
    """[E] angle between the planes of the two triangles at each edge [rad]: 0 where they continue each other, pi on a
    rim. The winding is not used.
    """
    one, other = into_faces(body)
    return 2.0 * np.arcsin(np.clip(0.5 * np.linalg.norm(one + other, axis=1), 0.0, 1.0))


def into_faces(body: Body) -> tuple[Real, Real]:
    """Unit vectors [E, 3] from each edge into its two triangles, across the edge."""
    start = body.vertices[body.pairs[:, 0]]
    along = unit(body.vertices[body.pairs[:, 1]] - start)
    found = []
    for side in (0, 1):
        centre = body.vertices[body.triangles[body.faces[:, side]]].mean(axis=1) - start
        found.append(unit(centre - dots(centre, along)[:, None] * along))
    return found[0], found[1]


def _body(merged_scene: MergedScene, members: list[int]) -> Body:
    """All triangles of one body's meshes on common vertices, without those that collapse and without doubles."""
    chosen = [merged_scene.meshes[index] for index in members]
    starts = np.cumsum([0] + [len(mesh.vertices) for mesh in chosen])
    every = np.concatenate([np.zeros((0, 3)), *(mesh.vertices for mesh in chosen)])
    distinct, first = np.unique(every, axis=0, return_inverse=True)
    near = cKDTree(distinct).query_pairs(WELD_M, output_type="ndarray") if len(distinct) else np.zeros((0, 2), int)
    point = components(len(distinct), near)
    vertices = np.zeros((int(point.max(initial=-1)) + 1, 3))
    vertices[point[::-1]] = distinct[::-1]  # each point lies where its first vertex does
    point = point[first.reshape(-1)]
    triangles = np.concatenate(
        [np.zeros((0, 3), int), *(m.triangles + s for m, s in zip(chosen, starts, strict=False))]
    )
    triangles = point[triangles] if len(triangles) else triangles
    source = np.flatnonzero(np.isin(merged_scene.mesh_of_triangle, members))
    corners, velocities = merged_scene.corners[source], np.zeros_like(vertices)
    if merged_scene.turns:
        velocities[triangles] = merged_scene.corner_velocities[source]
    ordered = np.sort(triangles, axis=1)
    solid = (ordered[:, 0] != ordered[:, 1]) & (ordered[:, 1] != ordered[:, 2])
    for places in (corners, vertices[triangles]):
        doubled_area = np.cross(places[:, 1] - places[:, 0], places[:, 2] - places[:, 0])
        solid &= np.linalg.norm(doubled_area, axis=1) > 0.0
    _, single, which = np.unique(ordered[solid], axis=0, return_index=True, return_inverse=True)
    rank = np.argsort(np.argsort(single))[which.reshape(-1)]  # of each solid triangle, its place among those kept
    kept = np.flatnonzero(solid)[np.sort(single)]
    left = source[kept]
    double = np.ones(len(rank), dtype=bool)
    double[single] = False
    pairs, faces, rim, non_manifold = _shared_edges(triangles[kept])
    return Body(
        meshes=members,
        vertices=vertices,
        triangles=triangles[kept],
        corners=corners[kept],
        velocities=velocities,
        mesh=merged_scene.mesh_of_triangle[left],
        owner=merged_scene.owner[left],
        source=left,
        doubles=np.stack([source[np.flatnonzero(solid)][double], rank[double]], axis=1),
        pairs=pairs,
        faces=faces,
        rim=rim,
        non_manifold=non_manifold,
        collapsed=int((~solid).sum()),
    )


def _shared_edges(triangles: Index) -> tuple[Index, Index, Mask, int]:
    """Edges of one or two triangles: vertices [E, 2], triangles [E, 2] (twice the same on a rim), rims [E].

    Last, the number of edges that more than two triangles share; none of those is used.
    """
    sides = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1)
    face = np.tile(np.arange(len(triangles)), 3)
    order = np.lexsort((face, sides[:, 1], sides[:, 0]))
    sides, face = sides[order], face[order]
    new = np.ones(len(sides), dtype=bool)
    new[1:] = (sides[1:] != sides[:-1]).any(axis=1)
    first = np.flatnonzero(new)
    uses = np.diff(np.append(first, len(sides)))
    kept = first[uses <= 2]
    rim = uses[uses <= 2] == 1
    faces = np.stack([face[kept], face[np.where(rim, kept, kept + 1)]], axis=1) if len(kept) else np.zeros((0, 2), int)
    return sides[kept], faces, rim, int((uses > 2).sum())
