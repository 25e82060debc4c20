"""Echoes of right-angled corners: two bounces, once in each order, by physical optics.

A corner turns every wave back to where it comes from. The ray that would do so for the radar itself runs into the edge,
where geometric optics has nothing. Physical optics has: the first face reflects as a plane (its image of the radar),
and the field that it throws on the second face is integrated there (Griesser and Balanis, IEEE Trans. Antennas
Propag. 35 (1987) 1137). In the plane across the edge let the radar stand at distance h and at the angle phi from the
first face, the second face at the angle psi (a right angle and a little). A wave that meets the second face at distance
b from the edge has come from the first at

    a = h b sin(phi + psi) / (h sin(phi) + b sin(psi)),

so that b ends where the second face ends or where a does. Its whole way is

    L(b) = sqrt(h^2 + b^2 - 2 h b cos(psi + phi)) + sqrt(h^2 + b^2 - 2 h b cos(psi - phi)),

least at L* = 2 h sin(psi), b* = h cos(psi) / cos(phi): at the edge itself for a right angle. Along the edge the way
grows by E(z) = 2 (sqrt(h^2 + z^2) - h) from the foot of the perpendicular. With v = sqrt(4 (L - L*) / lambda), signed,
both integrals are Fresnel's,

    F = 1 / (1 + j) int exp(j pi v^2 / 2) dv,      A = Gamma_1 Gamma_2 lambda / (4 pi L*) F_across F_along,

and an endless plane has F = 1. Each order fills the half of the aperture that enters on its own first face: at a right
angle both together make it once, of the width 2 min(D_1 sin(phi), D_2 cos(phi)). Far away that is
8 pi a^2 b^2 / lambda^2 for faces of a x b seen on axis. Ends whose way is more than ``SPREAD_M`` longer fade out; their
echo would come from elsewhere.

The polarisation turns as the two planes turn it: TE and TM parts of both slabs' coefficients. Sight is tested at points
of both faces within the first Fresnel zones; the aperture counts where both legs are free.

**Delay.** The image of the TX in both faces is the TX turned by 2 psi about the edge: c tau = |x_j - (s + H x_i)| with
H that rotation, the table's law of specular paths. It is exact where the aperture is wider than a Fresnel zone. A
smaller corner sends back like a point, the law of scattered paths. Between elements w apart across the edge the laws
differ by w^2 / (4 h). The width decides that lies along the array (:func:`.diffraction.along_array`). A corner beside
the foot of the perpendicular also sends back like a point, from where its integral's phase has its centre.

Limits: openings within ``OFF_SQUARE_DEG`` of a right angle. There a wave of either order leaves 6 deg off its way at
most, and its specular points lie within sin(3 deg) sqrt(2 h / lambda), 0.8 to 9 Fresnel zones at 0.5 to 60 m, of the
edge. Beyond, an acute corner has mirror paths of its own and an obtuse one sends nothing back. Faces reach a few
wavelengths or more. Left out: diffraction at the far end of the first face, and what is lit through panes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import fresnel

from datafactory.paths.corner_edges import CornerEdges
from datafactory.paths.diffraction import NEAREST_M, Sight, along_array
from datafactory.paths.mirror_feet import AHEAD_M
from datafactory.paths.panes import Polarization, polarization_axis, ray_margin_m
from datafactory.paths.smooth_faces import mirrored_by_slabs
from datafactory.paths.table import CORNER, ScatteredPaths, SpecularPaths
from datafactory.paths.unfold import unit
from datafactory.scenes.materials.table import Material
from shared.physics.units import SPEED_OF_LIGHT, db_to_power

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
Index = NDArray[np.int64]

SPREAD_M = 0.15
"""Difference in path length at which an end of the aperture has faded to 1/e [m]: half a range cell of the default
radar."""
FADED = 3.0
"""Times ``SPREAD_M``, beyond which an end is left out: exp(-9)."""
FAINTEST_DBSM = -45.0
"""Echoes of smaller cross sections are left out."""
GRAZING = 1e-6
"""Angles from a face [rad] below which the sensor counts as within it."""
CELLS = (8, 48)
"""Cells along a strip: where the aperture has a constant width, and where it has not."""
BEAM_ZONES = 2.0
"""Half width of the aperture in which sight is tested [Fresnel radii sqrt(lambda h / 2)]."""
ACROSS = 3
"""Points across the aperture in which sight is tested, for each order."""
WIDE = 1.0
"""v from the edge to the aperture's end from which the echo has the delay of an image; below, that of a point."""
SHORT = 1.0
"""v between phase centre and an end of the edge below which a corner ends there as a body would."""


