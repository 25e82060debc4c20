"""Targets round a corner: point targets that the radar sees only over edges, there and back.

Out over edge i and back over edge j, with G the one-way field of :mod:`datafactory.paths.diffraction`, the radar
equation (direct: G = 1 / R) becomes

    A = lambda sqrt(sigma) / (4 pi)^(3/2) G_i G_j,

and the path is as long as out plus back. For an edge across the array the wave curves around the edge itself: the table
gets the point on the edge, and the rest of the way as length between. For an edge along the array it curves around
the target, unrolled about the edge into the line of sight: the table gets that point. For an array along y the latter
is exact; the former is where the ray meets the edge at a right angle, else the wavefront is out by up to

    y^2 cos^2(beta) / 2 (1/s' - 1/(s' + s)),

and an edge between the two cases by the same with the share of y^2 that belongs to the other case instead of
cos^2(beta); s' is the way to the edge and s the way beyond.

The point on the edge is that of the origin at t = 0. It slides as the target moves, which changes lengths in second
order only, as the path is the shortest. Left out: a wave over two edges one after the other, as around a thick pillar;
what edges add to a target in plain sight, up to 6 dB one way at the very shadow boundary; a target's depolarisation.
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
class _Leg:
    """One way from the radar to a target over each of K edges.

    ``point`` [K, 3] and ``velocity`` [K, 3] as the array sees them, ``rest_m`` [K] and ``rest_rate`` [K] of the way
    that they leave out, ``sent`` and ``received`` [K] the fields G for the polarisations of TX and RX.
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

    :param edges: in the radar frame, ``edges_of(stage).seen_from(pose)``
    :param slabs: material of each of the stage's meshes; :param frequency_hz: mid-sweep
    :param position: [T, 3] [m]; :param velocity: [T, 3] relative to the radar [m/s]
    :param rcs_m2: [T] radar cross sections for the polarisation received; :param object_index: [T]
    :param polarization: of TX and RX; cross-polar, the target is reached by the one and heard by the other
    :param edges_per_target: the strongest so many are used, out and back in every combination
    :return: the paths, and how many targets were reached or not, and how many edges left out for being weaker
    """
    parts = [ScatteredPaths.of_points(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))]
    reached = weaker = 0
    scale = SPEED_OF_LIGHT / frequency_hz * np.sqrt(rcs_m2) / (4.0 * np.pi) ** 1.5
    for index in range(len(position)):
        leg, left = _leg(
            edges, slabs, frequency_hz, sight, position[index], velocity[index], polarization, edges_per_target
        )
        reached += int(len(leg.rest_m) > 0)
        weaker += left
        parts.append(_there_and_back(leg, scale[index], int(object_index[index])))
    counts = {
        "targets_round_corners": reached,
        "targets_unreached": len(position) - reached,
        "edges_round_corners_left_out": weaker,
    }
    return ScatteredPaths.concatenate(parts), counts


def _leg(
    edges: WedgeEdges,
    slabs: Sequence[Material],
    frequency_hz: float,
    sight: Sight,
    target: Real,
    target_velocity: Real,
    polarization: tuple[Polarization, Polarization],
    most: int,
) -> tuple[_Leg, int]:
    """The strongest clear ways to one target, and the number of weaker ones."""
    rays = rays_over_edges(edges, ORIGIN, target, SPEED_OF_LIGHT / frequency_hz)
    rays = rays.take(_clear(edges, rays, target, sight))
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
    best = np.argsort(-np.abs(sent * received), kind="stable")[:most]
    chosen, inward, outward = rays.edge[best], rays.inward[best], rays.outward[best]
    out_m, on_m = rays.geometry.source_distance_m[best], rays.geometry.observer_distance_m[best]
    level = along_array(edges.direction[chosen], inward)
    # The length grows by u' . v_edge + u . (v_target - v_edge): the edge point's own sliding costs nothing (Fermat).
    rate = np.einsum("ki,ki->k", outward, target_velocity - edges.velocity[chosen])
    leg = _Leg(
        point=np.where(level[:, None], inward * (out_m + on_m)[:, None], rays.point[best]),
        velocity=edges.velocity[chosen] + np.where(level, rate, 0.0)[:, None] * inward,
        rest_m=np.where(level, 0.0, on_m),
        rest_rate=np.where(level, 0.0, rate),
        sent=sent[best],
        received=received[best],
    )
    return leg, len(rays) - len(best)


def _clear(edges: WedgeEdges, rays: EdgeRays, target: Real, sight: Sight) -> NDArray[np.bool_]:
    """[K] whether both legs are free, up to a point beside the edge, between the legs and in the wedge's exterior.

    Each leg goes on a little beyond the plane of the other, so that a wall that continues the face in another mesh, and
    makes the edge no edge at all, stops one of them.
    """
    middle = 0.5 * (rays.geometry.source_angle_rad + rays.geometry.observer_angle_rad)
    chosen = edges.take(rays.edge)
    into_0 = np.cross(chosen.normal_0, chosen.direction)
    aside = rays.point + BESIDE_M * (np.cos(middle)[:, None] * into_0 + np.sin(middle)[:, None] * chosen.normal_0)
    clear = sight(np.zeros_like(aside), aside + 0.5 * BESIDE_M * rays.outward)
    towards = (aside - 0.5 * BESIDE_M * rays.inward)[clear]
    clear[clear] = sight(np.broadcast_to(target, towards.shape), towards)
    return clear


def _there_and_back(leg: _Leg, scale: float, owner: int) -> ScatteredPaths:
    """Every way out with every way back."""
    count = len(leg.rest_m)
    out, back = (index.reshape(-1) for index in np.meshgrid(np.arange(count), np.arange(count), indexing="ij"))
    return ScatteredPaths(
        tx_point=leg.point[out],
        rx_point=leg.point[back],
        tx_velocity=leg.velocity[out],
        rx_velocity=leg.velocity[back],
        between_m=leg.rest_m[out] + leg.rest_m[back],
        between_rate_mps=leg.rest_rate[out] + leg.rest_rate[back],
        amplitude=np.conj(scale * leg.sent[out] * leg.received[back]),
        depth=np.full(count**2, 3, dtype=np.int8),
        object_index=np.full(count**2, owner, dtype=np.int32),
        kinds=np.full(count**2, DIFFRACTED | TARGET, dtype=np.uint8),
    )
