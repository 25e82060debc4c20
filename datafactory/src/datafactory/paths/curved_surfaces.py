"""Curved surfaces behind tessellations: normals and curvature at the facets' corners, found once a scene.

The vertices of a tessellation lie on the surface. Its normals there are first those of Max (J. Graphics Tools 4(2),
1999): with a, b the edges of a triangle from the vertex,

    n ~ sum over the triangles of  a x b / (|a|^2 |b|^2).

Where the surface ends, triangles stand on one side of the vertex only, and the normal is half a fold off. Along a chord
from vertex i to j, to the third order of its length,

    (n_i + n_j) . (p_j - p_i) = 0.

The normals are fitted to that, those at the ends first. Over a triangle the normal changes linearly, n = sum b_i n_i.
Its gradient, made symmetric, is the triangle's curvature tensor (Rusinkiewicz, 3DPVT 2004). A corner has the mean of
its triangles' tensors by area, each turned into the corner's tangent plane. On spheres and cylinders all of this is
exact. The tensor is positive where the surface is convex on the normal's side, 1 / r on a sphere of radius r.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from scipy.sparse import csr_array

from datafactory.paths.bodies import Body, bodies_of
from datafactory.paths.merged_scene import MergedScene, found_once
from datafactory.paths.smooth import SMOOTH_FOLD_DEG, smooth_facets
from shared.physics.vectors import Index, Mask, Real, dots, unit

MENDING_ROUNDS = 4
"""Of the normals at the ends of a surface; each takes off what the length of a corrected normal was wrong by."""
FITTING_ROUNDS = 8
"""Of all normals. An ellipsoid's levels are then half as wrong as with Max's. More would follow the noise of rounded
vertices: chords alone say nothing of normals that lean to and fro from point to point."""
LESS_AROUND = 0.75
"""A point with less than this share of another's angle of triangles around it takes its normal from the chord to it: a
point on a rim (pi) from one inside (2 pi), a corner (pi / 2) from one on a rim."""
HOLD = 1e-3
"""Weight of a first normal against one chord's: it decides what chords leave open."""
SLIVER = 1e-6
"""Doubled area of a triangle over the square of its longest side, below which its normals' gradient is rounding."""


@dataclass(frozen=True, eq=False)
class CurvedSurfaces:
    """The C triangles of a scene that sample curved surfaces, and the B pieces of line where these end.

    In world coordinates at time 0. Triangles and normals of one surface have one side.

    :param triangle: [C] index among all triangles of the merged scene
    :param surface: [C] number of the surface
    :param corners: [C, 3, 3] [m], anticlockwise seen from the normals' side
    :param normals: [C, 3, 3] unit normals at the corners
    :param tensors: [C, 3, 3, 3] curvature tensors at the corners [1/m]
    :param rims: [B, 2, 3] where a surface ends, with the surface on the left seen from its normals' side [m]
    :param rim_normals: [B, 3] the surface's unit normals there
    :param rim_surface: [B]
    :param covered: [D] triangles of the merged scene that are one of these or lie on one: no flat mirrors
    :param coarse: facets that turn by more than ``SMOOTH_FOLD_DEG`` and stay flat mirrors
    """

    triangle: Index
    surface: Index
    corners: Real
    normals: Real
    tensors: Real
    rims: Real
    rim_normals: Real
    rim_surface: Index
    covered: Index
    coarse: int

    def __len__(self) -> int:
        return len(self.triangle)

    def flat(self, count: int) -> Index:
        """The other ones of the scene's ``count`` triangles, rising: those that may be flat mirrors."""
        flat = np.ones(count, dtype=bool)
        flat[self.covered] = False
        return np.flatnonzero(flat)

    def notes(self) -> tuple[str, ...]:
        """What a user should know of the scene's curved surfaces, one line each; none where it has none."""
        said = []
        if len(self):
            count = int(self.surface.max()) + 1
            said.append(f"{len(self)} triangles sample {count} curved surfaces")
        if self.coarse:
            said.append(
                f"{self.coarse} facets meet others at more than {SMOOTH_FOLD_DEG:g} deg and stay flat mirrors; if they"
                " stand for a curved surface, it needs more of them"
            )
        return tuple(said)


def curved_surfaces_of(merged_scene: MergedScene) -> CurvedSurfaces:
    """The curved surfaces of a merged scene at its time, without their meshes' shifts; found once for each shape."""
    return _found(merged_scene.shapes)


