"""Echoes of targets with a radar cross section: in sight, behind panes, over mirrors, round corners.

**Round a corner** a hidden target is reached by diffraction at edges. Out over edge i and back over edge j, with G the
one-way field of :mod:`datafactory.paths.diffraction` (direct: G = 1 / R), the radar equation becomes

    A = lambda sqrt(sigma) / (4 pi)^(3/2) G_i G_j,

and the path's length is the sum of both ways. For an edge across the array the wavefront's centre is the point on the
edge: the table holds that point, and the rest of the way as length between. For an edge along the array the centre is
the target, rotated about the edge into the line of sight: the table holds that point, which is exact for an array along
y. The former is exact where the ray meets the edge at a right angle; else the wavefront's error is up to

    y^2 cos^2(beta) / 2 (1/s' - 1/(s' + s)),

s' the length to the edge and s the length beyond, and for an edge between the two cases the same with the share of y^2
that belongs to the other case instead of cos^2(beta). The point on the edge is that of the origin at t = 0; that it
slides as the target moves changes lengths in second order only. Left out are a wave over two edges in succession; the
field that edges add at a target in sight, up to 6 dB one way at the shadow boundary; a target's depolarisation.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from datafactory.paths.candidates import TARGET_MIRRORED, TARGET_SEEN, Candidates
from datafactory.paths.columns import pairs_in_runs, place_in_run
from datafactory.paths.diffraction import BESIDE_M, EdgeRays, Heard, along_array, field_over_edges, rays_over_edges
from datafactory.paths.echo_points import EchoPoints, Seen, all_echo_points
from datafactory.paths.feet import NEAREST_M
from datafactory.paths.mirrored_targets import DirectWays, echoes_over_mirrors
from datafactory.paths.table import DIFFRACTED, REFRACTED, TARGET, ScatteredPaths, SpecularPaths
from datafactory.paths.view import EDGES_WITHIN_M, FAINTEST, View, panes_between, polarization_axis
from shared.physics.units import db_to_power
from shared.physics.vectors import Mask, Real, dots, lengths

EDGES_PER_TARGET = 4
"""Ways to a hidden target that are used, the strongest, each out with each back; weaker ones are counted."""
TARGETS_AT_ONCE = 64
"""Targets whose edges are looked at together: two thousand edges each in a city, some ten megabytes."""
ORIGIN = np.zeros(3)
FAINTEST_ECHO = 1e-2 / EDGES_WITHIN_M**4
"""Cross section over the fourth power of the distance [1/m^2] below which a target in plain sight is left out: as faint
as such an edge. A pedestrian is so faint from 585 m on."""
ROUND_CORNERS_DB = 12.0
"""What a way round an edge loses at least, out and back: half of the field is there at the shadow's boundary."""
MIRRORED_MORE = 24.0 * 4.0
"""What all echoes of a target over mirrors have at most, over its own in plain sight: 24 paths
(:data:`.mirrored_targets.MIRRORS_PER_POINT`), none nearer and no mirror amplifying, of a cross section that is at most
four times as large from where the mirrors stand."""


def echoes_round_corners(
    view: View, hidden: EchoPoints, edges_per_target: int = EDGES_PER_TARGET
) -> tuple[ScatteredPaths, dict[str, int]]:
    """Echoes of hidden targets. Cross-polar, the target is reached by the one polarisation and heard by the other.

    :param hidden: from the radar, in its frame; their cross sections are for the polarisation received
    :param edges_per_target: number of edges used for each target, the strongest ones, out and back in every combination
    :return: the paths, their candidates numbers of the targets, and the numbers of targets reached, of targets not
        reached, and of weaker edges left out
    """
    parts = [ScatteredPaths.none()]
    reached = weaker = 0
    count = len(hidden)
    for first in range(0, count, TARGETS_AT_ONCE):
        here = hidden.take(np.arange(first, min(first + TARGETS_AT_ONCE, count)))
        rays = rays_over_edges(view.edges, ORIGIN, here.position, view.wavelength_m)
        rays = rays.take(_both_legs_clear(view, rays, here.position))
        paths, left = _round_trips(view, rays, here, edges_per_target)
        reached += len(np.unique(paths.candidate))
        weaker += left
        parts.append(replace(paths, candidate=paths.candidate + first))
    counts = {
        "targets_round_corners": reached,
        "targets_unreached": count - reached,
        "edges_round_corners_left_out": weaker,
    }
    return ScatteredPaths.joined(parts), counts


