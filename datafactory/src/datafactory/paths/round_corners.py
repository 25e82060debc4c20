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

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from datafactory.paths.diffraction import (
    BESIDE_M,
    EdgeRays,
    Sight,
    along_array,
    field_over_edges,
    rays_over_edges,
)
from datafactory.paths.edges import WedgeEdges
from datafactory.paths.panes import Polarization, polarization_axis
from datafactory.paths.table import DIFFRACTED, TARGET, ScatteredPaths
from datafactory.scenes.materials.table import Material
from shared.physics.units import SPEED_OF_LIGHT

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

EDGES_PER_TARGET = 4
ORIGIN = np.zeros(3)


@dataclass(frozen=True)
class _Legs:
    """The ways from the radar to a target over K edges.

    :param point: [K, 3] the wavefront's centre as the array sees it [m]; ``velocity`` [K, 3] [m/s]
    :param rest_m: [K] length of the way beyond that point [m]; ``rest_rate`` [K] its rate [m/s]
    :param sent, received: [K] the fields G for the polarisations of TX and RX
    """

    point: Real
    velocity: Real
    rest_m: Real
    rest_rate: Real
    sent: Complex
    received: Complex


def echoes_round_corners(
    edges: WedgeEdges,
    slabs: Sequence[Material],
    frequency_hz: float,
    sight: Sight,
    position: Real,
    velocity: Real,
    rcs_m2: Real,
    object_index: NDArray[np.int32],
    polarization: tuple[Polarization, Polarization] = ("V", "V"),
    edges_per_target: int = EDGES_PER_TARGET,
) -> tuple[ScatteredPaths, dict[str, int]]:
    """Echoes of T point targets that the radar, at the origin, does not see directly.

    :param edges: in the radar frame, ``edges_of(merged_scene).seen_from(pose)``
    :param slabs: material of each merged mesh; :param frequency_hz: mid-sweep
    :param position: [T, 3] [m]; :param velocity: [T, 3] relative to the radar [m/s]
    :param rcs_m2: [T] radar cross sections for the polarisation received; :param object_index: [T]
    :param polarization: of TX and RX; cross-polar, the target is reached by the one and heard by the other
    :param edges_per_target: number of edges used for each target, the strongest ones, out and back in every combination
    :return: the paths, and the numbers of targets reached, of targets not reached, and of weaker edges left out
    """
    parts = [ScatteredPaths.of_points(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))]
    reached = weaker = 0
    scale = SPEED_OF_LIGHT / frequency_hz * np.sqrt(rcs_m2) / (4.0 * np.pi) ** 1.5
    for index in range(len(position)):
        legs, left = _legs_to_target(
            edges, slabs, frequency_hz, sight, position[index], velocity[index], polarization, edges_per_target
        )
        reached += int(len(legs.rest_m) > 0)
        weaker += left
        parts.append(_round_trips(legs, scale[index], int(object_index[index])))
    counts = {
        "targets_round_corners": reached,
        "targets_unreached": len(position) - reached,
        "edges_round_corners_left_out": weaker,
    }
    return ScatteredPaths.concatenate(parts), counts


def _legs_to_target(
    edges: WedgeEdges,
    slabs: Sequence[Material],
    frequency_hz: float,
    sight: Sight,
    target: Real,
    target_velocity: Real,
    polarization: tuple[Polarization, Polarization],
    limit: int,
) -> tuple[_Legs, int]:
    """The strongest clear ways to one target, and the number of weaker ones."""
    rays = rays_over_edges(edges, ORIGIN, target, SPEED_OF_LIGHT / frequency_hz)
    rays = rays.take(_both_legs_clear(edges, rays, target, sight))
    sent, received = (
        field_over_edges(
            edges,
            rays,
            slabs,
            frequency_hz,
            polarization_axis(rays.inward, which),
            polarization_axis(rays.outward, which),
        )
        for which in polarization
    )
    best = np.argsort(-np.abs(sent * received), kind="stable")[:limit]
    chosen, inward, outward = rays.edge[best], rays.inward[best], rays.outward[best]
    out_m, on_m = rays.geometry.source_distance_m[best], rays.geometry.observer_distance_m[best]
    level = along_array(edges.direction[chosen], inward)
    # The length's rate is u' . v_edge + u . (v_target - v_edge): the sliding of the point adds nothing (Fermat).
    at_edge = edges.velocity_at(chosen, rays.point[best])
    rate = np.einsum("ki,ki->k", outward, target_velocity - at_edge)
    legs = _Legs(
        point=np.where(level[:, None], inward * (out_m + on_m)[:, None], rays.point[best]),
        velocity=at_edge + np.where(level, rate, 0.0)[:, None] * inward,
        rest_m=np.where(level, 0.0, on_m),
        rest_rate=np.where(level, 0.0, rate),
        sent=sent[best],
        received=received[best],
    )
    return legs, len(rays) - len(best)


def _both_legs_clear(edges: WedgeEdges, rays: EdgeRays, target: Real, sight: Sight) -> NDArray[np.bool_]:
    """[K] whether both legs are free, up to a point beside the edge, between the legs and in the wedge's exterior.

    Each leg ends a little beyond the plane of the other. A wall in another mesh that continues the face, so that there
    is no edge, blocks one of them.
    """
    middle = 0.5 * (rays.geometry.source_angle_rad + rays.geometry.observer_angle_rad)
    chosen = edges.take(rays.edge)
    into_0 = np.cross(chosen.normal_0, chosen.direction)
    aside = rays.point + BESIDE_M * (np.cos(middle)[:, None] * into_0 + np.sin(middle)[:, None] * chosen.normal_0)
    clear = sight(np.zeros_like(aside), aside + 0.5 * BESIDE_M * rays.outward)
    towards = (aside - 0.5 * BESIDE_M * rays.inward)[clear]
    clear[clear] = sight(np.broadcast_to(target, towards.shape), towards)
    return clear


def _round_trips(legs: _Legs, scale: float, owner: int) -> ScatteredPaths:
    """Every way out with every way back."""
    count = len(legs.rest_m)
    out, back = (index.reshape(-1) for index in np.meshgrid(np.arange(count), np.arange(count), indexing="ij"))
    return ScatteredPaths(
        tx_point=legs.point[out],
        rx_point=legs.point[back],
        tx_velocity=legs.velocity[out],
        rx_velocity=legs.velocity[back],
        between_m=legs.rest_m[out] + legs.rest_m[back],
        between_rate_mps=legs.rest_rate[out] + legs.rest_rate[back],
        amplitude=np.conj(scale * legs.sent[out] * legs.received[back]),
        depth=np.full(count**2, 3, dtype=np.int8),
        object_index=np.full(count**2, owner, dtype=np.int32),
        kinds=np.full(count**2, DIFFRACTED | TARGET, dtype=np.uint8),
    )
