"""The wedges of a scene: straight edges where a wave is diffracted, found once from the merged meshes.

An edge is a fold between two triangles of a body, or the rim of a sheet (a half plane, n = 2). The wedge's exterior is
the side on which the faces make more than 180 deg; the winding of the triangles, which files often have wrong, is not
used. An observer on the other side sees an inner corner, which does not diffract: the angles of
:mod:`datafactory.paths.diffraction` leave it out. Flat folds, as of terrain, are counted and left out, and so are folds
between facets of a curved surface, which has no edge there (:mod:`datafactory.paths.smooth`). Collinear pieces that
share a vertex, the faces' planes and the materials are one edge.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from datafactory.paths.bodies import Body, bodies_of, components, into_faces
from datafactory.paths.columns import DIRECTION, POINT, Placed, pairs_in_runs
from datafactory.paths.merged_scene import MergedScene, found_once
from datafactory.paths.smooth import smooth_facets
from shared.physics.vectors import Index, Mask, Real, dots, lengths, unit

FLATTEST_FOLD_DEG = 15.0
"""Smallest angle between the planes of two faces that makes an edge: a 30-sided column has none, a 16-sided one does.
Straight back from metal, 15 deg is 10 (hard) to 14 dB (soft) below a right angle, in the median over directions.
"""
SAME_PLANE = 1e-3
"""Largest difference between unit vectors of faces and directions that count as the same: 0.06 deg."""
STRAIGHT_M = 1e-3
"""Largest distance of a merged edge's inner vertices from its chord [m]; an edge that bends more stays in pieces."""


@dataclass(frozen=True)
class WedgeEdges(Placed):
    """E wedges. Around an edge, angles run from the 0-face through the exterior to the n-face, at n pi.

    :param start, end: [E, 3] [m]
    :param direction: [E, 3] unit vector from start to end; (into the 0-face, normal_0, direction) are right-handed
    :param normal_0: [E, 3] unit normal of the 0-face, into the exterior
    :param normal_n: [E, 3] unit normal of the n-face, into the exterior
    :param exterior_n: [E] n, above 1 and at most 2
    :param face_mesh: [E, 2] index into ``MergedScene.meshes`` of the two faces' materials; a half plane has the same
        twice
    :param flat: [E, 2] whether either face is flat, and samples no curved surface
    :param turn: [E, 3] velocity of the end less ``velocity``, that of the start, over the length [1/s]
    :param object_index: [E] index into ``MergedScene.objects`` of the 0-face
    :param counts: what was found and left out: ``edges``, ``half_planes``, ``merged``, ``flat``, ``non_manifold``,
        ``doubled_triangles``, ``collapsed_triangles``
    """

    start: Real = field(metadata=POINT)
    end: Real = field(metadata=POINT)
    direction: Real = field(metadata=DIRECTION)
    normal_0: Real = field(metadata=DIRECTION)
    normal_n: Real = field(metadata=DIRECTION)
    exterior_n: Real
    face_mesh: Index
    flat: Mask
    turn: Real = field(metadata=DIRECTION)
    object_index: NDArray[np.int32]

    def velocity_at(self, index: Index, point: Real) -> Real:
        """[K, 3] velocities [m/s] of the points [K, 3] of the edges ``index`` [K]."""
        if not self.turn.any():
            return self.velocity[index]
        along = dots(point - self.start[index], self.direction[index])
        return self.velocity[index] + along[:, None] * self.turn[index]

    def nearest(self) -> Real:
        """[E, 3] the point of each that lies nearest to the origin [m]."""
        foot = -dots(self.start, self.direction)
        return self.start + np.clip(foot, 0.0, lengths(self.end - self.start))[:, None] * self.direction


@found_once
def edges_of(merged_scene: MergedScene) -> WedgeEdges:
    """All wedges of a merged scene at its time, made once for each."""
    found = WedgeEdges.of_bodies([_edges_of_body(body) for body in bodies_of(merged_scene)])
    return found.moving_with(merged_scene, found.face_mesh[:, 0])


@found_once
def _edges_of_body(body: Body) -> WedgeEdges:
    """The wedges of a body, found once; those of one that turns are found for each time."""
    edges = _wedges(body)
    sharp = np.cos((edges.exterior_n - 1.0) * np.pi) < np.cos(np.radians(FLATTEST_FOLD_DEG))
    sharp &= ~smooth_facets(body).smooth
    edges, pairs = edges.take(sharp), body.pairs[sharp]
    merged = _merged_collinear(edges, pairs)
    counts = {
        "edges": len(merged),
        "half_planes": int((merged.exterior_n == 2.0).sum()),
        "merged": len(edges) - len(merged),
        "flat": int((~sharp & ~body.rim).sum()),
        "non_manifold": body.non_manifold,
        "doubled_triangles": len(body.doubles),
        "collapsed_triangles": body.collapsed,
    }
    return replace(merged, counts=counts)