@found_once
def _found(merged_scene: MergedScene) -> CurvedSurfaces:
    parts = []
    first = 0
    for body in bodies_of(merged_scene):
        part = _of_body(body)
        parts.append(replace(part, surface=part.surface + first, rim_surface=part.rim_surface + first))
        first += int(part.surface.max(initial=-1)) + 1
    names = [item.name for item in fields(CurvedSurfaces) if item.name != "coarse"]
    return CurvedSurfaces(
        **{name: np.concatenate([getattr(part, name) for part in parts]) for name in names},
        coarse=sum(part.coarse for part in parts),
    )


@found_once
def _of_body(body: Body) -> CurvedSurfaces:
    """The curved surfaces of one body, numbered from 0."""
    found = smooth_facets(body)
    chosen = np.flatnonzero(found.surface >= 0)
    triangles = np.where(found.turned[chosen, None], body.triangles[chosen][:, ::-1], body.triangles[chosen])
    surface = found.surface[chosen]
    # One vertex may belong to several surfaces, and has a normal of each.
    keys, point = np.unique(
        np.stack([np.repeat(surface, 3), triangles.reshape(-1)], axis=1), axis=0, return_inverse=True
    )
    place, members = body.vertices[keys[:, 1]], point.reshape(-1, 3)
    normals = _normals(place, members)
    corners, at_corners = place[members], normals[members]
    tensors = _corner_tensors(corners, at_corners, normals, members)
    rims, rim_of = _rims(body, found.goes_on, chosen, triangles)
    rim_members = np.stack([members[rim_of, rims], members[rim_of, (rims + 1) % 3]], axis=1)
    lying = found.surface[body.doubles[:, 1]] >= 0
    return CurvedSurfaces(
        triangle=body.source[chosen],
        surface=surface,
        corners=corners,
        normals=at_corners,
        tensors=tensors,
        rims=place[rim_members],
        rim_normals=unit(normals[rim_members].sum(axis=1)),
        rim_surface=surface[rim_of],
        covered=np.concatenate([body.source[chosen], body.doubles[lying, 0]]),
        coarse=found.coarse,
    )


def _max_normals(place: Real, members: Index) -> Real:
    """[P, 3] Max's unit normals of points with triangles [C, 3]."""
    total = np.zeros_like(place)
    for corner in range(3):
        here = place[members[:, corner]]
        a, b = place[members[:, (corner + 1) % 3]] - here, place[members[:, (corner + 2) % 3]] - here
        squares = dots(a, a) * dots(b, b)
        # Lengths are taken relative to the triangle's own: no product of small numbers underflows.
        np.add.at(total, members[:, corner], np.cross(a, b) / np.maximum(squares, np.finfo(float).tiny)[:, None])
    return unit(total)


def _normals(place: Real, members: Index) -> Real:
    """[P, 3] unit normals of points with triangles [C, 3]: Max's, with the ends mended, then all fitted to chords."""
    sides = np.concatenate([members[:, [0, 1]], members[:, [1, 2]], members[:, [2, 0]]])
    ties = np.unique(np.sort(sides, axis=1), axis=0)
    ties = np.concatenate([ties, ties[:, ::-1]])
    around = _angle_around(place, members)
    one_sided = around[ties[:, 0]] < LESS_AROUND * around[ties[:, 1]]
    normals = _max_normals(place, members)
    normals = _fitted(place, ties[one_sided], normals, MENDING_ROUNDS, 1.0, held=False)
    return _fitted(place, ties, normals, FITTING_ROUNDS, 0.5, held=True)


def _fitted(place: Real, ties: Index, normals: Real, rounds: int, step: float, held: bool) -> Real:
    """[P, 3] the normals after steps towards (n_i + n_j) . (p_j - p_i) = 0 for ties [E, 2] from i to j.

    Normals without a tie stay. What the chords leave open is held to the first normals, or else to those before each
    step.
    """
    here, there = ties.T
    moved, number = np.unique(here, return_inverse=True)
    total = csr_array((np.ones(len(number)), (number, np.arange(len(number)))), shape=(len(moved), len(number)))
    chord, first = unit(place[there] - place[here]), normals[moved]
    for _ in range(rounds):
        own, before = normals[here], normals[moved]
        across = chord - dots(chord, own)[:, None] * own
        off = dots(chord, own + normals[there])
        matrix = HOLD * np.eye(3) + (total @ (across[:, :, None] * across[:, None, :]).reshape(-1, 9)).reshape(-1, 3, 3)
        away = first - dots(first, before)[:, None] * before if held else np.zeros_like(before)
        right = HOLD * away - total @ (off[:, None] * across)
        normals = normals.copy()
        normals[moved] = unit(before + step * np.linalg.solve(matrix, right[:, :, None])[:, :, 0])
    return normals