@dataclass(frozen=True)
class _Views:
    """C corners as the radar at the origin sees them, in their own coordinates.

    :param foot: [C, 3] of the perpendicular on the edge's line [m]; :param foot_z: [C] its place along the edge
    :param height: [C] h [m]; :param angle: [C] of the radar from the first face; :param opening: [C] psi [rad]
    """

    foot: Real
    foot_z: Real
    height: Real
    angle: Real
    opening: Real

    def take(self, index: NDArray) -> _Views:
        return _Views(**{item.name: getattr(self, item.name)[index] for item in fields(self)})

    @property
    def shortest(self) -> Real:
        """[C] L* [m]."""
        return 2.0 * self.height * np.sin(self.opening)


@dataclass(frozen=True)
class _Cells:
    """K pieces of the corners along their edges.

    :param corner: [K]; :param start, stop: [K] v along the edge
    :param share: [K] of F_along
    :param z: [K] its middle, from the foot [m]; :param reach: [K, 2] of the faces there [m]
    :param beyond: [K] z over that of the corner's nearer end, less 1; infinite where the foot lies on the edge
    """

    corner: Index
    start: Real
    stop: Real
    share: Complex
    z: Real
    reach: Real
    beyond: Real

    def take(self, index: NDArray) -> _Cells:
        return _Cells(**{item.name: getattr(self, item.name)[index] for item in fields(self)})


def corner_echoes(
    corners: CornerEdges,
    slabs: Sequence[Material],
    frequency_hz: float,
    sight: Sight,
    polarization: tuple[Polarization, Polarization] = ("V", "V"),
) -> tuple[ScatteredPaths, SpecularPaths, dict[str, int]]:
    """Echoes of corners to the radar, at the origin: two paths a corner, one for each order of its faces.

    :param corners: in the radar frame, ``corners_of(merged_scene).seen_from(pose)``
    :param slabs: material of each merged mesh; :param frequency_hz: mid-sweep
    :param sight: whether nothing stands between points
    :param polarization: of TX and RX
    :return: small corners and wide ones, with the delay law that suits either, and counts
    """
    wavelength = SPEED_OF_LIGHT / frequency_hz
    facing, views = _facing(corners, wavelength)
    corners = corners.take(facing)
    cells = _cells_along(corners, views, wavelength)
    open_sky = np.ones((2, len(cells.corner), ACROSS), dtype=bool)
    possible = np.abs(_integrals(cells, views, wavelength, open_sky)).sum(axis=0)
    heard = np.pi * views.height**2 * possible**2 > float(db_to_power(FAINTEST_DBSM))
    faint = len(corners) - int(heard.sum())
    corners, views, cells = _kept(heard, corners, views, cells)
    seen = _in_sight(corners, cells, views, wavelength, sight)
    in_sight = np.zeros(len(corners), dtype=bool)
    np.logical_or.at(in_sight, cells.corner, seen.any(axis=(0, 2)))
    cells, seen = _without_hidden(cells, seen)
    hidden = len(corners) - int(in_sight.sum())
    shares = _integrals(cells, views, wavelength, seen)[:, in_sight]
    low, high = _ends(cells, len(corners))
    width = _widths(cells, views, wavelength, len(corners))
    corners, views = corners.take(in_sight), views.take(in_sight)
    scattered, specular = _paths(
        corners, views, shares, (low[in_sight], high[in_sight]), width[in_sight], slabs, frequency_hz, polarization
    )
    return scattered, specular, {"corners_faint": faint, "corners_hidden": hidden}


