"""Targets over mirrors: the echoes that a road, a wall or any other smooth face adds to a target's own.

A mirror gives a second way between radar and target (:mod:`datafactory.paths.mirrors`). With the direct one there
are four paths: direct, out over the mirror and directly back, its reverse, and over the mirror both ways. With g the
field of one way over that of free space and R its length,

    A = lambda sqrt(sigma) / (4 pi)^(3/2)  g_out / R_out  g_back / R_back.

Where all four see one sigma and the lengths differ little, their sum is the echo in free space times the propagation
factor F^4 in power, F = |1 + Gamma exp(-j k (R_mirror - R_direct))|: the lobing of a target above ground (Barton, Radar
System Analysis and Modeling, 2005, section 8.3; Skolnik, Introduction to Radar Systems, 3rd ed., section 8.2). With
Gamma near -1 the path that is reflected twice is as strong as the direct one, and without it there are no nulls. So all
four are there or none: they need second bounces, mirrors and targets together. Several mirrors of one point give every
way out with every way back. The delays are exact for every TX and RX, and for any constant velocities of radar, target
and mirror: each end sees the target's image in its mirror (:mod:`datafactory.paths.table`).

The target answers with the components along theta^ and phi^ of the wave that arrives, as rough surfaces do. Its cross
section is the monostatic one towards the bisector of the two directions in which it sees the radar, or the radar's
image (Kell, On the derivation of bistatic RCS from monostatic measurements, Proc. IEEE 53, 1965). That is meant for
small angles; pairs of ways more than 90 deg apart are left out and counted. Left out without a count: what a tilted
mirror turns into the other polarisation, where the radar receives across its own.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from datafactory.paths.echo_points import EchoPoints, Seen, seen_from
from datafactory.paths.mirrors import AXES, Ways, ways_over_mirrors
from datafactory.paths.table import SPECULAR, TARGET, ScatteredPaths
from datafactory.paths.unfold import mirrored_velocity, unit
from datafactory.paths.view import View
from shared.physics.vectors import Complex, Index, Mask, Real

WEAKEST = 1e-3
"""Ways whose field is weaker than this share of free space's are left out: -60 dB one way."""
MIRRORS_PER_POINT = 4
"""Ways over mirrors that are kept for each echo point, the strongest: 24 paths beside the direct one."""
WIDEST_COSINE = 0.0
"""Least cosine between the directions of way out and way back, seen from the target: 90 deg."""
DIRECT = -1
"""Stands for the direct way where a mirror's triangle or a way's number is asked for."""


@dataclass(frozen=True)
class DirectWays:
    """The echo points of all targets as the radar sees them directly.

    :param points: K echo points, silent ones among them; :param circumstances: under which they are seen
    :param sent, received: [K] fields for the polarisations of TX and RX over those of free space; 0 where hidden
    :param kinds: [K] kinds of interaction of a direct echo
    """

    points: EchoPoints
    circumstances: Seen
    sent: Complex
    received: Complex
    kinds: NDArray[np.uint8]


def echoes_over_mirrors(
    view: View, direct: DirectWays, wanted: Mask | None = None
) -> tuple[ScatteredPaths, dict[str, int]]:
    """The echoes of point targets that take a mirror out, back, or both ways.

    :param wanted: [K] which echo points are followed; None for all
    :return: the paths, their candidates numbers of the echo points; the numbers of ways over mirrors, of weaker ways
        left out, and of pairs of ways too far apart
    """
    position = (direct.points.position - np.asarray(view.pose.position)) @ view.rotation
    chosen = np.arange(len(position)) if wanted is None else np.flatnonzero(wanted)
    every = ways_over_mirrors(view, position[chosen])
    every = replace(every, point=chosen[every.point])
    ways = _strongest(every)
    views = _Views(view, direct.circumstances, ways)
    trips = [
        trip
        for number in np.unique(ways.point)
        for trip in _round_trips(int(number), np.flatnonzero(ways.point == number), direct, ways, views)
    ]
    apart = [trip for trip in trips if trip is None]
    heard = [trip for trip in trips if trip is not None and trip.amplitude != 0.0]
    counts = {
        "target_mirrors": len(ways),
        "target_mirrors_left_out": len(every) - len(ways),
        "target_mirrors_too_wide": len(apart),
    }
    first = len(view.merged.objects) - len(view.merged.targets)
    return _as_paths(heard, first), counts


@dataclass(frozen=True)
class _End:
    """A target's point along a way: [3] position [m], [3] velocity [m/s]; its image's where the way has a mirror."""

    position: Real
    velocity: Real


@dataclass(frozen=True)
class _Trip:
    """One path of one echo point."""

    out: _End
    back: _End
    amplitude: complex
    depth: int
    target: int
    kinds: int
    point: int


def _strongest(ways: Ways) -> Ways:
    """The strongest ways to each point, in their order."""
    level = np.sqrt(np.abs(ways.sent).max(axis=1, initial=0.0) * np.abs(ways.received).max(axis=1, initial=0.0))
    kept = [np.zeros(0, dtype=np.int64)]
    for number in np.unique(ways.point):
        own = np.flatnonzero((ways.point == number) & (level > WEAKEST))
        kept.append(np.sort(own[np.argsort(-level[own], kind="stable")[:MIRRORS_PER_POINT]]))
    return ways.take(np.concatenate(kept))


