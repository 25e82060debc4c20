"""Waves over one edge: the point of diffraction, the field, and the echoes of edges to the radar itself.

One way from a source to an observer the field relative to a source of 1 at 1 m is (:mod:`shared.physics.wedge`)

    G = D / sqrt(s s' (s + s')) * share,

with the distances s' before and s after the point of diffraction, where both legs make the same angle with the edge
(Keller): it divides the edge in the ratio of the perpendicular distances of source and observer. ``share`` is the field
of an edge of finite length over that of an endless one, by stationary phase, between the ends of the edge,

    share = 1 / (1 - j) int exp(-j pi v^2 / 2) dv,   v = x sin(beta) sqrt(2 (1/s + 1/s') / lambda):

1 far within, 1/2 at an end. Beyond the end the point of diffraction is the end itself.

Back to the radar, s = s' = h, the foot of the perpendicular: lambda / (4 pi) D / sqrt(2 h^3). The exact delay of an
endless edge with direction e, for a TX and an RX at distances rho_i, rho_j from it and at z_i, z_j along it, is

    c tau = sqrt((rho_i + rho_j)^2 + (z_i - z_j)^2).

The law of scattered paths with p = q = foot is exact for elements side by side across the edge (z_i = z_j), and off by
(z_i + z_j)^2 / (4 h) otherwise. That of specular paths with image 2 p and H = 2 e e^T - I is exact for elements along
the edge, and off by (w_i - w_j)^2 / (4 h) with w across edge and sight. For each edge the law with the smaller error
for an array along y is used: at most, at 45 deg, 0.1 wavelength at 20 m for elements 0.25 m from the centre. Beyond the
end of an edge the wave comes from a point: there it is the first.

The polarisation is split into the edge's own directions (soft: electric field along the edge). Faces reflect as slabs
of their materials; at a rim the sheet also transmits. Amplitudes are conjugates, as in the path table.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree
from scipy.special import fresnel

from datafactory.paths.candidates import EDGE, Candidates
from datafactory.paths.columns import Columns
from datafactory.paths.edges import WedgeEdges
from datafactory.paths.facets import COPLANAR_M, TAPER
from datafactory.paths.slabs import Slabs
from datafactory.paths.table import DIFFRACTED, ScatteredPaths, SpecularPaths
from datafactory.paths.view import View, polarization_axis
from shared.physics.compiled import compiled
from shared.physics.vectors import Complex, Index, Mask, Real, dots, lengths, unit
from shared.physics.wedge import WedgeGeometry, diffraction_coefficient

Heard = tuple[ScatteredPaths, SpecularPaths, dict[str, int]]
"""Echoes in sight, their candidates numbers in the list that they were found in, and counts."""

LEAST_SHARE = 0.05
"""Rays with a smaller share of the edge are dropped (-26 dB)."""
MISSED = 5.0
"""v beyond an edge's end from which no ray is looked at: its share is below ``LEAST_SHARE``."""
LOOSE = 1.0 + 1e-6
"""By how much a first look is more generous than the test, so that rounding never decides."""
NEAREST_M = 0.05
"""Nearer edges are left out: the theory holds from several wavelengths on [m]."""
BESIDE_M = 0.01
"""Distance from the edge at which the lines of sight to it pass [m]."""
TIED_M, TIED = 1e-6, 1e-9
"""A foot that lies nearer to a rim [m] is on the side on which the mirrors have it, by this angle [rad]. Mirrors reach
beyond their rims by rounding, :data:`.feet.INSIDE` of their size."""
GRAZING = 1e-6
"""Angles from a face [rad], and cosines of incidence, below which a ray counts as inside the face."""


@dataclass(frozen=True)
class EdgeRays(Columns):
    """K rays from a source over an edge to an observer, in the radar frame, by rising observer and edge.

    :param observer: [K] index into the observers given; :param edge: [K] index into the edges given
    :param point: [K, 3] on the edge [m]
    :param inward, outward: [K, 3] unit vectors along the ray before and after
    :param geometry: angles and distances in the wedges' own coordinates
    :param share: [K] of an endless edge, its phase relative to the path over ``point``
    :param at_end: [K] whether ``point`` is an end of the edge
    """

    observer: Index
    edge: Index
    point: Real
    inward: Real
    outward: Real
    geometry: WedgeGeometry
    share: Complex
    at_end: Mask


