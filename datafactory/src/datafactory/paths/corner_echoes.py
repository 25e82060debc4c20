"""Echoes of right-angled corners by physical optics: two bounces at an edge, three at a point of three faces.

docs/notes/corners.md has the method, the delay laws and the limits. **At an edge** the first face reflects as a plane,
and the field that it throws on the second face is integrated there (Griesser and Balanis, IEEE Trans. Antennas Propag.
35 (1987) 1137). In the plane across the edge let the radar stand at distance h and at the angle phi from the first
face, the second face at the angle psi. A wave that meets the second face at distance b from the edge has come from the
first at

    a = h b sin(phi + psi) / (h sin(phi) + b sin(psi)),

so that b ends where the second face ends or where a does. Its whole way is

    L(b) = sqrt(h^2 + b^2 - 2 h b cos(psi + phi)) + sqrt(h^2 + b^2 - 2 h b cos(psi - phi)),

least at L* = 2 h sin(psi), b* = h cos(psi) / cos(phi): at the edge itself for a right angle. Along the edge the way
grows by E(z) = 2 (sqrt(h^2 + z^2) - h) from the foot of the perpendicular. With v = sqrt(4 (L - L*) / lambda), signed,

    F = 1 / (1 + j) int exp(j pi v^2 / 2) dv,      A = Gamma_1 Gamma_2 lambda / (4 pi L*) F_across F_along,

and an endless plane has F = 1. Ends whose way is more than ``SPREAD_M`` longer fade out; their echo would come from
elsewhere (:mod:`datafactory.paths.corner_aperture`).

**At a point** X, R away, the aperture is the outline of the three faces as the radar sees it, where it overlaps with
itself turned by 180 deg around X,

    F = (1 / 2 pi) int (1 - exp(j k Delta(theta))) d(theta),    A = Gamma_1 Gamma_2 Gamma_3 lambda / (8 pi R) F,

with Delta how much longer the way by the outline is than 2 R, in either direction the shorter one. The face met first
is that at theta, the last that at theta + pi. The image is that of 2 X - x: s = 2 X, H = -1.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import fresnel

from datafactory.paths.candidates import CORNER as CORNER_ECHO
from datafactory.paths.candidates import Candidates
from datafactory.paths.corner_aperture import BEAM_ZONES, SPREAD_M, Apertures, longer_along, place_of
from datafactory.paths.corners import CornerEdges, CornerPoints
from datafactory.paths.diffraction import GRAZING, NEAREST_M, Heard, along_array
from datafactory.paths.geometry import ray_margin_m
from datafactory.paths.mirrors import AHEAD_M
from datafactory.paths.table import CORNER, ScatteredPaths, SpecularPaths
from datafactory.paths.view import View, polarization_axis
from shared.physics.compiled import compiled
from shared.physics.units import db_to_power
from shared.physics.vectors import Complex, Index, Mask, Real, dots, lengths, unit

FAINTEST_DBSM = -45.0
"""Echoes of smaller cross sections are left out."""
WIDE = 1.0
"""v from the edge to the aperture's end from which the echo has the delay of an image; below, that of a point."""
SHORT = 1.0
"""v between phase centre and an end of the edge below which a corner ends there as a body would."""
AROUND = 720
"""Directions around the apex over which the aperture is summed."""
OPPOSITE = np.roll(np.arange(AROUND), AROUND // 2)
LOOKS = 24
"""Directions around the apex in which sight is tested; AROUND is a multiple of it."""
OFF_CYCLES = 0.125
"""Largest turn of the phase across the aperture [cycles] of a corner that counts as right-angled."""


class CornerEchoes:
    """Echoes of corners to the radar, at the origin: two paths a corner, one for each order of its faces."""

    def __init__(self, view: View) -> None:
        self._view = view
        facing, self._section = _facing(view.corner_edges, view.wavelength_m)
        self._corners = view.corner_edges.take(facing)

    @property
    def candidates(self) -> Candidates:
        """Of every corner that the radar looks into: its apertures are cut into pieces for those that are followed."""
        power = self._view.wavelength_m**2 * self._section / (64.0 * np.pi**3 * self._corners.height**4)
        return Candidates.of(CORNER_ECHO, self._corners.nearest(), power)

    def seen(self, worth: Mask) -> Heard:
        """Small corners and wide ones, with the delay law that suits either, and counts.

        Most corners of a scene are hidden: the integrals are of those in sight.
        """
        wavelength, number = self._view.wavelength_m, np.flatnonzero(worth).astype(np.int32)
        every = Apertures.of(number, self._corners.take(number), wavelength)
        looked_at = every.in_sight(self._view.sight)
        in_sight = np.zeros(len(number), dtype=bool)
        np.logical_or.at(in_sight, every.cells.corner, looked_at.pieces.any(axis=(0, 2)))
        possible = np.abs(every.take(in_sight).integrals()).sum(axis=0)
        some = looked_at.take(in_sight)
        heard = np.pi * some.corners.height**2 * possible**2 > float(db_to_power(FAINTEST_DBSM))
        counts = {"corners_faint": int((~heard).sum()), "corners_hidden": int((~in_sight).sum())}
        return *_paths(self._view, some.take(heard).without_hidden()), counts


def _facing(corners: CornerEdges, wavelength_m: float) -> tuple[Index, Real]:
    """The corners that the radar looks into, in front of it, and that may be heard: their indices, and the cross
    sections that no echo exceeds."""
    inside = (corners.angle > GRAZING) & (corners.angle < corners.opening - GRAZING) & (corners.height > NEAREST_M)
    section = _bound(corners, wavelength_m)
    heard = section > float(db_to_power(FAINTEST_DBSM))
    index = np.flatnonzero(inside & heard & (corners.nearest()[:, 0] >= -AHEAD_M))
    return index, section[index]


def _bound(corners: CornerEdges, wavelength_m: float) -> Real:
    """[C] cross section [m^2] that no echo of a corner exceeds.

    |F| is at most the width in v over sqrt(2), and 2 beyond 3 zones. From an end at v on, it is at most 1 / (pi v) of
    either end along the edge.
    """
    h = np.maximum(corners.height, NEAREST_M)
    narrow = np.minimum(corners.strips[:, 2:4].max(axis=1), corners.strips[:, 4:6].max(axis=1))
    width, length = np.zeros((2, len(corners)))
    np.maximum.at(width, corners.corner_of_strip, narrow)
    np.add.at(length, corners.corner_of_strip, corners.strips[:, 1] - corners.strips[:, 0])
    zone = np.sqrt(0.25 * wavelength_m * h)
    across = np.minimum(2.0 * width / zone, 2.0)
    beside = np.sqrt(4.0 * longer_along(lengths(corners.nearest() - corners.foot), h) / wavelength_m)
    along = np.minimum(np.minimum(length / zone, 2.0), 2.0 / (np.pi * np.maximum(beside, 1e-3)))
    return np.pi * (h * across * along) ** 2


def _paths(view: View, apertures: Apertures) -> tuple[ScatteredPaths, SpecularPaths]:
    """The paths of both orders in the delay law that suits each corner."""
    wavelength, number, corners = view.wavelength_m, apertures.number, apertures.corners
    shortest = 2.0 * corners.height * np.sin(corners.opening)
    shares, width = apertures.integrals(), apertures.widths_across()
    low, high = apertures.ends_along()
    beside = (low >= 0.0) | (high <= 0.0)
    centre = np.where(beside | (high - low < 2.0 * WIDE), _phase_centre(low, high), 0.0)
    point = corners.foot + place_of(centre, corners.height, wavelength)[:, None] * corners.direction
    level = along_array(corners.direction, unit(point))
    image = ~beside & np.where(level, high - low >= 2.0 * WIDE, width >= WIDE)
    # A corner that is short along its edge moves as a body; of a long one the edge slides through the point.
    body = np.minimum(centre - low, high - centre) < SHORT
    velocity = corners.velocity_at(point)
    slides = dots(velocity, corners.direction)[:, None] * corners.direction
    velocity = velocity - np.where(body[:, None], 0.0, slides)
    both, images = np.tile(np.arange(len(corners)), 2), np.tile(image, 2)
    gamma = np.concatenate([
        over_faces(view, order, corners.face_mesh, corners.normal, unit(point)) for order in ((0, 1), (1, 0))
    ])  # fmt: skip
    axes = np.concatenate([_turn(corners, order) for order in (0, 1)])
    amplitude = np.conj(gamma) * (wavelength / (4.0 * np.pi * shortest))[both] * shares.reshape(-1)
    owner = corners.object_index[both]
    at_foot = corners.velocity_at(corners.foot)[both]
    specular = SpecularPaths.of(
        _moved_by(axes, corners.foot[both]), _moved_by(axes, at_foot), axes, amplitude, owner, CORNER, 2, number[both],
    )  # fmt: skip
    # The integral's phase counts from L*, the table's from the way to the point and back.
    rest = shortest - 2.0 * np.linalg.norm(point, axis=1)
    lag = np.exp(2j * np.pi * (rest / wavelength % 1.0))[both]
    scattered = ScatteredPaths.of_points(point[both], velocity[both], amplitude * lag, owner, CORNER, 2, number[both])
    return scattered.take(~images), specular.take(images)


def _moved_by(turn: Real, vector: Real) -> Real:
    """[n, 3] (1 - H) x: where the image of the origin stands that is turned about a line through x, or its velocity."""
    return vector - np.einsum("cij,cj->ci", turn, vector)


def _phase_centre(low: Real, high: Real) -> Real:
    """v [C] of the point whose echo's phase turns as the integral from ``low`` to ``high`` does where the radar moves.

    F(s) = int_(low - s)^(high - s) has the phase of exp(j pi (v - s)^2 / 2) with v = -Im(F' / F) / pi at s = 0.
    """
    sine, cosine = fresnel(np.stack([low, high]))
    whole = (cosine[1] - cosine[0]) + 1j * (sine[1] - sine[0])
    slope = np.exp(0.5j * np.pi * low**2) - np.exp(0.5j * np.pi * high**2)
    turn = -(slope / np.where(whole == 0.0, 1.0, whole)).imag / np.pi
    return np.clip(np.where(whole == 0.0, 0.5 * (low + high), turn), low, high)


def _turn(corners: CornerEdges, order: int) -> Real:
    """[C, 3, 3] the product of both faces' reflections: the rotation by twice the opening about the edge."""
    first, second = corners.normal[:, order], corners.normal[:, 1 - order]
    mirror = [np.eye(3) - 2.0 * n[:, :, None] * n[:, None, :] for n in (first, second)]
    return mirror[1] @ mirror[0]


def over_faces(view: View, order: Sequence[int], mesh: Index, normal: Real, direction: Real) -> Complex:
    """[C] what faces, one after another, leave of a field of the TX's polarisation, as the RX hears it.

    :param order: of the faces; :param mesh: [C, faces]; :param normal: [C, faces, 3] unit
    :param direction: [C, 3] unit, in which the field leaves the radar
    """
    sent, received = (polarization_axis(direction, which) for which in view.settings.polarization)
    onward, field = direction, sent.astype(np.complex128)
    for face in order:
        onward, field = view.slabs.reflected(mesh[:, face], onward, np.ascontiguousarray(normal[:, face]), field)
        field = view.slabs.unscattered(mesh[:, face])[:, None] * field
    return np.einsum("ci,ci->c", field, received)


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
        longer = np.minimum(longer, longer[:, OPPOSITE])
        width = np.minimum(width, width[:, OPPOSITE])
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
        seen = _in_sight(points, face, self._rim[number], self._view)
        local = np.where(seen & seen[:, OPPOSITE], local, 0.0)
        amplitude = np.zeros(len(points), dtype=np.complex128)
        for first in range(3):
            for last in {0, 1, 2} - {first}:
                here = (face == first) & (face[:, OPPOSITE] == last)
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