def _both_legs_clear(view: View, rays: EdgeRays, targets: Real) -> Mask:
    """[K] whether both legs are free, up to a point beside the edge, between the legs and in the wedge's exterior.

    Each leg ends a little beyond the plane of the other. A wall in another mesh that continues the face, so that there
    is no edge, blocks one of them.
    """
    edges = view.edges
    middle = 0.5 * (rays.geometry.source_angle_rad + rays.geometry.observer_angle_rad)
    normal_0 = edges.normal_0[rays.edge]
    into_0 = np.cross(normal_0, edges.direction[rays.edge])
    aside = rays.point + BESIDE_M * (np.cos(middle)[:, None] * into_0 + np.sin(middle)[:, None] * normal_0)
    clear = view.sight(np.zeros_like(aside), aside + 0.5 * BESIDE_M * rays.outward)
    towards = (aside - 0.5 * BESIDE_M * rays.inward)[clear]
    clear[clear] = view.sight(targets[rays.observer[clear]], towards)
    return clear


def _round_trips(view: View, rays: EdgeRays, targets: EchoPoints, limit: int) -> tuple[ScatteredPaths, int]:
    """Every way out with every way back of each target, over its strongest edges, and the number of weaker ones.

    A way is that to the wavefront's centre as the array sees it, and the rest beyond.

    :param rays: clear ones, target by target
    :param targets: [T] echo points, which the rays number
    :param limit: edges of a target
    """
    edges, polarization = view.edges, view.settings.polarization
    fields = {
        which: field_over_edges(
            edges, rays, view.slabs, polarization_axis(rays.inward, which), polarization_axis(rays.outward, which)
        )
        for which in dict.fromkeys(polarization)
    }
    sent, received = (fields[which] for which in polarization)
    by_strength = np.lexsort((-np.abs(sent * received), rays.observer))
    best = by_strength[place_in_run(rays.observer) < limit]
    to, chosen, inward, outward = rays.observer[best], rays.edge[best], rays.inward[best], rays.outward[best]
    out_m, on_m = rays.geometry.source_distance_m[best], rays.geometry.observer_distance_m[best]
    level = along_array(edges.direction[chosen], inward) & ~rays.at_end[best]
    # The length's rate is u' . v_edge + u . (v_target - v_edge): the sliding of the point adds nothing (Fermat).
    at_edge = edges.velocity_at(chosen, rays.point[best])
    rate = dots(outward, targets.velocity[to] - at_edge)
    point = np.where(level[:, None], inward * (out_m + on_m)[:, None], rays.point[best])
    velocity = at_edge + np.where(level, rate, 0.0)[:, None] * inward
    rest_m, rest_rate = np.where(level, 0.0, on_m), np.where(level, 0.0, rate)
    out, back = pairs_in_runs(to)
    count, target = len(out), to[out]
    scale, owner = targets.amplitudes(view.wavelength_m), view.merged.object_of_target(targets.target)
    paths = ScatteredPaths(
        tx_point=point[out],
        rx_point=point[back],
        tx_velocity=velocity[out],
        rx_velocity=velocity[back],
        between_m=rest_m[out] + rest_m[back],
        between_rate_mps=rest_rate[out] + rest_rate[back],
        amplitude=np.conj(scale[target] * sent[best][out] * received[best][back]),
        depth=np.full(count, 3, dtype=np.int8),
        object_index=owner[target],
        kinds=np.full(count, DIFFRACTED | TARGET, dtype=np.uint8),
        candidate=target.astype(np.int32),
    )
    return paths, len(rays) - len(best)