def rays_over_edges(edges: WedgeEdges, source: Real, observer: Real, wavelength_m: float) -> EdgeRays:
    """The rays over edges, before obstacles are tested.

    :param edges: E edges in the radar frame
    :param source: [3] [m]; :param observer: [3], or [N, 3] for the rays to each of them [m]
    """
    observers = np.ascontiguousarray(np.atleast_2d(observer))
    length = np.linalg.norm(edges.end - edges.start, axis=1)
    z_source, rho_source = _cylindrical(edges.start, edges.direction, source)
    # Most edges are dropped first, cheaply.
    to, kept = _worth_a_look(
        np.ascontiguousarray(edges.start), np.ascontiguousarray(edges.direction), length, z_source, rho_source,
        observers, wavelength_m,
    )  # fmt: skip
    z_observer, rho_observer = _cylindrical(edges.start[kept], edges.direction[kept], observers[to])
    z_source, rho_source, length = z_source[kept], rho_source[kept], length[kept]
    rho = rho_source + rho_observer
    stationary = (rho_observer * z_source + rho_source * z_observer) / rho
    missed = np.maximum(-stationary, stationary - length)
    straight = np.hypot(rho, z_observer - z_source)
    scale = rho / straight * np.sqrt(2.0 * (1.0 / rho_source + 1.0 / rho_observer) * rho / straight / wavelength_m)
    near = (rho_source > NEAREST_M) & (rho_observer > NEAREST_M) & (missed * scale < MISSED)
    to, kept, length, stationary, sine, scale = (
        values[near] for values in (to, kept, length, stationary, rho / straight, scale)
    )
    share = _edge_share(-stationary * scale, (length - stationary) * scale)

    direction, normal_0, exterior_n = edges.direction[kept], edges.normal_0[kept], edges.exterior_n[kept]
    point, there = edges.start[kept] + np.clip(stationary, 0.0, length)[:, None] * direction, observers[to]
    angles = [_angle(normal_0, direction, place - point) for place in (source, there)]
    limit = exterior_n * np.pi - GRAZING
    met = np.abs(share) > LEAST_SHARE
    for angle in angles:
        met &= (angle > GRAZING) & (angle < limit)
    return EdgeRays(
        observer=to[met],
        edge=kept[met],
        point=point[met],
        inward=unit(point - source)[met],
        outward=unit(there - point)[met],
        geometry=WedgeGeometry(
            exterior_n=exterior_n[met],
            source_angle_rad=angles[0][met],
            observer_angle_rad=angles[1][met],
            source_distance_m=np.linalg.norm(point - source, axis=1)[met],
            observer_distance_m=np.linalg.norm(there - point, axis=1)[met],
            sin_beta=sine[met],
        ),
        share=share[met],
        at_end=((stationary < 0.0) | (stationary > length))[met],
    )


@compiled()
def _worth_a_look(start, direction, length, z_source, rho_source, observers, wavelength_m):
    """Pairs of observer [P] and edge [P] that may have a ray: a little more than those that are not missed.

    :param start, direction: [E, 3]; :param length, z_source, rho_source: [E] as in :func:`rays_over_edges`
    :param observers: [N, 3]
    """
    found, count = np.empty((1024, 2), dtype=np.int64), 0
    for n in range(len(observers)):
        for e in range(len(start)):
            x, y, z = (observers[n, 0] - start[e, 0], observers[n, 1] - start[e, 1], observers[n, 2] - start[e, 2])
            along = x * direction[e, 0] + y * direction[e, 1] + z * direction[e, 2]
            x, y, z = x - along * direction[e, 0], y - along * direction[e, 1], z - along * direction[e, 2]
            beside, ahead = np.sqrt(x * x + y * y + z * z), rho_source[e]
            if beside < NEAREST_M / LOOSE or ahead < NEAREST_M / LOOSE:
                continue
            rho = ahead + beside
            stationary = (beside * z_source[e] + ahead * along) / rho
            missed = max(-stationary, stationary - length[e])
            if missed > 0.0:
                sine = rho / np.sqrt(rho * rho + (along - z_source[e]) ** 2)
                square = 2.0 * (1.0 / ahead + 1.0 / beside) * sine**3 / wavelength_m
                if missed * missed * square > (LOOSE * MISSED) ** 2:
                    continue
            if count == len(found):
                found = np.concatenate((found, np.empty_like(found)))
            found[count, 0], found[count, 1] = n, e
            count += 1
    return found[:count, 0].copy(), found[:count, 1].copy()


