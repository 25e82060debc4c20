"""Targets over mirrors: the echoes that a road, a wall or any other smooth face adds to a target's own.

docs/notes/targets.md has the model and its limits. Direct, over a mirror (:mod:`datafactory.paths.mirrors`) out or
back, and over it both ways make four paths. With g the field of one way over that of free space and R its length,

    A = lambda sqrt(sigma) / (4 pi)^(3/2)  g_out / R_out  g_back / R_back;

their sum is the echo in free space times the propagation factor F^4 (Barton, Radar System Analysis and Modeling, 2005,
section 8.3). All four are there or none: they need second bounces, mirrors and targets together. Several mirrors of one
point give every way out with every way back. Each end sees the target's image in its mirror, so that delays are exact.

The target answers with the components along theta^ and phi^ of the wave that arrives, as rough surfaces do. Its cross
section is the monostatic one towards the bisector of the two directions in which it sees the radar, or the radar's
image (Kell, Proc. IEEE 53, 1965): pairs of ways more than 90 deg apart are left out and counted. Left out without a
count: what a tilted mirror turns into the other polarisation, where the radar receives across its own.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from datafactory.paths.columns import pairs_in_runs, place_in_run
from datafactory.paths.echo_points import EchoPoints, Seen, seen_from
from datafactory.paths.mirrors import AXES, Ways, ways_over_mirrors
from datafactory.paths.rows import mirrored_velocity
from datafactory.paths.table import SPECULAR, TARGET, ScatteredPaths
from datafactory.paths.view import View
from shared.physics.vectors import Complex, Index, Mask, lengths, unit

WEAKEST = 1e-3
"""Ways whose field is weaker than this share of free space's are left out: -60 dB one way."""
MIRRORS_PER_POINT = 4
"""Ways over mirrors that are kept for each echo point, the strongest: 24 paths beside the direct one."""
WIDEST_COSINE = 0.0
"""Least cosine between the directions of way out and way back, seen from the target: 90 deg."""
DIRECT = -1
"""Stands for the direct way where a mirror's triangle is asked for."""


@dataclass(frozen=True)
class DirectWays:
    """The echo points of all targets as the radar sees them directly.

    :param points: K echo points in the radar frame, silent ones among them
    :param circumstances: under which they are seen
    :param sent, received: [K] fields for the polarisations of TX and RX over those of free space; 0 where hidden
    :param kinds: [K] kinds of interaction of a direct echo
    """

    points: EchoPoints
    circumstances: Seen
    sent: Complex
    received: Complex
    kinds: NDArray[np.uint8]


def echoes_over_mirrors(view: View, direct: DirectWays, wanted: Mask) -> tuple[ScatteredPaths, dict[str, int]]:
    """The echoes of point targets that take a mirror out, back, or both ways.

    :param wanted: [K] which echo points are followed
    :return: the paths, their candidates numbers of the echo points; the numbers of ways over mirrors, of weaker ways
        left out, and of pairs of ways too far apart
    """
    chosen = np.flatnonzero(wanted)
    every = ways_over_mirrors(view, direct.points.position[chosen])
    every = replace(every, point=chosen[every.point])
    mirrors = _strongest(every)
    ways = Ways.joined([_direct(direct, mirrors, view), mirrors])
    ways = ways.take(np.argsort(ways.point, kind="stable"))
    one, other = pairs_in_runs(ways.point)
    mirrored = (ways.triangle[one] != DIRECT) | (ways.triangle[other] != DIRECT)
    one, other = one[mirrored], other[mirrored]
    seen, kept = _seen_along(view, direct, ways, one, other)
    out, back = ways.take(one[kept]), ways.take(other[kept])
    counts = {
        "target_mirrors": len(mirrors),
        "target_mirrors_left_out": len(every) - len(mirrors),
        "target_mirrors_too_wide": int((~kept).sum()),
    }
    tx, rx = (AXES.index(which) for which in view.settings.polarization)
    field = np.einsum("ki,ki->k", out.sent, back.received) if tx == rx else out.sent[:, tx] * back.received[:, rx]
    there, here = out.image(seen.position), back.image(seen.position)
    level = seen.amplitudes(view.wavelength_m) / (lengths(there) * lengths(here))
    straight = (out.triangle == DIRECT) | (back.triangle == DIRECT)
    paths = ScatteredPaths(
        tx_point=there,
        rx_point=here,
        tx_velocity=mirrored_velocity(seen.velocity, out.normal, out.velocity),
        rx_velocity=mirrored_velocity(seen.velocity, back.normal, back.velocity),
        between_m=np.zeros(len(field)),
        between_rate_mps=np.zeros(len(field)),
        amplitude=level * field,
        depth=np.where(straight, 2, 3).astype(np.int8),
        object_index=view.merged.object_of_target(seen.target),
        kinds=(SPECULAR | np.where(straight, direct.kinds[out.point], TARGET)).astype(np.uint8),
        candidate=out.point.astype(np.int32),
    )
    return paths.take(paths.amplitude != 0.0), counts