class TargetEchoes:
    """Echoes of the point targets.

    Radar equation for isotropic antennas of unit power: lambda sqrt(sigma) / ((4 pi)^(3/2) R^2), times the panes'
    transmission both ways. With second bounces and mirrors, those over mirrors too
    (:mod:`datafactory.paths.mirrored_targets`). What stands within :data:`.feet.NEAREST_M` of the sensor is left out
    and counted: there the antennas' own size matters, and the power of the equation has no bound.

    :param seed: of where in their cycle moving parts are at time 0
    """

    def __init__(self, view: View, seed: int = 0) -> None:
        self._view, settings, pose = view, view.settings, view.pose
        crossed = settings.polarization[0] != settings.polarization[1]
        self._circumstances = Seen(view.wavelength_m, pose.time_s, crossed, seed)
        targets = view.merged.targets
        self._away = pose.seen(np.array([target.position for target in targets]).reshape(-1, 3))
        self._nominal = np.array([float(db_to_power(target.rcs_dbsm)) for target in targets])
        away_m = lengths(self._away)
        self._loudness = self._nominal / np.maximum(away_m, NEAREST_M) ** 4
        self._heard = (self._loudness >= FAINTEST_ECHO) & (away_m >= NEAREST_M)
        points = all_echo_points(view.merged.targets, pose.position, self._circumstances).seen_by(pose)
        at_sensor = (lengths(points.position) < NEAREST_M) | (away_m < NEAREST_M)[points.target]
        self._at_sensor = int(at_sensor.sum())
        self._points = points.take(self._heard[points.target] & ~at_sensor)
        self._range_m = lengths(self._points.position)
        self._over_mirrors = bool(settings.specular and settings.depth > 1 and view.merged.meshes and len(self._points))

    @property
    def _amplitude(self) -> Real:
        """[K] of the echo points in plain sight."""
        return self._points.amplitudes(self._view.wavelength_m) / self._range_m**2

    @property
    def candidates(self) -> Candidates:
        """Of every echo point: itself, in plain sight or round an edge; of every target: all that mirrors add to it."""
        itself = Candidates.of(TARGET_SEEN, self._points.position, self._amplitude**2)
        if not self._over_mirrors:
            return itself
        whole = np.bincount(self._points.target, self._points.rcs_m2, len(self._nominal))
        of_sight = self._view.wavelength_m**2 * np.maximum(whole, self._nominal) / (4.0 * np.pi) ** 3
        power = MIRRORED_MORE * of_sight / np.maximum(lengths(self._away), NEAREST_M) ** 4
        followed = np.where(self._heard, power, 0.0)
        # A way over mirrors may arrive where the gain is largest, wherever the target stands: a bound is of boresight.
        ahead = np.outer(lengths(self._away), (1.0, 0.0, 0.0))
        return Candidates.joined([itself, Candidates.of(TARGET_MIRRORED, ahead, followed)])

    def seen(self, worth: Mask) -> Heard:
        """The echoes, no paths without a scattering point, and the numbers of those left out.

        What is in plain sight is listed as a target, and simulated whether it is worth it or not.
        """
        view, points, settings = self._view, self._points, self._view.settings
        position, count = points.position, len(points)
        over_mirrors = worth[count:][points.target] if self._over_mirrors else np.zeros(count, dtype=bool)
        heard = points.rcs_m2 > 0.0
        tried = np.flatnonzero(heard | over_mirrors)
        clear = np.zeros(count, dtype=bool)
        clear[tried] = view.sight(np.zeros((len(tried), 3)), position[tried])
        out, back = clear.astype(np.complex128), clear.astype(np.complex128)
        kinds = np.full(count, TARGET, dtype=np.uint8)
        behind = tried[~clear[tried]]
        if settings.refraction and len(behind):
            ways = {which: panes_between(view, position[behind], which) for which in set(settings.polarization)}
            out[behind], back[behind] = (ways[which] for which in settings.polarization)
            kinds[behind] |= REFRACTED
        in_sight = np.abs(out * back) > FAINTEST**2
        hidden = worth[:count] & heard & ~in_sight
        counts = {
            "targets_faint": int((self._loudness < FAINTEST_ECHO).sum()),
            "point_targets_hidden": int(hidden.sum()),
            "target_echoes_silent": points.silent,
            "targets_in_near_field": points.near,
            "target_echoes_at_sensor": self._at_sensor,
        }
        number = np.arange(count, dtype=np.int32)
        amplitude, index = self._amplitude * out * back, view.merged.object_of_target(points.target)
        direct = ScatteredPaths.of_points(position, points.velocity, amplitude, index, kinds, candidate=number)
        parts = [direct.take(heard & in_sight)]
        loud = self._loudness[points.target] * float(db_to_power(-ROUND_CORNERS_DB)) >= FAINTEST_ECHO
        hidden &= loud
        if settings.diffraction and hidden.any():
            round_corners, more = echoes_round_corners(view, points.take(hidden))
            parts.append(replace(round_corners, candidate=number[hidden][round_corners.candidate]))
            counts |= more
        if over_mirrors.any():
            straight = DirectWays(points, self._circumstances, out * in_sight, back * in_sight, kinds)
            echoes, more = echoes_over_mirrors(view, straight, over_mirrors)
            of_target = (count + points.target[echoes.candidate]).astype(np.int32)
            parts.append(replace(echoes, candidate=of_target))
            counts |= more
        return ScatteredPaths.joined(parts), SpecularPaths.none(), counts