def _facing(corners: CornerEdges, wavelength_m: float) -> tuple[Index, _Views]:
    """The corners that the radar looks into, in front of it, and that may be heard."""
    foot_z = -np.einsum("ci,ci->c", corners.origin, corners.direction)
    foot = corners.origin + foot_z[:, None] * corners.direction
    height = np.linalg.norm(foot, axis=1)
    towards = -unit(foot)
    angle = np.arctan2(
        np.einsum("ci,ci->c", towards, corners.normal[:, 0]), np.einsum("ci,ci->c", towards, corners.into[:, 0])
    )
    opening = corners.opening
    views = _Views(foot, foot_z, height, angle, opening)
    inside = (angle > GRAZING) & (angle < opening - GRAZING) & (height > NEAREST_M)
    low, high = corners.extent()
    nearest = foot + (np.clip(foot_z, low, high) - foot_z)[:, None] * corners.direction
    heard = _bound(corners, views, nearest, wavelength_m) > float(db_to_power(FAINTEST_DBSM))
    index = np.flatnonzero(inside & heard & (nearest[:, 0] >= -AHEAD_M))
    return index, views.take(index)


def _bound(corners: CornerEdges, views: _Views, nearest: Real, wavelength_m: float) -> Real:
    """[C] cross section [m^2] that no echo of a corner exceeds.

    |F| is at most the width in v over sqrt(2), and 2 beyond 3 zones. From an end at v on, it is at most 1 / (pi v) of
    either end along the edge.
    """
    h = np.maximum(views.height, NEAREST_M)
    narrow = np.minimum(corners.strips[:, 2:4].max(axis=1), corners.strips[:, 4:6].max(axis=1))
    width, length = np.zeros((2, len(corners)))
    np.maximum.at(width, corners.corner_of_strip, narrow)
    np.add.at(length, corners.corner_of_strip, corners.strips[:, 1] - corners.strips[:, 0])
    zone = np.sqrt(0.25 * wavelength_m * h)
    across = np.minimum(2.0 * width / zone, 2.0)
    beside = np.sqrt(4.0 * _along(np.linalg.norm(nearest - views.foot, axis=1), h) / wavelength_m)
    along = np.minimum(np.minimum(length / zone, 2.0), 2.0 / (np.pi * np.maximum(beside, 1e-3)))
    return np.pi * (h * across * along) ** 2


def _kept(
    mask: NDArray[np.bool_], corners: CornerEdges, views: _Views, cells: _Cells
) -> tuple[CornerEdges, _Views, _Cells]:
    """Corners, views and cells of those that stay."""
    place = np.cumsum(mask) - 1
    cells = cells.take(mask[cells.corner])
    return corners.take(mask), views.take(mask), replace(cells, corner=place[cells.corner])


def _along(z: Real, height: Real) -> Real:
    """E [m]: how much longer the way by a point z along the edge is than that by the foot."""
    return 2.0 * z * z / (np.hypot(height, z) + height)


def _place(v: Real, height: Real, wavelength_m: float) -> Real:
    """z [m] along the edge of a signed v."""
    half = 0.125 * wavelength_m * v * v
    return np.sign(v) * np.sqrt(half * (half + 2.0 * height))


