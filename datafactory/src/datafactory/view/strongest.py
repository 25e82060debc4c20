"""The strongest paths of a frame, by kind, as the lines that the wave followed.

A :class:`datafactory.paths.table.PathTable` has mirrors unfolded: of a leg that was reflected it holds the mirror image
of its end. A ray that is sent towards the image and reflected wherever it meets a surface, over the length of the leg,
runs along the leg itself (image principle, exact for plane mirrors). A path is drawn only if its legs then meet: at the
scattering point, or for a path of mirrors alone at the sensor. Legs that pass panes and are reflected as well, and legs
between two scattering points that are reflected, cannot be told from the table and are not drawn.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from datafactory.paths.table import CORNER, DIFFRACTED, REFRACTED, SPECULAR, TARGET, PathTable, ScatteredPaths
from datafactory.scenes.motion import Real
from datafactory.view.subject import DIFFRACTION, DIRECT, KINDS, MIRROR, REFRACTION, SEVERAL, RayCaster
from shared.physics.units import amplitude_to_db
from shared.physics.vectors import dots

PATHS_SHOWN = 200
MOST_MIRRORS = 3
"""On one leg; no path of the trace has more."""
APART_M, APART_SHARE = 0.05, 1e-3
"""Legs meet if their ends are no farther apart than this, plus this share of their length: float32 and the tilt of
nearly parallel facets."""
CLEAR_M = 1e-3
"""A reflected ray starts so far from its mirror."""


@dataclass(frozen=True, eq=False)
class ShownPath:
    """One path.

    :param kind: of :data:`datafactory.view.subject.KINDS`
    :param points: [n, 3] in the radar frame, from the sensor and back to it [m]
    :param level_db: 10 log10 of its power [dBW], antennas included
    :param range_m: half of its length [m]
    :param object: that scattered it; "" where unknown
    :param bounces: their number
    """

    kind: str
    points: Real
    level_db: float
    range_m: float
    object: str
    bounces: int


@dataclass(frozen=True)
class Shown:
    """The paths to be shown.

    :param paths: the strongest of every kind, strongest first
    :param found: how many paths of every kind the frame has
    :param not_drawn: chosen paths whose course cannot be told
    """

    paths: tuple[ShownPath, ...]
    found: dict[str, int]
    not_drawn: int


def kinds_of(table: PathTable) -> NDArray[np.str_]:
    """[scattered, then specular] kind of every path: the rarest interaction that it has names it."""
    kinds, depth = table.every("kinds"), table.every("depth")
    # A curved mirror spreads the wave: it stands among the scattered paths, without a scattering point.
    mirrors = (np.arange(len(kinds)) >= len(table.scattered)) | ((kinds == SPECULAR) & (depth == 1))
    conditions = [(kinds & DIFFRACTED) > 0, (kinds & REFRACTED) > 0, depth > 1, mirrors]
    return np.select(conditions, [DIFFRACTION, REFRACTION, SEVERAL, MIRROR], DIRECT)


def strongest(level: Real, kinds: NDArray[np.str_], count: int) -> NDArray[np.intp]:
    """Indices of at most ``count`` paths, strongest first: of every kind an equal share, what is left to the strongest.

    Otherwise the road below the sensor would be all that is shown.

    :param level: [K] power or its logarithm
    """
    order = np.argsort(-level, kind="stable")
    share = count // len(KINDS)
    first = np.concatenate([order[kinds[order] == kind][:share] for kind in KINDS])
    rest = order[~np.isin(order, first)][: count - len(first)]
    chosen = np.concatenate([first, rest]).astype(np.intp)
    return chosen[np.argsort(-level[chosen], kind="stable")]


def shown_paths(table: PathTable, caster: RayCaster, targets: Real) -> Shown:
    """The strongest paths of a frame.

    :param table: illuminated, amplitudes in sqrt(W)
    :param caster: the scene from the same pose
    :param targets: [T, 3] where the scene's point targets stand, the last of ``table.objects`` [m]
    """
    kinds = kinds_of(table)
    found = {kind: int((kinds == kind).sum()) for kind in KINDS}
    if not len(table):
        return Shown((), found, 0)
    level = amplitude_to_db(table.every("amplitude"))
    chosen = strongest(level, kinds, PATHS_SHOWN)
    mirrors = chosen >= len(table.scattered)
    lines: dict[int, Real] = {}
    lines |= _scattered_lines(table, chosen[~mirrors], caster, targets)
    lines |= _mirror_lines(table, chosen[mirrors], caster)
    range_m, owner, depth = table.range_m(), table.every("object_index"), table.every("depth")
    paths = tuple(
        ShownPath(
            str(kinds[index]), lines[index], float(level[index]), float(range_m[index]),
            table.objects[owner[index]] if 0 <= owner[index] < len(table.objects) else "", int(depth[index]),
        )
        for index in chosen.tolist() if index in lines
    )  # fmt: skip
    return Shown(paths, found, len(chosen) - len(paths))


def _scattered_lines(table: PathTable, chosen: NDArray[np.intp], caster: RayCaster, targets: Real) -> dict[int, Real]:
    """The lines of paths with a scattering point, by index; those that cannot be told are left out."""
    paths = table.scattered.take(chosen)
    curved = (paths.depth == 1) & ((paths.kinds & SPECULAR) > 0)
    reflected = ((paths.kinds & SPECULAR) > 0) & ~curved
    first_target, range_m = len(table.objects) - len(targets), paths.range_m()
    out = _legs(caster, paths.tx_point, reflected)
    back = _legs(caster, paths.rx_point, reflected)
    lines = {}
    for row, index in enumerate(chosen.tolist()):
        if reflected[row] and paths.kinds[row] & REFRACTED:
            continue
        if curved[row]:
            lines[index] = _at_a_curved_mirror(paths, row)
            continue
        between, owner = float(paths.between_m[row]), int(paths.object_index[row]) - first_target
        if paths.kinds[row] & DIFFRACTED and paths.kinds[row] & TARGET and 0 <= owner < len(targets):
            lines[index] = _round_corner(paths.tx_point[row], paths.rx_point[row], between, targets[owner])
            continue
        if abs(float(np.linalg.norm(out[row][-1] - back[row][-1])) - between) > _tolerance(range_m[row]):
            continue
        lines[index] = _joined(out[row], back[row][::-1])
    return lines


def _mirror_lines(table: PathTable, chosen: NDArray[np.intp], caster: RayCaster) -> dict[int, Real]:
    """The same of paths without a scattering point: they come back to the sensor."""
    paths = table.specular.take(chosen - len(table.scattered))
    single = (paths.depth == 1) | ((paths.kinds & CORNER) > 0)  # the echo of a corner comes from its edge or apex
    legs = _legs(caster, np.where(single[:, None], 0.5 * paths.image, paths.image), ~single)
    lines = {}
    for row, index in enumerate(chosen.tolist()):
        if single[row]:
            lines[index] = np.stack([np.zeros(3), legs[row][-1], np.zeros(3)])
        elif not paths.kinds[row] & REFRACTED:
            length = float(np.linalg.norm(paths.image[row]))
            if np.linalg.norm(legs[row][-1]) <= _tolerance(length):
                lines[index] = legs[row]
    return lines


def _legs(caster: RayCaster, image: Real, reflected: NDArray[np.bool_]) -> list[Real]:
    """[n, 3] points of K legs from the sensor: straight to ``image`` [K, 3], or reflected on the way."""
    length = np.linalg.norm(image, axis=1)
    direction = image / np.maximum(length, 1e-12)[:, None]
    start, remaining = np.zeros_like(image), length.copy()
    legs = [[np.zeros(3)] for _ in range(len(image))]
    under_way = np.flatnonzero(reflected)
    for _ in range(MOST_MIRRORS):
        met = caster.cast(start[under_way] + CLEAR_M * direction[under_way], direction[under_way])
        distance = met.distance + CLEAR_M
        before_end = distance < remaining[under_way] - _tolerance(length[under_way])
        under_way, distance, normal = under_way[before_end], distance[before_end], met.normal[before_end]
        if not len(under_way):
            break
        start[under_way] += distance[:, None] * direction[under_way]
        remaining[under_way] -= distance
        along = dots(direction[under_way], normal)
        direction[under_way] -= 2.0 * along[:, None] * normal
        for row in under_way.tolist():
            legs[row].append(start[row].copy())
    ends = start + remaining[:, None] * direction
    return [np.stack([*leg, end]) for leg, end in zip(legs, ends, strict=True)]


def _joined(*parts: Real) -> Real:
    """Points one after another, each place once."""
    points = np.concatenate(parts)
    apart = np.linalg.norm(np.diff(points, axis=0), axis=1) > CLEAR_M
    return np.concatenate([points[:1], points[1:][apart]])


def _tolerance(length: float | Real) -> float | Real:
    """How far apart the ends of legs of this length may be [m]."""
    return APART_M + APART_SHARE * length


def _at_a_curved_mirror(paths: ScatteredPaths, row: int) -> Real:
    """[3, 3] to the foot on a curved surface and back: p, q and the foot lie on one line of sight, whose lengths add
    to the whole way (:mod:`datafactory.paths.curved_echoes`).
    """
    sight = paths.rx_point[row] / np.linalg.norm(paths.rx_point[row])
    range_m = 0.5 * (float(sight @ (paths.tx_point[row] + paths.rx_point[row])) + float(paths.between_m[row]))
    return np.stack([np.zeros(3), range_m * sight, np.zeros(3)])


def _round_corner(tx_point: Real, rx_point: Real, between_m: float, target: Real) -> Real:
    """[5, 3] an echo of a hidden target: sensor, edge, target, edge, sensor.

    The table has a leg in one of two forms (:mod:`datafactory.paths.targets`): the point on the edge, the rest of
    the leg in ``between_m``; or, of an edge along the array, a point beyond it at the whole leg's length L along the
    unit vector d, where the edge is s d with s + |s d - t| = L, s = (L^2 - |t|^2) / (2 (L - d t)).
    """
    forms = []
    for point in (tx_point, rx_point):
        length = float(np.linalg.norm(point))
        direction = point / length
        detour = max(length - float(direction @ target), 1e-9)
        beyond = direction * (length**2 - float(target @ target)) / (2.0 * detour)
        forms.append(((point, float(np.linalg.norm(point - target))), (beyond, 0.0)))
    (out, _), (back, _) = min(
        ((one, other) for one in forms[0] for other in forms[1]),
        key=lambda pair: abs(pair[0][1] + pair[1][1] - between_m),
    )
    return np.stack([np.zeros(3), out, target, back, np.zeros(3)])