def _wedges(body: Body) -> WedgeEdges:
    """The wedge at every edge; the interior is the side on which its faces make less than 180 deg."""
    pairs, faces = body.pairs, body.faces
    along = unit(body.vertices[pairs[:, 1]] - body.vertices[pairs[:, 0]])
    into = into_faces(body)
    cosine = np.clip(dots(*into), -1.0, 1.0)
    exterior_n = np.where(body.rim, 2.0, 2.0 - np.arccos(cosine) / np.pi)
    # The edge's direction is chosen so that angles from the 0-face run through the exterior first.
    turn = np.where(dots(np.cross(into[0], into[1]), along) > 0.0, -1.0, 1.0)
    direction = turn[:, None] * along
    ends = np.where(turn[:, None] > 0.0, pairs, pairs[:, ::-1])
    start, end = body.vertices[ends.T]
    velocity, at_end = body.velocities[ends.T]
    return WedgeEdges(
        start=start,
        end=end,
        direction=direction,
        normal_0=np.cross(direction, into[0]),
        normal_n=np.cross(into[1], direction),
        exterior_n=exterior_n,
        face_mesh=body.mesh[faces].reshape(-1, 2),
        flat=smooth_facets(body).surface[faces].reshape(-1, 2) < 0,
        velocity=velocity,
        turn=(at_end - velocity) / np.linalg.norm(end - start, axis=1, keepdims=True),
        shift=np.zeros(start.shape),
        object_index=body.owner[faces[:, 0]],
    )


def _merged_collinear(edges: WedgeEdges, pairs: Index) -> WedgeEdges:
    """Collinear pieces with a common vertex and the same faces joined; a chain keeps the values of its first piece."""
    chain = components(len(edges), _neighbours(edges, pairs))
    count = int(chain.max(initial=-1)) + 1
    lead = np.full(count, len(edges))
    np.minimum.at(lead, chain, np.arange(len(edges)))
    origin, direction = edges.start[lead][chain], edges.direction[lead][chain]
    off = np.zeros(count)
    reach = []
    for end in (edges.start, edges.end):
        along = dots(end - origin, direction)
        np.maximum.at(off, chain, np.linalg.norm(end - origin - along[:, None] * direction, axis=1))
        reach.append(along)
    straight = off[chain] < STRAIGHT_M
    low, high = np.full(count, np.inf), np.full(count, -np.inf)
    np.minimum.at(low, chain, np.minimum(*reach))
    np.maximum.at(high, chain, np.maximum(*reach))
    start = np.where(straight[:, None], origin + low[chain][:, None] * direction, edges.start)
    end = np.where(straight[:, None], origin + high[chain][:, None] * direction, edges.end)
    kept = ~straight | (lead[chain] == np.arange(len(edges)))
    velocity = edges.velocity_at(np.arange(len(edges)), start)
    return replace(edges, start=start, end=end, velocity=velocity).take(kept)


def _neighbours(edges: WedgeEdges, pairs: Index) -> Index:
    """[N, 2] pairs of edges that continue each other through a common vertex."""
    vertex, edge = pairs.reshape(-1), np.repeat(np.arange(len(pairs)), 2)
    order = np.argsort(vertex, kind="stable")
    one, other = pairs_in_runs(vertex[order])
    once = one < other
    a, b = edge[order[one[once]]], edge[order[other[once]]]
    return np.stack([a, b], axis=1)[_continue_each_other(edges, a, b)]


def _continue_each_other(edges: WedgeEdges, a: Index, b: Index) -> Mask:
    """Whether edges continue each other with the same faces, of which either may be called the first."""

    def near(one: Real, other: Real) -> Mask:
        return np.linalg.norm(one - other, axis=1) < SAME_PLANE

    faces = edges.face_mesh
    as_is = near(edges.normal_0[a], edges.normal_0[b]) & near(edges.normal_n[a], edges.normal_n[b])
    as_is &= near(edges.direction[a], edges.direction[b]) & (faces[a] == faces[b]).all(axis=1)
    turned = near(edges.normal_0[a], edges.normal_n[b]) & near(edges.normal_n[a], edges.normal_0[b])
    turned &= near(edges.direction[a], -edges.direction[b]) & (faces[a] == faces[b][:, ::-1]).all(axis=1)
    return as_is | turned
