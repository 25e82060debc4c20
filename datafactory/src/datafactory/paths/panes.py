"""Panes: the slabs on the straight line between radar and point.

Lines of sight are rays of Mitsuba in float32. Every mesh surface is one slab, as in Sionna's own model: a pane modelled
as a box is two panes.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np

from datafactory.paths.candidates import PANE, Candidates
from datafactory.paths.geometry import ray_margin_m
from datafactory.paths.thinning import RANGE_CELL_M, U_CELL
from datafactory.paths.view import View, Waves
from shared.physics.compiled import compiled
from shared.physics.vectors import Complex, Real, lengths, unit

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
"""Nearer surfaces do not scatter, nearer mirrors are left out, as the solver does, and no pane counts as nearer: the
antennas' own size matters there."""


def panes_between(
    view: View, points: Real, polarization: Polarization = "V", maximum_crossings: int = MAXIMUM_CROSSINGS
) -> Complex:
    """[K] one-way amplitude along the straight lines from the radar to points, over that of free space.

    The field starts as the unit vector theta^ (V) or phi^ (H) of the radar's spherical coordinates. At every surface it
    is split into the part across the plane of incidence (TE) and the part in it (TM), each is multiplied with its T,
    and what arrives is projected on the first vector again. With one pane that is cos^2(a) T_TE + sin^2(a) T_TM, a the
    angle between the vector and the TE axis. A pane takes the place of air, so that T exp(+j k d cos theta) counts: the
    path's length is that of free space. Bending of the ray (its shift of d tan theta at most) is left out. Out and back
    is the square, by reciprocity, for a target that keeps the polarisation.

    :param points: [K, 3] in the radar frame [m]; surfaces nearer than the ray caster's own error count as behind it
    :param maximum_crossings: of surfaces that are followed; what lies behind more of them has 0
    :return: in the path table's convention
    """
    points = np.asarray(points, dtype=np.float64).reshape(-1, 3)
    distance, direction = lengths(points), unit(points)
    reach = distance - ray_margin_m(distance)
    axis = polarization_axis(direction, polarization)
    field = axis.astype(np.complex128)
    waves, left = Waves.departing(direction, field.copy()), np.arange(len(points))
    for crossing in range(maximum_crossings + 1):
        index, hits = view.hit_by(waves)
        before = np.flatnonzero(waves.length[index] + hits.distance < reach[left[index]])
        index, hits = index[before], hits.take(before)
        waves, left = waves.arrived(index, hits), left[index]
        behind = view.slabs.passed(hits.mesh, waves.direction, hits.normal, waves.field)
        field[left] = behind if crossing < maximum_crossings else 0.0
        # On, from a little behind the surface on the straight line.
        margin = ray_margin_m(waves.length)
        start = waves.start + margin[:, None] * waves.direction
        waves = replace(waves, start=start, lifted=start, length=waves.length + margin, field=behind)
        strong = np.flatnonzero(np.linalg.norm(behind, axis=1) >= FADED)
        waves, left = waves.take(strong), left[strong]
    return np.einsum("ki,ki->k", field, axis).conj()


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