def field_over_edges(
    edges: WedgeEdges,
    rays: EdgeRays,
    slabs: Slabs,
    source_axis: Real,
    observer_axis: Real,
    reflects: Mask | None = None,
) -> Complex:
    """G [K] [1/m] of the rays, exp(+j omega t), without the phase of the path's length.

    :param source_axis, observer_axis: [K, 3] unit vectors of the polarisations sent and received
    :param reflects: [K, 2] over which faces there is a specular path that contains the mirror's finite size
        (:mod:`.facets`), and with it a part of a rim's wave; that part is then left out here
    """
    geometry, chosen = rays.geometry, edges.take(rays.edge)
    wavelength = slabs.wavelength_m
    # Luebbers' 0-face is the source's. Each face takes the end nearer to it, so that the field is the same both ways.
    phi = (
        np.minimum(geometry.source_angle_rad, geometry.observer_angle_rad),
        chosen.exterior_n * np.pi - np.maximum(geometry.source_angle_rad, geometry.observer_angle_rad),
    )
    reflection, passed = [], []
    for face, angle in enumerate(phi):
        cosine = np.clip(geometry.sin_beta * np.abs(np.sin(angle)), GRAZING, 1.0)
        mesh = chosen.face_mesh[:, face]
        mirror = np.array(slabs.reflection(mesh, cosine)) * slabs.unscattered(mesh)
        through = np.array(slabs.transmission(mesh, cosine))
        if reflects is not None:
            rest = _rim_share(angle, geometry.source_distance_m, wavelength)
            mirror = mirror * np.where(reflects[:, face], rest, 1.0)
        reflection.append(mirror)
        passed.append(np.where(chosen.exterior_n == 2.0, through, 0.0))
    soft, hard = (
        diffraction_coefficient(
            geometry, 2.0 * np.pi / wavelength, reflection[0][which], reflection[1][which], passed[0][which]
        )
        for which in (0, 1)
    )
    # Edge-fixed unit vectors of Kouyoumjian and Pathak; E_d = -(beta beta' D_s + phi phi' D_h) E_i.
    phi_in = -unit(np.cross(chosen.direction, rays.inward))
    phi_out = unit(np.cross(chosen.direction, rays.outward))
    beta_in, beta_out = np.cross(rays.inward, phi_in), np.cross(rays.outward, phi_out)
    along = dots(observer_axis, beta_out) * dots(source_axis, beta_in)
    across = dots(observer_axis, phi_out) * dots(source_axis, phi_in)
    return -(along * soft + across * hard) * geometry.spreading() * rays.share


class EdgeEchoes:
    """Echoes of edges to the radar, at the origin."""

    def __init__(self, view: View) -> None:
        self._view, settings, wavelength = view, view.settings, view.wavelength_m
        rays = rays_over_edges(view.edges, np.zeros(3), np.zeros(3), wavelength)
        self.rays, reflects = _as_mirrors_have_it(view.edges, rays, view.feet[1])
        axes = [polarization_axis(self.rays.inward, which) for which in settings.polarization]
        mirrors_end = settings.finite_mirrors and settings.specular
        field = field_over_edges(view.edges, self.rays, view.slabs, axes[0], axes[1], reflects if mirrors_end else None)
        self.amplitude = np.conj(wavelength / (4.0 * np.pi) * field)

    @property
    def candidates(self) -> Candidates:
        """Of every ray over an edge: what it sends back where it is in sight."""
        return Candidates.of(EDGE, self.rays.point, np.abs(self.amplitude) ** 2)

    def seen(self, worth: Mask) -> Heard:
        """Edges across the array axis and edges along it, with the delay law that suits either, and counts."""
        edges, chosen = self._view.edges, np.flatnonzero(worth).astype(np.int32)
        tried = self.rays.take(chosen)
        clear = self._view.sight(np.zeros((len(tried), 3)), _sight_points(edges, tried))
        rays, candidate = tried.take(clear), chosen[clear]
        amplitude = self.amplitude[candidate]
        velocity = diffracting_velocity(
            edges.velocity_at(rays.edge, rays.point), edges.direction[rays.edge], rays.at_end
        )
        e, owner = edges.direction[rays.edge], edges.object_index[rays.edge]
        points = ScatteredPaths.of_points(rays.point, velocity, amplitude, owner, DIFFRACTED, candidate=candidate)
        axes = 2.0 * e[:, :, None] * e[:, None, :] - np.eye(3)
        images = SpecularPaths.of(
            2.0 * rays.point, 2.0 * velocity, axes, amplitude, owner, DIFFRACTED, candidate=candidate
        )
        level = along_array(e, rays.inward) & ~rays.at_end
        counts = {"edge_rays": len(tried), "edge_rays_hidden": len(tried) - len(rays)}
        return points.take(~level), images.take(level), counts


def along_array(direction: Real, sight: Real) -> Mask:
    """[K] whether an edge [K, 3] lies rather along the array axis y than across it, as seen along ``sight`` [K, 3]."""
    return direction[:, 1] ** 2 > np.cross(direction, sight)[:, 1] ** 2


def _cylindrical(start: Real, direction: Real, place: Real) -> tuple[Real, Real]:
    """Coordinate along each edge, from its start, and distance from its line [E]."""
    z = dots(place - start, direction)
    return z, np.linalg.norm(place - start - z[:, None] * direction, axis=1)