def _cells_along(corners: CornerEdges, views: _Views, wavelength_m: float) -> _Cells:
    """The strips in cells that are narrow near the foot of the perpendicular, and F_along of each."""
    of = corners.corner_of_strip
    height, foot_z = views.height[of], views.foot_z[of]
    low, high = corners.extent()
    nearest = np.clip(views.foot_z, low, high) - views.foot_z
    least = _along(nearest, views.height)
    farthest = _place(np.sqrt(4.0 * (least + FADED * SPREAD_M) / wavelength_m), views.height, wavelength_m)[of]
    from_foot = corners.strips[:, :2] - foot_z[:, None]
    within = np.clip(from_foot, -farthest[:, None], farthest[:, None])
    used = np.flatnonzero(within[:, 1] > within[:, 0])
    within, of, height = within[used], of[used], height[used]
    strip, place = corners.strips[used], views.foot_z[of]
    bent = np.abs(strip[:, [3, 5]] - strip[:, [2, 4]]).max(axis=1, initial=0.0) > 1e-4
    bent |= nearest[of] != 0.0
    count = np.where(bent, CELLS[1], CELLS[0])
    v = np.sign(within) * np.sqrt(4.0 * _along(within, height[:, None]) / wavelength_m)
    stretched = np.arcsinh(v)
    index = np.repeat(np.arange(len(used)), count)
    step = np.arange(len(index)) - np.repeat(np.cumsum(count) - count, count)
    width = (stretched[:, 1] - stretched[:, 0]) / count
    edges = [np.sinh(stretched[index, 0] + (step + k) * width[index]) for k in (0.0, 0.5, 1.0)]
    edges[0][step == 0] = v[index[step == 0], 0]
    last = step == count[index] - 1
    edges[2][last] = v[index[last], 1]
    z = _place(edges[1], height[index], wavelength_m)
    share = np.clip((z + place[index] - strip[index, 0]) / (strip[index, 1] - strip[index, 0]), 0.0, 1.0)[:, None]
    reach = (1.0 - share) * strip[index][:, [2, 4]] + share * strip[index][:, [3, 5]]
    corner = of[index]
    ends = [_from_foot(edge, 0.25 * wavelength_m * edge**2 - least[corner]) for edge in (edges[0], edges[2])]
    beside = nearest[corner] != 0.0
    beyond = np.where(beside, z / np.where(beside, nearest[corner], 1.0) - 1.0, np.inf)
    return _Cells(corner, edges[0], edges[2], ends[1] - ends[0], z, reach, beyond)


def _from_foot(v: Real, longer_m: Real) -> Complex:
    """F from 0 to v: half an endless line's less the rest beyond v, which fades as its way gets longer [m]."""
    sine, cosine = fresnel(np.abs(v))
    rest = 0.5 - (cosine + 1j * sine) / (1.0 + 1j)
    return np.sign(v) * (0.5 - rest * np.exp(-((np.maximum(longer_m, 0.0) / SPREAD_M) ** 2)))


@dataclass(frozen=True)
class _Order:
    """One order of the faces, for K cells: the wave comes by the first face and goes back from the second.

    :param angle: [K] phi from the first face; :param reach: [K, 2] of the first and the second face [m]
    :param beyond: [K] as in :class:`_Cells`
    """

    height: Real
    angle: Real
    opening: Real
    reach: Real
    beyond: Real

    @staticmethod
    def of(cells: _Cells, views: _Views, order: int) -> _Order:
        here = views.take(cells.corner)
        angle = here.angle if order == 0 else here.opening - here.angle
        reach = cells.reach if order == 0 else cells.reach[:, ::-1]
        return _Order(here.height, angle, here.opening, reach, cells.beyond)

    def end(self) -> Real:
        """[K] how far from the edge the second face is lit by the first [m]."""
        first, second = self.reach.T
        below = self.height * np.sin(self.angle)
        rest = self.height * np.sin(self.angle + self.opening) - first * np.sin(self.opening)
        ends = rest > first * below / np.maximum(second, 1e-12)
        lit = np.sin(self.angle + self.opening) > GRAZING  # else the image stands behind the second face
        end = np.where(lit, np.where(ends, first * below / np.where(ends, rest, 1.0), second), 0.0)
        # Beside the foot the wave meets the first face nearer to the foot, by h sin(phi) over h sin(phi) + b sin(psi).
        return np.minimum(end, below / np.sin(self.opening) * np.maximum(self.beyond, 0.0))

    def longer(self, b: Real) -> Real:
        """[...] L(b) - L* [m]; a trailing axis of b is one of points."""
        h, phi, psi = (_like(value, b) for value in (self.height, self.angle, self.opening))
        legs = [np.sqrt(h * h + b * b - 2.0 * h * b * np.cos(psi + turn * phi)) for turn in (1.0, -1.0)]
        return np.maximum(legs[0] + legs[1] - 2.0 * h * np.sin(psi), 0.0)

    def share_to(self, b: Real, wavelength_m: float) -> Complex:
        """F across from b* to b."""
        h, phi, psi = (_like(value, b) for value in (self.height, self.angle, self.opening))
        longer = self.longer(b)
        side = np.sign(b * np.cos(phi) - h * np.cos(psi))
        return _from_foot(side * np.sqrt(4.0 * longer / wavelength_m), longer)

    def beam(self, wavelength_m: float) -> Real:
        """[K, ACROSS] b at the middles of the pieces of the aperture in which sight is tested [m]."""
        zone = np.sqrt(0.5 * wavelength_m * self.height) / np.maximum(np.cos(self.angle), 0.01)
        return np.minimum(self.end(), BEAM_ZONES * zone)[:, None] * (np.arange(ACROSS) + 0.5) / ACROSS


