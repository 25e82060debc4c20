"""Panes: the slabs on the straight line between radar and point.

Lines of sight are rays of Mitsuba in float32. Every mesh surface is one slab, as in Sionna's own model: a pane modelled
as a box is two panes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from datafactory.paths.candidates import PANE, Candidates
from datafactory.paths.geometry import first_hits, ray_margin_m
from datafactory.paths.thinning import RANGE_CELL_M, U_CELL
from datafactory.paths.unfold import unit
from datafactory.paths.view import View
from shared.physics.compiled import compiled
from shared.physics.vectors import Complex, Index, Mask, Real, lengths

Polarization = Literal["V", "H"]
AXES: tuple[Polarization, Polarization] = ("V", "H")
"""Components of a field across a direction: along theta^ and phi^."""

MAXIMUM_CROSSINGS = 8
FADED = 1e-6
"""One-way field behind surfaces that is not followed any further: a hundredth of what counts anywhere."""

FAINTEST = 1e-4
"""One-way amplitude behind surfaces below which a target or a mirror counts as hidden: -160 dB both ways, as behind any
wall."""
NEAREST_M = 0.01
"""No pane counts as nearer: the antennas' own size matters there."""


@dataclass(frozen=True)
class Crossings:
    """The surfaces between the radar and K points.

    :param factor: [K] one-way amplitude over that of free space, co-polarised, in the path table's convention
    :param count: [K] surfaces crossed
    :param given_up: points behind more surfaces than were followed; their factor is 0
    """

    factor: Complex
    count: Index
    given_up: int


def panes_between(
    view: View, points: Real, polarization: Polarization = "V", maximum_crossings: int = MAXIMUM_CROSSINGS
) -> Crossings:
    """One-way transmission along the straight lines from the radar to points.

    The field starts as the unit vector theta^ (V) or phi^ (H) of the radar's spherical coordinates. At every surface it
    is split into the part across the plane of incidence (TE) and the part in it (TM), each is multiplied with its T,
    and what arrives is projected on the first vector again. With one pane that is cos^2(a) T_TE + sin^2(a) T_TM, a the
    angle between the vector and the TE axis. A pane takes the place of air, so that T exp(+j k d cos theta) counts: the
    path's length is that of free space. Bending of the ray (its shift of d tan theta at most) is left out. Out and back
    is the square, by reciprocity, for a target that keeps the polarisation.

    :param points: [K, 3] in the radar frame [m]; surfaces nearer than the ray caster's own error count as behind it
    """
    points = np.asarray(points, dtype=np.float64).reshape(-1, 3)
    distance = np.linalg.norm(points, axis=1)
    direction = unit(points)
    axis = polarization_axis(direction, polarization)
    field = axis.astype(np.complex128)
    count = np.zeros(len(points), dtype=np.int64)
    surfaces = _SurfaceWalker(view.geometry, direction, distance - ray_margin_m(distance))
    for _ in range(maximum_crossings):
        hit, shape, normal = surfaces.next_surface()
        if not hit.any():
            break
        count[hit] += 1
        field[hit] = view.slabs.passed(view.mesh_of_number[shape[hit]], direction[hit], normal[hit], field[hit])
        surfaces.leave(np.linalg.norm(field, axis=1) < FADED)
    beyond = surfaces.next_surface()[0]
    factor = np.where(beyond, 0.0, np.einsum("ki,ki->k", field, axis).conj())
    return Crossings(factor=factor, count=count, given_up=int(beyond.sum()))


def polarization_axis(direction: Real, polarization: Polarization) -> Real:
    """[K, 3] theta^ (V, pointing down at the horizon) or phi^ (H, pointing left) of unit directions [K, 3].

    Straight up and down it is undefined; the limit from +x is returned.
    """
    return _axes(np.ascontiguousarray(direction), polarization == "H")


@compiled()
def _axes(direction, horizontal):
    axis = np.empty((len(direction), 3))
    for k in range(len(direction)):
        x, y, z = direction[k, 0], direction[k, 1], direction[k, 2]
        across = np.sqrt(x * x + y * y)
        cosine, sine = (x / across, y / across) if across > 0.0 else (1.0, 0.0)
        if horizontal:
            axis[k, 0], axis[k, 1], axis[k, 2] = -sine, cosine, 0.0
        else:
            axis[k, 0], axis[k, 1], axis[k, 2] = z * cosine, z * sine, -across
    return axis


