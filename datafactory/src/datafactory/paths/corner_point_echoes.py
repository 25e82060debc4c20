"""Echoes of trihedral corners: three bounces, in each of the six orders of the faces, by physical optics.

docs/notes/corners.md says why. Over the outline of the three faces, seen from the radar, where it overlaps with itself
turned by 180 deg around the point X that they share, in polar coordinates around X and with R = |X|,

    F = (1 / 2 pi) int (1 - exp(j k Delta(theta))) d(theta),    A = Gamma_1 Gamma_2 Gamma_3 lambda / (8 pi R) F,

with Delta how much longer the way by the outline is than 2 R, in either direction the shorter one. The face met first
is that at theta, the last that at theta + pi: that gives the order of the slabs' coefficients and how they turn the
polarisation.

Delay: that of the image 2 X - x, the table's law of specular paths with s = 2 X, H = -1; of a corner within a Fresnel
zone that of a point. Sight is tested in 24 directions around X. The sensor's own parallax over the aperture is that of
its distance to X.
"""

from __future__ import annotations

import numpy as np

from datafactory.paths.candidates import CORNER as CORNER_ECHO
from datafactory.paths.candidates import Candidates
from datafactory.paths.corner_aperture import BEAM_ZONES, SPREAD_M
from datafactory.paths.corner_echoes import FAINTEST_DBSM, WIDE, over_faces
from datafactory.paths.corner_points import CornerPoints
from datafactory.paths.diffraction import GRAZING, NEAREST_M, Heard
from datafactory.paths.geometry import ray_margin_m
from datafactory.paths.mirrors import AHEAD_M
from datafactory.paths.table import CORNER, ScatteredPaths, SpecularPaths
from datafactory.paths.view import View
from shared.physics.compiled import compiled
from shared.physics.units import db_to_power
from shared.physics.vectors import Index, Mask, Real, unit

AROUND = 720
"""Directions around the apex over which the aperture is summed."""
LOOKS = 24
"""Directions around the apex in which sight is tested; AROUND is a multiple of it."""
OFF_CYCLES = 0.125
"""Largest turn of the phase across the aperture [cycles] of a corner that counts as right-angled."""