def _like(value: Real, points: Real) -> Real:
    return value if points.ndim == 1 else value[:, None]


def _integrals(cells: _Cells, views: _Views, wavelength_m: float, seen: NDArray[np.bool_]) -> Complex:
    """[2, C] F of both orders.

    :param seen: [2, K, ACROSS] whether a piece of the aperture is in sight
    """
    total = np.zeros((2, len(views.height)), dtype=np.complex128)
    for order in (0, 1):
        one = _Order.of(cells, views, order)
        middle = one.beam(wavelength_m)
        ends = np.concatenate([np.zeros((len(middle), 1)), middle[:, :-1] + middle[:, :1], one.end()[:, None]], axis=1)
        across = (np.diff(one.share_to(ends, wavelength_m), axis=1) * seen[order]).sum(axis=1)
        np.add.at(total[order], cells.corner, cells.share * across)
    return total


def _in_sight(
    corners: CornerEdges, cells: _Cells, views: _Views, wavelength_m: float, sight: Sight
) -> NDArray[np.bool_]:
    """[2, K, ACROSS] whether both legs to the pieces of the aperture are free."""
    seen = np.ones((2, len(cells.corner), ACROSS), dtype=bool)
    foot, along = views.foot[cells.corner], corners.direction[cells.corner]
    for order in (0, 1):
        one, faces = _Order.of(cells, views, order), (order, 1 - order)
        b = one.beam(wavelength_m)
        below = (one.height * np.sin(one.angle))[:, None]
        share = below / (below + b * np.sin(one.opening)[:, None])  # of the way from the image to the second face
        a = (one.height * np.sin(one.angle + one.opening))[:, None] * b * share / below
        for face, away, z in zip(faces, (a, b), (cells.z[:, None] * share, np.tile(cells.z[:, None], ACROSS)),
                                 strict=True):  # fmt: skip
            into, normal = corners.into[cells.corner, face], corners.normal[cells.corner, face]
            point = foot[:, None] + z[..., None] * along[:, None] + away[..., None] * into[:, None]
            point = point + ray_margin_m(np.linalg.norm(point, axis=2))[..., None] * normal[:, None]
            flat = point.reshape(-1, 3)
            seen[order] &= sight(np.zeros_like(flat), flat).reshape(-1, ACROSS)
    return seen


def _without_hidden(cells: _Cells, seen: NDArray[np.bool_]) -> tuple[_Cells, NDArray[np.bool_]]:
    some = np.flatnonzero(seen.any(axis=(0, 2)))
    return cells.take(some), seen[:, some]


def _ends(cells: _Cells, count: int) -> tuple[Real, Real]:
    """v [C] at either end of what is in sight of the corners."""
    low, high = np.full(count, np.inf), np.full(count, -np.inf)
    np.minimum.at(low, cells.corner, cells.start)
    np.maximum.at(high, cells.corner, cells.stop)
    return low, high