class _SurfaceWalker:
    """Rays from the origin, from one surface to the next.

    A ray restarts a margin behind each surface. A second hit on the same triangle is an error of rounding, and skipped.
    """

    def __init__(self, mi_scene: Any, direction: Real, reach: Real) -> None:
        self.scene, self.direction, self.reach = mi_scene, direction, reach
        self.travelled = np.zeros(len(direction))
        self.last = np.full((len(direction), 2), -1, dtype=np.int64)

    def next_surface(self) -> tuple[Mask, Index, Real]:
        """Whether there is one [K], its shape's id [K] and its unit normal [K, 3]."""
        found = np.zeros(len(self.direction), dtype=bool)
        shape = np.zeros(len(self.direction), dtype=np.int64)
        normal = np.zeros((len(self.direction), 3))
        pending = np.flatnonzero(self.travelled < self.reach)
        while len(pending):
            distance, triangle, n = self._cast(pending)
            here = np.isfinite(distance)
            again = here & (triangle == self.last[pending]).all(axis=1)
            new = pending[here & ~again]
            found[new], shape[new], normal[new] = True, triangle[here & ~again, 0], n[here & ~again]
            self.last[pending[here]] = triangle[here]
            self.travelled[pending[here]] += distance[here] + ray_margin_m(
                self.travelled[pending[here]] + distance[here]
            )
            self.travelled[pending[~here]] = np.inf
            pending = pending[again & (self.travelled[pending] < self.reach[pending])]
        return found, shape, normal

    def leave(self, rays: Mask) -> None:
        """Follow these [K] no further."""
        self.travelled[rays] = np.inf

    def _cast(self, index: Index) -> tuple[Real, Index, Real]:
        start = self.travelled[index, None] * self.direction[index]
        hits = first_hits(self.scene, start, self.direction[index], (self.reach - self.travelled)[index])
        triangle = np.stack([hits.shape, hits.primitive], axis=1)
        return np.where(hits.valid, hits.distance, np.inf), triangle, hits.normal


def pane_candidates(view: View) -> Candidates:
    """Of the panes ahead: what stands behind one may be a mirror, so that no echo exceeds T^2 lambda / (8 pi R), T the
    largest that the slab lets through at any angle.

    A triangle's direction is that of the corner, middle of a side or centre that lies nearest to boresight; R is no
    more than the distance of any of its points. Of those in one cell of range and u the strongest stands for all.
    """
    corners, largest = [np.zeros((0, 3, 3))], [np.zeros(0)]
    for number in np.flatnonzero(view.slabs.lets_through):
        mesh = view.merged.meshes[number]
        corners.append(mesh.seen_from(view.pose)[mesh.triangles].astype(np.float64))
        largest.append(np.full(len(mesh.triangles), view.slabs.most_passed[number]))
    corner, passed = np.concatenate(corners), np.concatenate(largest)
    ahead = np.flatnonzero((corner[:, :, 0] > 0.0).any(axis=1))
    corner, passed = corner[ahead], passed[ahead]
    middle, centre = 0.5 * (corner + np.roll(corner, 1, axis=1)), corner.mean(axis=1, keepdims=True)
    places = np.concatenate([corner, middle, centre], axis=1)
    distance = np.linalg.norm(places, axis=2)
    best = np.argmax(places[:, :, 0] / np.maximum(distance, NEAREST_M), axis=1)
    half = 0.5 * np.linalg.norm(corner - np.roll(corner, 1, axis=1), axis=2).max(axis=1, initial=0.0)
    nearest = np.maximum(distance.min(axis=1) - half, NEAREST_M)
    power = (passed**2 * view.wavelength_m / (8.0 * np.pi * nearest)) ** 2
    place = places[np.arange(len(corner)), best]
    u = place[:, 1] / np.maximum(lengths(place), NEAREST_M)
    cell = 1024.0 * np.rint(nearest / RANGE_CELL_M) + np.rint(u / U_CELL)
    order = np.lexsort((-power, cell))
    kept = order[np.unique(cell[order], return_index=True)[1]]
    return Candidates.of(PANE, place[kept], power[kept], nearest[kept])