def _angle_around(place: Real, members: Index) -> Real:
    """[P] sum of the angles of the triangles at each point [rad]: about 2 pi inside a surface, pi on its rim."""
    total = np.zeros(len(place))
    for corner in range(3):
        here = place[members[:, corner]]
        a, b = (unit(place[members[:, (corner + k) % 3]] - here) for k in (1, 2))
        np.add.at(total, members[:, corner], np.arccos(np.clip(dots(a, b), -1.0, 1.0)))
    return total


def _corner_tensors(corners: Real, at_corners: Real, normals: Real, members: Index) -> Real:
    """[C, 3, 3, 3] curvature tensors at the corners; a sliver's own counts as 0, and hardly weighs."""
    e1, e2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = np.cross(e1, e2)
    weight = np.linalg.norm(area, axis=1)
    facing, t1 = unit(area), unit(e1)
    frame = np.stack([t1, np.cross(facing, t1)], axis=1)  # [C, 2, 3]
    sides = np.stack([frame @ e1[:, :, None], frame @ e2[:, :, None]], axis=2)[..., 0]
    turns = np.stack([frame @ (at_corners[:, k] - at_corners[:, 0])[:, :, None] for k in (1, 2)], axis=2)[..., 0]
    longest = np.maximum(dots(e1, e1), dots(e2, e2))
    sliver = weight < SLIVER * longest
    sides[sliver], turns[sliver] = np.eye(2), 0.0
    gradient = turns @ np.linalg.inv(sides)
    shape = np.swapaxes(frame, 1, 2) @ (0.5 * (gradient + np.swapaxes(gradient, 1, 2))) @ frame
    total, whole = np.zeros((len(normals), 3, 3)), np.zeros(len(normals))
    for corner in range(3):
        turned = turned_to(shape, facing, at_corners[:, corner])
        np.add.at(total, members[:, corner], weight[:, None, None] * turned)
        np.add.at(whole, members[:, corner], weight)
    return (total / whole[:, None, None])[members]


def turned_to(tensor: Real, before: Real, after: Real) -> Real:
    """[n, 3, 3] tensors turned by the smallest rotation that brings unit vectors ``before`` to ``after`` [n, 3].

    Rodrigues' formula: R = I + W + W^2 / (1 + before . after), W the cross product with before x after.
    """
    w = np.cross(before, after)
    wx = np.zeros((len(w), 3, 3))
    wx[:, 0, 1], wx[:, 0, 2], wx[:, 1, 2] = -w[:, 2], w[:, 1], -w[:, 0]
    wx = wx - np.swapaxes(wx, 1, 2)
    cosine = np.maximum(dots(before, after), -0.999)
    rotation = np.eye(3) + wx + wx @ wx / (1.0 + cosine)[:, None, None]
    return rotation @ tensor @ np.swapaxes(rotation, 1, 2)


def _rims(body: Body, goes_on: Mask, chosen: Index, triangles: Index) -> tuple[Index, Index]:
    """Where surfaces end: first corner [B] of a side of a triangle, and that triangle [B] among ``triangles``."""
    corner, owner = np.tile(np.arange(3), len(triangles)), np.repeat(np.arange(len(triangles)), 3)
    ends = np.sort(np.stack([triangles[owner, corner], triangles[owner, (corner + 1) % 3]], axis=1), axis=1)
    count = len(body.vertices)
    key, known = ends[:, 0] * count + ends[:, 1], body.pairs[:, 0] * count + body.pairs[:, 1]  # the latter rise
    edge = np.minimum(np.searchsorted(known, key), max(len(known) - 1, 0))
    side = (body.faces[edge, 0] != chosen[owner]).astype(np.int64)
    free = ~((known[edge] == key) & goes_on[edge, side])  # edges of three triangles are not known
    return corner[free], owner[free]