class CornerPointEchoes:
    """Echoes of trihedral corners to the radar, at the origin."""

    def __init__(self, view: View) -> None:
        self._view, points, wavelength = view, view.corner_points, view.wavelength_m
        range_m = np.linalg.norm(points.apex, axis=1)
        home = -unit(points.apex)
        facing = (np.einsum("qij,qj->qi", points.axes, home) > GRAZING).all(axis=1)
        facing &= (range_m > NEAREST_M) & (points.apex[:, 0] >= -AHEAD_M)
        points, range_m, home = points.take(facing), range_m[facing], home[facing]
        face, rim, width, longer = _outline(points, home)
        opposite = np.roll(np.arange(AROUND), AROUND // 2)
        longer = np.minimum(longer, longer[:, opposite])
        width = np.minimum(width, width[:, opposite])
        used = np.minimum(width.max(axis=1, initial=0.0), BEAM_ZONES * np.sqrt(0.5 * wavelength * range_m))
        square = 4.0 * used * points.off_square < OFF_CYCLES * wavelength
        local = 1.0 - np.exp(2j * np.pi * longer / wavelength - (longer / SPREAD_M) ** 2)
        heard = np.pi * range_m**2 * np.abs(local.mean(axis=1)) ** 2 > float(db_to_power(FAINTEST_DBSM))
        self._off_square = int((~square).sum())
        chosen = np.flatnonzero(square & heard)
        self._points, self._face, self._rim, self._local = points.take(chosen), face[chosen], rim[chosen], local[chosen]
        zones = np.sqrt(4.0 * longer[chosen] / wavelength)
        self._wide = np.median(zones, axis=1) >= WIDE if len(chosen) else np.zeros(0, dtype=bool)
        self._scale = wavelength / (8.0 * np.pi * range_m[chosen])

    @property
    def candidates(self) -> Candidates:
        """Of every corner: what it would send back if all directions of its aperture were in phase."""
        return Candidates.of(CORNER_ECHO, self._points.apex, (self._scale * np.abs(self._local).mean(axis=1)) ** 2)

    def seen(self, worth: Mask) -> Heard:
        """Small corners and wide ones, with the delay law that suits either, and counts."""
        number = np.flatnonzero(worth).astype(np.int32)
        points, face, local = self._points.take(number), self._face[number], self._local[number]
        opposite = np.roll(np.arange(AROUND), AROUND // 2)
        seen = _in_sight(points, face, self._rim[number], self._view)
        local = np.where(seen & seen[:, opposite], local, 0.0)
        amplitude = np.zeros(len(points), dtype=np.complex128)
        for first in range(3):
            for last in {0, 1, 2} - {first}:
                here = (face == first) & (face[:, opposite] == last)
                order = (first, 3 - first - last, last)
                gamma = over_faces(self._view, order, points.face_mesh, points.axes, unit(points.apex))
                amplitude += np.conj(gamma) * np.where(here, local, 0.0).sum(axis=1) / AROUND
        amplitude *= self._scale[number]
        visible, wide, owner = amplitude != 0.0, self._wide[number], points.object_index
        small = ScatteredPaths.of_points(points.apex, points.velocity, amplitude, owner, CORNER, 3, number)
        turned = np.tile(-np.eye(3), (len(points), 1, 1))
        large = SpecularPaths.of(2.0 * points.apex, 2.0 * points.velocity, turned, amplitude, owner, CORNER, 3, number)
        counts = {"corner_points_off_square": self._off_square, "corner_points_hidden": int((~visible).sum())}
        return small.take(visible & ~wide), large.take(visible & wide), counts


def _outline(points: CornerPoints, home: Real) -> tuple[Index, Real, Real, Real]:
    """Around the apex as the radar sees it: the face's number [Q, M], its rim [Q, M, 3], its width [Q, M], and how much
    longer the way from the radar by the rim to the radar's image is than 2 R [Q, M] [m].

    A direction w across the sight belongs to the face i whose vector d = w + t s, s towards the radar, has d . u_i = 0
    and no negative component along the other two edges: the largest t = -(w . u_i) / (s . u_i).
    """
    theta = 2.0 * np.pi * (np.arange(AROUND) + 0.5) / AROUND
    start = unit(np.cross(home, points.axes[:, 0]))
    frames = (points.apex, points.axes, points.reach, home, start, np.cross(home, start))
    return _around(*map(np.ascontiguousarray, frames), np.cos(theta), np.sin(theta))


@compiled()
def _around(apex, axes, reach, home, start, aside, cosine, sine):
    """:func:`_outline` of directions with ``cosine`` and ``sine`` [M] from ``start`` to ``aside`` [Q, 3]."""
    count, directions = len(apex), len(cosine)
    face = np.empty((count, directions), dtype=np.int64)
    rim = np.empty((count, directions, 3))
    width, longer = np.empty((count, directions)), np.empty((count, directions))
    samples = reach.shape[2]
    across, towards, toward_edge = np.empty(3), np.empty(3), np.empty(3)
    for q in range(count):
        for k in range(3):
            toward_edge[k] = home[q, 0] * axes[q, k, 0] + home[q, 1] * axes[q, k, 1] + home[q, 2] * axes[q, k, 2]
        range_m = np.sqrt(apex[q, 0] ** 2 + apex[q, 1] ** 2 + apex[q, 2] ** 2)
        for m in range(directions):
            for i in range(3):
                across[i] = cosine[m] * start[q, i] + sine[m] * aside[q, i]
            largest, best = -np.inf, 0
            for k in range(3):
                along = across[0] * axes[q, k, 0] + across[1] * axes[q, k, 1] + across[2] * axes[q, k, 2]
                rise = -along / toward_edge[k]
                if rise > largest:
                    largest, best = rise, k
            one = other = square = 0.0
            for i in range(3):
                towards[i] = across[i] + largest * home[q, i]
                one += towards[i] * axes[q, (best + 1) % 3, i]
                other += towards[i] * axes[q, (best + 2) % 3, i]
                square += towards[i] * towards[i]
            place = min(max(np.arctan2(other, one) / (0.5 * np.pi) * samples - 0.5, 0.0), samples - 1.0)
            below = min(int(place), samples - 2)
            share = place - below
            reached = (1.0 - share) * reach[q, best, below] + share * reach[q, best, below + 1]
            face[q, m], width[q, m] = best, reached / np.sqrt(square)
            out = back = 0.0
            for i in range(3):
                rim[q, m, i] = apex[q, i] + width[q, m] * towards[i]
                out += rim[q, m, i] ** 2
                back += (2.0 * apex[q, i] - rim[q, m, i]) ** 2
            longer[q, m] = max(np.sqrt(out) + np.sqrt(back) - 2.0 * range_m, 0.0)
    return face, rim, width, longer


def _in_sight(points: CornerPoints, face: Index, rim: Real, view: View) -> Mask:
    """[Q, M] whether the faces are in sight in these directions: half-way to the rim, or within the first zones."""
    step = AROUND // LOOKS
    looks = np.arange(LOOKS) * step + step // 2
    off = rim[:, looks] - points.apex[:, None]
    length = np.maximum(np.linalg.norm(off, axis=2), 1e-12)
    zone = np.sqrt(0.5 * view.wavelength_m * np.linalg.norm(points.apex, axis=1))[:, None]
    place = points.apex[:, None] + (0.5 * np.minimum(length, BEAM_ZONES * zone) / length)[..., None] * off
    normal = points.axes[np.arange(len(points))[:, None], face[:, looks]]
    place = place + ray_margin_m(np.linalg.norm(place, axis=2))[..., None] * normal
    flat = place.reshape(-1, 3)
    seen = view.sight(np.zeros_like(flat), flat).reshape(len(points), LOOKS)
    return np.repeat(seen, step, axis=1)
