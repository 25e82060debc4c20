"""Which triangles sample a smooth surface: found by angle, as modelling tools do (docs/notes/curved.md has the rules).

Two triangles that share an edge belong to one smooth surface where the angle between their planes, the fold, is at most
``SMOOTH_FOLD_DEG``. That alone would also smooth a roof with a low ridge and the flat panel beside a rounded edge. A
surface is therefore curved only where its facets, triangles in one plane, are alike in width, enough in number, turn
enough, are not the smoother pieces of a ragged body, and have one side (no Moebius strip). What remains is flat. Where
so many flat facets lie side by side that they look like a coarse curved surface, they are counted: ``coarse``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from datafactory.paths.bodies import Body, components, fold_angles, into_faces
from datafactory.paths.merged_scene import found_once
from shared.physics.vectors import Index, Mask, Real, dots

SMOOTH_FOLD_DEG = 25.0
"""Largest angle between the planes of neighbouring facets of a smooth surface: a round body of 15 facets or more."""
FLAT_FOLD_DEG = 0.02
"""Smallest angle that is a fold at all: with less, two triangles are one facet. Float32 vertices 20 m from their origin
bend triangles of 5 cm by 0.003 deg."""
WIDTH_RATIO = 4.0
"""Largest ratio of the widths of two facets of a curved surface. Rings of one body are nearly equal; a car's panel is
ten times as wide as a strip of its rounded edge."""
LEAST_FACETS = 4
"""Of a curved surface: a quarter of a round edge has so many at the largest fold; two planes with a ridge are two."""
FEW_FACETS = 12
"""Surfaces of fewer facets may be chance: a tessellator makes so few only of strips that are alike."""
LEAST_TURN_DEG = 5.0
"""Smallest angle between a curved surface's mean normal and its farthest one. The noise of a wall's rounded vertices
stays below: 0.5 mm bend triangles of 15 cm by 0.4 deg."""
PIECE_SHARE, FEW_PIECE_SHARE = 0.5, 0.2
"""Share of a surface's ends at sharper folds above which it is a piece of a coarse body; the latter of few facets. A
cylinder with one chamfered rim has 0.5."""
COARSE_FOLD_DEG = 60.0
"""Facets that meet at angles between ``SMOOTH_FOLD_DEG`` and this one, as of a column of 6 to 14 sides, may stand for a
curved surface; sharper ones are corners."""
COARSE_FACETS = 6
"""Number of such facets in a body that is counted as coarse: a pyramid's roof has 4."""


@dataclass(frozen=True, eq=False)
class SmoothFacets:
    """Which of a body's triangles sample curved surfaces.

    :param surface: [T] number of the curved surface that a triangle belongs to, -1 for flat ones
    :param turned: [T] whether the triangle's winding is against its surface's
    :param smooth: [E] whether the edge lies within a curved surface
    :param goes_on: [E, 2] whether the surface of either triangle goes on beyond the edge: within itself, or without a
        sharp fold into facets more than ``WIDTH_RATIO`` times as wide, which are flatter
    :param coarse: number of facets that turn by too much to be one
    """

    surface: Index
    turned: Mask
    smooth: Mask
    goes_on: Mask
    coarse: int


@found_once
def smooth_facets(body: Body) -> SmoothFacets:
    """The curved surfaces of a body, found once."""
    fold = np.degrees(fold_angles(body))
    facet = components(len(body.triangles), body.faces[fold < FLAT_FOLD_DEG])
    width = _widths(body, facet)
    alike = ~body.rim & (width.max(axis=1) <= WIDTH_RATIO * width.min(axis=1))
    joined = (fold < FLAT_FOLD_DEG) | (alike & (fold <= SMOOTH_FOLD_DEG))
    surface, turned = _oriented_components(body, np.flatnonzero(joined))
    surface = np.where(_is_curved(body, facet, surface, turned), surface, -1)
    sharper = alike & (fold > SMOOTH_FOLD_DEG) & (fold <= COARSE_FOLD_DEG)
    surface = np.where(_is_a_piece(body, facet, surface, joined, sharper), -1, surface)
    numbers = np.unique(surface[surface >= 0])
    surface = np.where(surface >= 0, np.searchsorted(numbers, surface), -1)
    smooth = joined & (surface[body.faces] >= 0).all(axis=1) if len(joined) else joined
    tangent = ~body.rim & (fold <= SMOOTH_FOLD_DEG)
    goes_on = smooth[:, None] | (tangent[:, None] & (WIDTH_RATIO * width < width[:, ::-1]))
    coarse = _coarse(body, facet, surface, sharper)
    return SmoothFacets(surface, turned, smooth, goes_on, coarse)


