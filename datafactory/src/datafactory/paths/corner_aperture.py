"""The aperture of right-angled corners: pieces along the edge, what either order of the faces opens, Fresnel integrals.

The equations stand in :mod:`datafactory.paths.corner_echoes`. A piece is in sight where both legs to a point of either
face are free; the aperture of either order is looked at within the first zones.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import fresnel

from datafactory.paths.columns import Columns
from datafactory.paths.corners import CornerEdges
from datafactory.paths.diffraction import GRAZING
from datafactory.paths.geometry import ray_margin_m
from shared.physics.compiled import compiled
from shared.physics.vectors import Complex, Index, Mask, Real

SPREAD_M = 0.15
"""Difference in path length at which an end of the aperture has faded to 1/e [m]: half a range cell of the default
radar."""
FADED = 3.0
"""Times ``SPREAD_M``, beyond which an end is left out: exp(-9)."""
CELLS = (8, 48)
"""Cells along a strip: where the aperture has a constant width, and where it has not."""
BEAM_ZONES = 2.0
"""Half width of the aperture in which sight is tested [Fresnel radii sqrt(lambda h / 2)]."""
ACROSS = 3
"""Points across the aperture in which sight is tested, for each order."""


@dataclass(frozen=True)
class Cells(Columns):
    """K pieces of the corners along their edges.

    :param corner: [K]; :param start, stop: [K] v along the edge
    :param least: [K] E at the corner's nearer end [m]; 0 where the foot lies on the edge
    :param z: [K] its middle, from the foot [m]; :param reach: [K, 2] of the faces there [m]
    :param beyond: [K] z over that of the corner's nearer end, less 1; infinite where the foot lies on the edge
    """

    corner: Index
    start: Real
    stop: Real
    least: Real
    z: Real
    reach: Real
    beyond: Real

    def shares_along(self, wavelength_m: float) -> Complex:
        """[K] of F_along."""
        begin, end = (_from_foot(v, 0.25 * wavelength_m * v**2 - self.least) for v in (self.start, self.stop))
        return end - begin


def longer_along(z: Real, height: Real) -> Real:
    """E [m]: how much longer the way by a point z along the edge is than that by the foot."""
    return 2.0 * z * z / (np.hypot(height, z) + height)


def place_of(v: Real, height: Real, wavelength_m: float) -> Real:
    """z [m] along the edge of a signed v."""
    half = 0.125 * wavelength_m * v * v
    return np.sign(v) * np.sqrt(half * (half + 2.0 * height))


def _cells_along(corners: CornerEdges, wavelength_m: float) -> Cells:
    """The strips in cells that are narrow near the foot of the perpendicular."""
    of = corners.corner_of_strip
    height, foot_z, nearest = corners.height[of], corners.foot_z[of], corners.beside
    least = longer_along(nearest, corners.height)
    farthest = place_of(np.sqrt(4.0 * (least + FADED * SPREAD_M) / wavelength_m), corners.height, wavelength_m)[of]
    from_foot = corners.strips[:, :2] - foot_z[:, None]
    within = np.clip(from_foot, -farthest[:, None], farthest[:, None])
    used = np.flatnonzero(within[:, 1] > within[:, 0])
    within, of, height = within[used], of[used], height[used]
    strip, place = corners.strips[used], corners.foot_z[of]
    bent = np.abs(strip[:, [3, 5]] - strip[:, [2, 4]]).max(axis=1, initial=0.0) > 1e-4
    bent |= nearest[of] != 0.0
    count = np.where(bent, CELLS[1], CELLS[0])
    v = np.sign(within) * np.sqrt(4.0 * longer_along(within, height[:, None]) / wavelength_m)
    stretched = np.arcsinh(v)
    index = np.repeat(np.arange(len(used)), count)
    step = np.arange(len(index)) - np.repeat(np.cumsum(count) - count, count)
    width = (stretched[:, 1] - stretched[:, 0]) / count
    start, middle, stop = (np.sinh(stretched[index, 0] + (step + k) * width[index]) for k in (0.0, 0.5, 1.0))
    start[step == 0] = v[index[step == 0], 0]
    last = step == count[index] - 1
    stop[last] = v[index[last], 1]
    z = place_of(middle, height[index], wavelength_m)
    share = np.clip((z + place[index] - strip[index, 0]) / (strip[index, 1] - strip[index, 0]), 0.0, 1.0)[:, None]
    reach = (1.0 - share) * strip[index][:, [2, 4]] + share * strip[index][:, [3, 5]]
    corner = of[index]
    beside = nearest[corner] != 0.0
    beyond = np.where(beside, z / np.where(beside, nearest[corner], 1.0) - 1.0, np.inf)
    return Cells(corner, start, stop, least[corner], z, reach, beyond)


def _from_foot(v: Real, longer_m: Real) -> Complex:
    """F from 0 to v: half an endless line's less the rest beyond v, which fades as its way gets longer [m]."""
    sine, cosine = fresnel(np.abs(v))
    rest = 0.5 - (cosine + 1j * sine) / (1.0 + 1j)
    return np.sign(v) * (0.5 - rest * np.exp(-((np.maximum(longer_m, 0.0) / SPREAD_M) ** 2)))