def _strongest(ways: Ways) -> Ways:
    """The strongest ways to each point, in their order."""
    level = np.sqrt(np.abs(ways.sent).max(axis=1, initial=0.0) * np.abs(ways.received).max(axis=1, initial=0.0))
    heard = np.flatnonzero(level > WEAKEST)
    by_strength = heard[np.lexsort((-level[heard], ways.point[heard]))]
    return ways.take(np.sort(by_strength[place_in_run(ways.point[by_strength]) < MIRRORS_PER_POINT]))


def _direct(direct: DirectWays, mirrors: Ways, view: View) -> Ways:
    """The direct ways to those points that are seen over mirrors too: over a mirror without a normal, which moves
    nothing."""
    chosen = np.flatnonzero((direct.sent != 0.0) | (direct.received != 0.0))
    chosen = chosen[np.isin(chosen, mirrors.point)]
    nowhere, which = np.zeros((len(chosen), 3)), np.full(len(chosen), DIRECT)
    sent, received = np.zeros((2, len(chosen), 2), dtype=np.complex128)
    tx, rx = (AXES.index(which) for which in view.settings.polarization)
    sent[:, tx], received[:, rx] = direct.sent[chosen], direct.received[chosen]
    return Ways(chosen, which, nowhere, np.zeros(len(chosen)), nowhere, sent, received)


def _seen_along(view: View, direct: DirectWays, ways: Ways, out: Index, back: Index) -> tuple[EchoPoints, Mask]:
    """The echo points as ways out and back [n] see them together, in the radar frame, and which of the pairs [n] are
    near enough to each other; the points are of these alone."""
    number = ways.point[out]
    target, place = direct.points.target[number].astype(np.int64), direct.points.place[number]
    key = np.stack([target, *np.sort([ways.triangle[out], ways.triangle[back]], axis=0)], axis=1)
    keys, which = np.unique(key, axis=0, return_inverse=True)
    images = np.asarray(view.pose.position, dtype=np.float64) + ways.image(np.zeros(3)) @ view.rotation.T
    radars = dict(zip(ways.triangle.tolist(), images, strict=True))
    parts, begins, count = [direct.points.take(np.zeros(0, dtype=np.int64))], np.full(len(keys), -1), 0
    for index, (item, one, other) in enumerate(keys.tolist()):
        origin = np.array(view.merged.targets[item].position)
        radar = radars[one]
        if one != other:
            lines = np.array([radar - origin, radars[other] - origin])
            first, second = unit(lines)
            if first @ second < WIDEST_COSINE:
                continue
            radar = origin + np.linalg.norm(lines, axis=1).mean() * unit(first + second)
        parts.append(seen_from(view.merged.targets[item], item, radar, direct.circumstances))
        begins[index], count = count, count + len(parts[-1])
    begin = begins[which.reshape(-1)]
    return EchoPoints.joined(parts).take((begin + place)[begin >= 0]).seen_by(view.pose), begin >= 0