def _widths(body: Body, facet: Index) -> Real:
    """[E, 2] widths [m], across each edge, of the facets of its two triangles.

    The width of a facet along the unit vector d is sqrt(12 d^T C d), C the covariance of its points: that of a
    rectangle is its side, that of a triangle 0.8 of its height.
    """
    corners = body.corners - body.corners.mean(axis=(0, 1)) if len(body.corners) else body.corners
    area = 0.5 * np.linalg.norm(body.areas, axis=1)
    centre = corners.mean(axis=1)
    around = corners - centre[:, None]
    count = int(facet.max(initial=-1)) + 1
    whole = np.maximum(np.bincount(facet, area, count), np.finfo(float).tiny)
    mean = np.stack([np.bincount(facet, area * centre[:, i], count) for i in range(3)], axis=1) / whole[:, None]
    off = centre - mean[facet]
    spread = off[:, :, None] * off[:, None, :] + np.einsum("tki,tkj->tij", around, around) / 12.0
    covariance = np.zeros((count, 3, 3))
    np.add.at(covariance, facet, (area / whole[facet])[:, None, None] * spread)
    widths = []
    for side, into in enumerate(into_faces(body)):
        square = np.einsum("ei,eij,ej->e", into, covariance[facet[body.faces[:, side]]], into)
        widths.append(np.sqrt(12.0 * np.maximum(square, 0.0)))
    return np.stack(widths, axis=1)


def _oriented_components(body: Body, edges: Index) -> tuple[Index, Mask]:
    """Triangles joined over these edges: component of each [T], and whether its winding is against its component's.

    Two triangles that are wound alike run along their common edge in opposite senses. Every triangle stands twice in
    the graph, as it is wound and turned over; a component in which both are joined has no sides, and its number is -1.
    """
    count = len(body.triangles)
    one, other = body.faces[edges].T
    alike = _runs_along(body, edges, one) != _runs_along(body, edges, other)
    links = np.concatenate(
        [
            np.stack([one, np.where(alike, other, other + count)], axis=1),
            np.stack([one + count, np.where(alike, other + count, other)], axis=1),
        ]
    )
    both = components(2 * count, links)
    as_is, turned_over = both[:count], both[count:]
    # The two copies of a component carry two numbers; the smaller one names it, and the copies that have it its side.
    return np.where(as_is == turned_over, -1, np.minimum(as_is, turned_over)), as_is > turned_over


def _runs_along(body: Body, edges: Index, face: Index) -> Mask:
    """[n] whether a triangle's winding runs along its edge from the first vertex to the second."""
    first, second = body.pairs[edges].T
    corners = body.triangles[face]
    following = np.roll(corners, -1, axis=1)
    return ((corners == first[:, None]) & (following == second[:, None])).any(axis=1)


def _is_curved(body: Body, facet: Index, surface: Index, turned: Mask) -> Mask:
    """[T] whether a triangle's component has facets enough, turns enough, and has sides."""
    count = int(surface.max(initial=-1)) + 1
    if not count:
        return np.zeros(len(surface), dtype=bool)
    known = surface >= 0
    lead = np.unique(facet[known], return_index=True)[1]
    facets = np.bincount(surface[known][lead], minlength=count)
    area = np.where(turned[:, None], -body.areas, body.areas)
    total = np.stack([np.bincount(surface[known], area[known, i], count) for i in range(3)], axis=1)
    closed = np.linalg.norm(total, axis=1)
    size = np.linalg.norm(area, axis=1)
    whole = np.bincount(surface[known], size[known], count)
    of_facet = np.bincount(facet[known], size[known], int(facet.max()) + 1)[facet[known][lead]]
    smallest, largest = np.full(count, np.inf), np.zeros(count)
    np.minimum.at(smallest, surface[known][lead], of_facet)
    np.maximum.at(largest, surface[known][lead], of_facet)
    enough = (facets >= LEAST_FACETS) & ((facets >= FEW_FACETS) | (largest <= WIDTH_RATIO * smallest))
    # The area vectors of a closed surface add up to 0, but for rounding: it turns all round.
    mean = total / np.maximum(closed, np.finfo(float).tiny)[:, None]
    cosine = dots(area, mean[surface]) / np.maximum(size, np.finfo(float).tiny)
    least = np.ones(count)
    np.minimum.at(least, surface[known], cosine[known])
    turns = (least < np.cos(np.radians(LEAST_TURN_DEG))) | (closed < 1e-6 * whole)
    return known & (turns & enough)[surface]


def _is_a_piece(body: Body, facet: Index, surface: Index, joined: Mask, sharper: Mask) -> Mask:
    """[T] whether a triangle's surface ends mostly at folds of the kind ``sharper``; ``joined`` ones are no ends."""
    count = int(surface.max(initial=-1)) + 1
    lead = np.unique(facet, return_index=True)[1]
    few = np.bincount(surface[lead][surface[lead] >= 0], minlength=count) < FEW_FACETS
    ends, bad = np.zeros(count), np.zeros(count)
    for side in (0, 1):
        of = surface[body.faces[:, side]]
        counted = (of >= 0) & ~joined & ((side == 0) | ~body.rim)
        ends += np.bincount(of[counted], minlength=count)
        bad += np.bincount(of[counted & sharper], minlength=count)
    return (surface >= 0) & np.append(bad > np.where(few, FEW_PIECE_SHARE, PIECE_SHARE) * ends, False)[surface]


def _coarse(body: Body, facet: Index, surface: Index, sharper: Mask) -> int:
    """Number of flat facets that look like a coarse curved surface."""
    flat = (surface[body.faces] < 0).all(axis=1) if len(body.faces) else sharper
    links = body.faces[flat & sharper]
    bent = np.unique(facet[links])
    groups = components(int(facet.max(initial=-1)) + 1, facet[links].reshape(-1, 2))
    sizes = np.bincount(groups[bent])
    return int(sizes[sizes >= COARSE_FACETS].sum())