@dataclass(frozen=True)
class FaceOrder:
    """One order of the faces, for K cells: the wave comes by the first face and goes back from the second.

    :param angle: [K] phi from the first face; :param reach: [K, 2] of the first and the second face [m]
    :param beyond: [K] as in :class:`Cells`
    """

    height: Real
    angle: Real
    opening: Real
    reach: Real
    beyond: Real

    @cached_property
    def bend(self) -> tuple[Real, Real, Real]:
        """[K] h sin(phi), h sin(phi + psi), sin(psi)."""
        h, phi, psi = self.height, self.angle, self.opening
        return h * np.sin(phi), h * np.sin(phi + psi), np.sin(psi)

    @cached_property
    def end(self) -> Real:
        """[K] how far from the edge the second face is lit by the first [m]."""
        first, second = self.reach.T
        below, above, opening = self.bend
        rest = above - first * opening
        ends = rest > first * below / np.maximum(second, 1e-12)
        lit = np.sin(self.angle + self.opening) > GRAZING  # else the image stands behind the second face
        end = np.where(lit, np.where(ends, first * below / np.where(ends, rest, 1.0), second), 0.0)
        # Beside the foot the wave meets the first face nearer to the foot, by h sin(phi) over h sin(phi) + b sin(psi).
        return np.minimum(end, below / opening * np.maximum(self.beyond, 0.0))

    def longer(self, b: Real) -> Real:
        """[K, n] L(b) - L* [m] of points b [K, n]."""
        h, phi, psi = (value[:, None] for value in (self.height, self.angle, self.opening))
        legs = [np.sqrt(h * h + b * b - 2.0 * h * b * np.cos(psi + turn * phi)) for turn in (1.0, -1.0)]
        return np.maximum(legs[0] + legs[1] - 2.0 * h * np.sin(psi), 0.0)

    def beam(self, wavelength_m: float) -> Real:
        """[K, ACROSS] b at the middles of the pieces of the aperture in which sight is tested [m]."""
        zone = np.sqrt(0.5 * wavelength_m * self.height) / np.maximum(np.cos(self.angle), 0.01)
        return np.minimum(self.end, BEAM_ZONES * zone)[:, None] * (np.arange(ACROSS) + 0.5) / ACROSS

    def pieces_across(self, wavelength_m: float) -> Complex:
        """[K, ACROSS] F across of the pieces of the aperture."""
        middle = self.beam(wavelength_m)
        begin, end = np.zeros((len(middle), 1)), self.end[:, None]
        b = np.concatenate([begin, middle[:, :-1] + middle[:, :1], end], axis=1)
        side = np.sign(b * np.cos(self.angle)[:, None] - (self.height * np.cos(self.opening))[:, None])
        longer = self.longer(b)
        return np.diff(_from_foot(side * np.sqrt(4.0 * longer / wavelength_m), longer), axis=1)