def _widths(cells: _Cells, views: _Views, wavelength_m: float, count: int) -> Real:
    """v [C] from the edge to the aperture's narrower end, weighted with the cells' shares."""
    ends = [one.longer(one.end()) for one in (_Order.of(cells, views, order) for order in (0, 1))]
    v = np.sqrt(4.0 * np.minimum(*ends) / wavelength_m)
    weight = np.abs(cells.share)
    total = np.bincount(cells.corner, weight, count)
    return np.bincount(cells.corner, weight * v, count) / np.maximum(total, 1e-300)


def _paths(
    corners: CornerEdges,
    views: _Views,
    shares: Complex,
    ends: tuple[Real, Real],
    width: Real,
    slabs: Sequence[Material],
    frequency_hz: float,
    polarization: tuple[Polarization, Polarization],
) -> tuple[ScatteredPaths, SpecularPaths]:
    """The paths of both orders in the delay law that suits each corner."""
    wavelength = SPEED_OF_LIGHT / frequency_hz
    low, high = ends
    beside = (low >= 0.0) | (high <= 0.0)
    centre = np.where(beside | (high - low < 2.0 * WIDE), _phase_centre(low, high), 0.0)
    point = views.foot + _place(centre, views.height, wavelength)[:, None] * corners.direction
    level = along_array(corners.direction, unit(point))
    image = ~beside & np.where(level, high - low >= 2.0 * WIDE, width >= WIDE)
    # A corner that is short along its edge moves as a body; of a long one the edge slides through the point.
    body = np.minimum(centre - low, high - centre) < SHORT
    slides = np.einsum("ci,ci->c", corners.velocity, corners.direction)[:, None] * corners.direction
    velocity = corners.velocity - np.where(body[:, None], 0.0, slides)
    gamma = np.concatenate(
        [_reflection(corners, order, unit(point), slabs, frequency_hz, polarization) for order in (0, 1)]
    )
    turned = np.concatenate([_turn(corners, order) for order in (0, 1)])
    both = np.tile(np.arange(len(corners)), 2)
    amplitude = np.conj(gamma) * (wavelength / (4.0 * np.pi * views.shortest))[both] * shares.reshape(-1)
    wide, small = np.flatnonzero(image[both]), np.flatnonzero(~image[both])
    specular = SpecularPaths(
        image=_moved_by(turned[wide], views.foot[both[wide]]),
        image_velocity=_moved_by(turned[wide], corners.velocity[both[wide]]),
        axes=turned[wide],
        reference=np.zeros(3),
        amplitude=amplitude[wide],
        depth=np.full(len(wide), 2, dtype=np.int8),
        object_index=corners.object_index[both[wide]],
        kinds=np.full(len(wide), CORNER, dtype=np.uint8),
    )
    # The integral's phase counts from L*, the table's from the way to the point and back.
    rest = views.shortest - 2.0 * np.linalg.norm(point, axis=1)
    lag = np.exp(2j * np.pi * (rest / wavelength % 1.0))[both]
    owner = both[small]
    scattered = replace(
        ScatteredPaths.of_points(point[owner], velocity[owner], (amplitude * lag)[small], corners.object_index[owner]),
        depth=np.full(len(small), 2, dtype=np.int8),
        kinds=np.full(len(small), CORNER, dtype=np.uint8),
    )
    return scattered, specular


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


def _reflection(
    corners: CornerEdges,
    order: int,
    direction: Real,
    slabs: Sequence[Material],
    frequency_hz: float,
    polarization: tuple[Polarization, Polarization],
) -> Complex:
    """[C] what both faces leave of a field of the TX's polarisation, as the RX hears it."""
    sent, received = (polarization_axis(direction, which) for which in polarization)
    field = sent.astype(np.complex128)
    onward = direction
    for face in (order, 1 - order):
        onward, field = mirrored_by_slabs(
            slabs, corners.face_mesh[:, face], frequency_hz, onward, corners.normal[:, face], field
        )
    return np.einsum("ci,ci->c", field, received)