class _Views:
    """The targets as a way out and a way back see them together, each made once."""

    def __init__(self, view: View, circumstances: Seen, ways: Ways) -> None:
        self._targets, self._circumstances, pose = view.merged.targets, circumstances, view.pose
        self._rotation, self.polarization = view.rotation, view.settings.polarization
        self._here, self._velocity = np.asarray(pose.position, dtype=np.float64), np.asarray(pose.velocity)
        images = self._here + ways.image(np.zeros(3)) @ self._rotation.T
        self._radar = dict(zip(ways.triangle.tolist(), images, strict=True))
        self._radar[DIRECT] = self._here
        self._made: dict[tuple[int, int, int], EchoPoints | None] = {}

    def of(self, target: int, one: int, other: int) -> EchoPoints | None:
        """All echo points of a target, in the radar frame; None where the two directions are too far apart.

        :param one, other: triangles of the ways' mirrors, or DIRECT
        """
        key = (target, min(one, other), max(one, other))
        if key not in self._made:
            self._made[key] = self._seen_along(*key)
        return self._made[key]

    def _seen_along(self, target: int, one: int, other: int) -> EchoPoints | None:
        item = self._targets[target]
        origin = np.array(item.position)
        place = self._radar[one]
        if one != other:
            lines = np.array([self._radar[one] - origin, self._radar[other] - origin])
            first, second = unit(lines)
            if first @ second < WIDEST_COSINE:
                return None
            place = origin + np.linalg.norm(lines, axis=1).mean() * unit(first + second)
        points = seen_from(item, target, place, self._circumstances)
        return replace(
            points,
            position=(points.position - self._here) @ self._rotation,
            velocity=(points.velocity - self._velocity) @ self._rotation,
        )


def _round_trips(number: int, own: Index, direct: DirectWays, ways: Ways, views: _Views) -> Iterator[_Trip | None]:
    """Every way out with every way back of one echo point, but the direct one both ways; None for a pair too wide.

    :param own: the ways over mirrors to this point
    """
    target = int(direct.points.target[number])
    place = number - int(np.searchsorted(direct.points.target, target))  # which of the target's points
    tx, rx = (AXES.index(which) for which in views.polarization)
    straight = np.zeros((2, 2), dtype=np.complex128)
    straight[0, tx], straight[1, rx] = direct.sent[number], direct.received[number]
    choices = [DIRECT] * bool(np.any(straight)) + own.tolist()
    for out in choices:
        for back in choices:
            if out == back == DIRECT:
                continue
            view = views.of(target, *(DIRECT if way == DIRECT else int(ways.triangle[way]) for way in (out, back)))
            if view is None:
                yield None
                continue
            sent = straight[0] if out == DIRECT else ways.sent[out]
            received = straight[1] if back == DIRECT else ways.received[back]
            field = sent @ received if tx == rx else sent[tx] * received[rx]
            there, here = (_end(way, view.position[place], view.velocity[place], ways) for way in (out, back))
            spread = np.linalg.norm(there.position) * np.linalg.norm(here.position)
            level = direct.circumstances.wavelength_m * np.sqrt(view.rcs_m2[place]) / (4.0 * np.pi) ** 1.5 / spread
            kinds = SPECULAR | (int(direct.kinds[number]) if DIRECT in (out, back) else TARGET)
            depth = 1 + (out != DIRECT) + (back != DIRECT)
            yield _Trip(there, here, level * field, depth, target, kinds, number)


def _end(way: int, position: Real, velocity: Real, ways: Ways) -> _End:
    """The point itself, or its image in the way's mirror."""
    if way == DIRECT:
        return _End(position, velocity)
    chosen = ways.take(np.array([way]))
    moving = mirrored_velocity(velocity[None], chosen.normal, chosen.velocity)
    return _End(chosen.image(position[None])[0], moving[0])


def _as_paths(trips: list[_Trip], first: int) -> ScatteredPaths:
    """:param first: index of the first target among the scene's objects"""
    count = len(trips)
    return ScatteredPaths(
        tx_point=np.array([trip.out.position for trip in trips]).reshape(count, 3),
        rx_point=np.array([trip.back.position for trip in trips]).reshape(count, 3),
        tx_velocity=np.array([trip.out.velocity for trip in trips]).reshape(count, 3),
        rx_velocity=np.array([trip.back.velocity for trip in trips]).reshape(count, 3),
        between_m=np.zeros(count),
        between_rate_mps=np.zeros(count),
        amplitude=np.array([trip.amplitude for trip in trips], dtype=np.complex128),
        depth=np.array([trip.depth for trip in trips], dtype=np.int8),
        object_index=np.array([first + trip.target for trip in trips], dtype=np.int32),
        kinds=np.array([trip.kinds for trip in trips], dtype=np.uint8),
        candidate=np.array([trip.point for trip in trips], dtype=np.int32),
    )