@dataclass(frozen=True)
class Apertures:
    """C corners whose apertures are cut into pieces: K cells along the edges, ``ACROSS`` pieces each in either order.

    :param number: [C] of the corners among the candidates
    :param corners: in the radar frame
    :param pieces: [2, K, ACROSS] which pieces are taken to be in sight
    """

    number: NDArray[np.int32]
    corners: CornerEdges
    cells: Cells
    pieces: Mask
    wavelength_m: float

    @staticmethod
    def of(number: NDArray[np.int32], corners: CornerEdges, wavelength_m: float) -> Apertures:
        """With all pieces, as if nothing stood before them."""
        cells = _cells_along(corners, wavelength_m)
        return Apertures(number, corners, cells, np.ones((2, len(cells), ACROSS), dtype=bool), wavelength_m)

    @cached_property
    def orders(self) -> tuple[FaceOrder, FaceOrder]:
        """Both orders of the faces."""
        corners, of, reach, beyond = self.corners, self.cells.corner, self.cells.reach, self.cells.beyond
        height, angle, opening = corners.height[of], corners.angle[of], corners.opening[of]
        return (
            FaceOrder(height, angle, opening, reach, beyond),
            FaceOrder(height, opening - angle, opening, reach[:, ::-1], beyond),
        )

    def take(self, mask: Mask) -> Apertures:
        """Those of some corners."""
        some = self._of_cells(mask[self.cells.corner])
        cells = replace(some.cells, corner=(np.cumsum(mask) - 1)[some.cells.corner])
        return replace(some, number=self.number[mask], corners=self.corners.take(mask), cells=cells)

    def without_hidden(self) -> Apertures:
        """Without the cells of which no piece is in sight."""
        return self._of_cells(np.asarray(self.pieces.any(axis=(0, 2))))

    def _of_cells(self, mask: Mask) -> Apertures:
        return replace(self, cells=self.cells.take(mask), pieces=self.pieces[:, mask])

    def integrals(self) -> Complex:
        """[2, C] F of both orders, over the pieces in sight."""
        total, along = np.zeros((2, len(self.number)), dtype=np.complex128), self.cells.shares_along(self.wavelength_m)
        for order, one in enumerate(self.orders):
            across = (one.pieces_across(self.wavelength_m) * self.pieces[order]).sum(axis=1)
            np.add.at(total[order], self.cells.corner, along * across)
        return total

    def ends_along(self) -> tuple[Real, Real]:
        """v [C] at either end of the cells of each corner."""
        low, high = np.full(len(self.number), np.inf), np.full(len(self.number), -np.inf)
        np.minimum.at(low, self.cells.corner, self.cells.start)
        np.maximum.at(high, self.cells.corner, self.cells.stop)
        return low, high

    def widths_across(self) -> Real:
        """v [C] from the edge to the aperture's narrower end, weighted with the cells' shares."""
        ends = [one.longer(one.end[:, None])[:, 0] for one in self.orders]
        v = np.sqrt(4.0 * np.minimum(*ends) / self.wavelength_m)
        weight, count = np.abs(self.cells.shares_along(self.wavelength_m)), len(self.number)
        total = np.bincount(self.cells.corner, weight, count)
        return np.bincount(self.cells.corner, weight * v, count) / np.maximum(total, 1e-300)

    def in_sight(self, sight: Callable[[Real, Real], Mask]) -> Apertures:
        """With those pieces to which both legs are free."""
        corners, cells, seen = self.corners, self.cells, self.pieces.reshape(2, -1).copy()
        for order, one in enumerate(self.orders):
            place = (cells.corner, cells.z, one.beam(self.wavelength_m))
            for leg, face in enumerate((order, 1 - order)):
                # What is hidden on the first face need not be looked at on the second.
                here = np.flatnonzero(seen[order])
                into, normal = (np.ascontiguousarray(axes[:, face]) for axes in (corners.into, corners.normal))
                point = _points_before_faces(
                    here, leg == 0, place, one.bend, (corners.foot, corners.direction), (into, normal)
                )
                seen[order, here] = sight(np.zeros_like(point), point)
        return replace(self, pieces=seen.reshape(self.pieces.shape))


@compiled()
def _points_before_faces(pieces, first, cells, bend, edge, face):
    """[n, 3] where the waves of pieces of the aperture meet a face, lifted off by the ray caster's error.

    :param pieces: [n] K-th cell times ``ACROSS`` and the piece of it; :param first: on the first face, or the second
    :param cells: corner [K], z along the edge [K] and b on the second face [K, ACROSS] [m]
    :param bend: [K] of :class:`FaceOrder`
    :param edge: foot [C, 3], direction [C, 3]; :param face: into [C, 3], normal [C, 3] of the one that is met
    """
    corner, along, across = cells
    below, above, opening = bend
    foot, direction = edge
    into, normal = face
    points = np.empty((len(pieces), 3))
    for n in range(len(pieces)):
        k = pieces[n] // ACROSS
        c, z, away, square = corner[k], along[k], across[k, pieces[n] % ACROSS], 0.0
        if first:
            share = below[k] / (below[k] + away * opening[k])  # of the way from the image to the second face
            away, z = above[k] * away * share / below[k], z * share
        for i in range(3):
            points[n, i] = foot[c, i] + z * direction[c, i] + away * into[c, i]
            square += points[n, i] * points[n, i]
        margin = ray_margin_m(np.sqrt(square))
        for i in range(3):
            points[n, i] += margin * normal[c, i]
    return points
