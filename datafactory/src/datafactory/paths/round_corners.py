"""Targets round a corner: echoes of hidden point targets by diffraction at edges, on the way out and on the way back.

Out over edge i and back over edge j, with G the one-way field of :mod:`datafactory.paths.diffraction`, the radar
equation (direct: G = 1 / R) becomes

    A = lambda sqrt(sigma) / (4 pi)^(3/2) G_i G_j,

and the path's length is the sum of both ways. For an edge across the array the wavefront's centre is the point on the
edge: the table holds that point, and the rest of the way as length between. For an edge along the array the centre is
the target, rotated about the edge into the line of sight: the table holds that point. For an array along y the latter
is exact. The former is exact where the ray meets the edge at a right angle; else the wavefront's error is up to

    y^2 cos^2(beta) / 2 (1/s' - 1/(s' + s)),

and an edge between the two cases by the same with the share of y^2 that belongs to the other case instead of
cos^2(beta); s' is the length to the edge and s the length beyond.

The point on the edge is that of the origin at t = 0. It slides as the target moves. That changes lengths in second
order only, because the path is the shortest one. Left out are a wave over two edges in succession, as around a thick
pillar; the field that edges add at a target in sight, up to 6 dB one way at the shadow boundary; a target's
depolarisation.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from datafactory.paths.columns import pairs_in_runs, place_in_run
from datafactory.paths.diffraction import (
    BESIDE_M,
    EdgeRays,
    along_array,
    field_over_edges,
    rays_over_edges,
)
from datafactory.paths.echo_points import EchoPoints
from datafactory.paths.panes import polarization_axis
from datafactory.paths.table import DIFFRACTED, TARGET, ScatteredPaths
from datafactory.paths.view import View
from shared.physics.vectors import Complex, Index, Mask, Real

EDGES_PER_TARGET = 4
TARGETS_AT_ONCE = 64
"""Targets whose edges are looked at together: two thousand edges each in a city, some ten megabytes."""
ORIGIN = np.zeros(3)


@dataclass(frozen=True)
class _Legs:
    """L ways from the radar to targets, each over one edge, target by target.

    :param target: [L] rising
    :param point: [L, 3] the wavefront's centre as the array sees it [m]; ``velocity`` [L, 3] [m/s]
    :param rest_m: [L] length of the way beyond that point [m]; ``rest_rate`` [L] its rate [m/s]
    :param sent, received: [L] the fields G for the polarisations of TX and RX
    """

    target: Index
    point: Real
    velocity: Real
    rest_m: Real
    rest_rate: Real
    sent: Complex
    received: Complex


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
        legs, left = _legs_over(view, rays, here.velocity, edges_per_target)
        reached += len(np.unique(legs.target))
        weaker += left
        paths = _round_trips(legs, here.amplitudes(view.wavelength_m), view.merged.object_of_target(here.target))
        parts.append(replace(paths, candidate=paths.candidate + first))
    counts = {
        "targets_round_corners": reached,
        "targets_unreached": count - reached,
        "edges_round_corners_left_out": weaker,
    }
    return ScatteredPaths.joined(parts), counts


def _legs_over(view: View, rays: EdgeRays, target_velocity: Real, limit: int) -> tuple[_Legs, int]:
    """The strongest of the clear ways to each target, the strongest first, and the number of weaker ones."""
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
    level = along_array(edges.direction[chosen], inward)
    # The length's rate is u' . v_edge + u . (v_target - v_edge): the sliding of the point adds nothing (Fermat).
    at_edge = edges.velocity_at(chosen, rays.point[best])
    rate = np.einsum("ki,ki->k", outward, target_velocity[to] - at_edge)
    legs = _Legs(
        target=to,
        point=np.where(level[:, None], inward * (out_m + on_m)[:, None], rays.point[best]),
        velocity=at_edge + np.where(level, rate, 0.0)[:, None] * inward,
        rest_m=np.where(level, 0.0, on_m),
        rest_rate=np.where(level, 0.0, rate),
        sent=sent[best],
        received=received[best],
    )
    return legs, len(rays) - len(best)


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


def _round_trips(legs: _Legs, scale: Real, owner: NDArray[np.int32]) -> ScatteredPaths:
    """Every way out with every way back of each target.

    :param scale: [T] of the amplitude; :param owner: [T] the targets' object indices
    """
    out, back = pairs_in_runs(legs.target)
    count, target = len(out), legs.target[out]
    return ScatteredPaths(
        tx_point=legs.point[out],
        rx_point=legs.point[back],
        tx_velocity=legs.velocity[out],
        rx_velocity=legs.velocity[back],
        between_m=legs.rest_m[out] + legs.rest_m[back],
        between_rate_mps=legs.rest_rate[out] + legs.rest_rate[back],
        amplitude=np.conj(scale[target] * legs.sent[out] * legs.received[back]),
        depth=np.full(count, 3, dtype=np.int8),
        object_index=owner[target],
        kinds=np.full(count, DIFFRACTED | TARGET, dtype=np.uint8),
        candidate=target.astype(np.int32),
    )