def _angle(normal_0: Real, direction: Real, towards: Real) -> Real:
    """[K] angle of a direction [K, 3] from the 0-face of an edge, 0 to 2 pi."""
    into_0 = np.cross(normal_0, direction)
    return np.arctan2(dots(towards, normal_0), dots(towards, into_0)) % (2.0 * np.pi)


def _edge_share(low: Real, high: Real) -> Complex:
    """The module's ``share`` of an edge between v = ``low`` and ``high``; beyond an end, with the phase of that end."""
    sine_low, cosine_low = fresnel(low)
    sine_high, cosine_high = fresnel(high)
    share = ((cosine_high - cosine_low) - 1j * (sine_high - sine_low)) / (1.0 - 1j)
    missed = np.where(low > 0.0, low, np.where(high < 0.0, high, 0.0))
    return share * np.exp(0.5j * np.pi * missed**2)


def _as_mirrors_have_it(edges: WedgeEdges, rays: EdgeRays, feet: Real) -> tuple[EdgeRays, Mask]:
    """Rays back to the radar, and over which of their two faces [K, 2] there is a specular path.

    A flat face has one where the mirrors have the foot of the perpendicular on its plane: beyond the rim and on another
    piece of the plane too, and beyond the opposite rim of a narrow face not. Beyond the end of an edge, and of a curved
    surface, the angle decides, as if the face went on.

    Straight before a rim rounding decides on which side of it the foot is, and with it the sign of the wedge's
    reflected wave, which has to close the gap that the mirror leaves: the ray is put on the mirrors' side.

    :param feet: [n, 3] of the perpendiculars from the radar, on the mirrors [m]
    """
    chosen, mirrors = edges.take(rays.edge), cKDTree(feet)
    angle, whole = rays.geometry.source_angle_rad, chosen.exterior_n * np.pi
    reflects = np.zeros((len(rays), 2), dtype=bool)
    for face, normal in enumerate((chosen.normal_0, chosen.normal_n)):
        foot = dots(rays.point, normal)[:, None] * normal
        there = np.isfinite(mirrors.query(foot, distance_upper_bound=COPLANAR_M)[0])
        before = (whole - angle if face else angle) < 0.5 * np.pi
        flat, beyond_end = chosen.flat[:, face], rays.at_end
        reflects[:, face] = (flat & there) | (before & (beyond_end | ~flat))
        tied = flat & (before != there) & (lengths(foot - rays.point) < TIED_M)
        side = 0.5 * np.pi + np.where(there, -TIED, TIED)
        angle = np.where(tied, whole - side if face else side, angle)
    geometry = replace(rays.geometry, source_angle_rad=angle, observer_angle_rad=angle)
    return replace(rays, geometry=geometry), reflects


def _rim_share(angle: Real, distance_m: Real, wavelength_m: float) -> Real:
    """[K] share of a rim's wave that the specular path over its face, seen at ``angle``, does not contain.

    The specular point lies h |cos| from the rim, h sin before the face: rho^2 = 2 h cos^2 / (lambda sin) Fresnel zones.
    The specular path contains the rim with the weight exp(-rho^2 / TAPER).
    """
    zones = 2.0 * distance_m * np.cos(angle) ** 2 / (wavelength_m * np.maximum(np.sin(angle), GRAZING))
    return 1.0 - np.exp(-zones / TAPER)


def _sight_points(edges: WedgeEdges, rays: EdgeRays) -> Real:
    """[K, 3] points that are in sight of the source where the edge is, unless another mesh continues its face.

    Where one face is lit, the line of sight passes the edge and ends behind it: a wall that continues the face in
    another mesh blocks it. Where both faces are lit, it ends in front of the edge, midway between the faces.
    """
    angle, n = rays.geometry.source_angle_rad, rays.geometry.exterior_n
    both = (angle < np.pi) & (angle > (n - 1.0) * np.pi)
    turn = np.where(
        both, 0.5 * n * np.pi, np.where(angle <= (n - 1.0) * np.pi, angle + 0.5 * np.pi, angle - 0.5 * np.pi)
    )
    chosen = edges.take(rays.edge)
    into_0 = np.cross(chosen.normal_0, chosen.direction)
    aside = np.cos(turn)[:, None] * into_0 + np.sin(turn)[:, None] * chosen.normal_0
    return rays.point + BESIDE_M * (aside + np.where(both, 0.0, 2.0)[:, None] * rays.inward)


def diffracting_velocity(velocity: Real, direction: Real, at_end: Mask) -> Real:
    """[K, 3] velocity of the point of diffraction: without the component along the edge, except at an end."""
    return velocity - np.where(at_end, 0.0, dots(velocity, direction))[:, None] * direction
