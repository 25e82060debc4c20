"""How far a plane face reaches from a line or a point in its plane, whatever triangles it is cut into.

A face is a list of triangles in coordinates of its plane. Along a ray each of them covers an interval. The reach is
where the intervals that join each other from the ray's start end. It is a continuous, piecewise linear function along a
line, except where the face has steps. Pieces are found from the triangles' corners, refined where triangles overlap
crosswise, and joined again where the function goes on straight: the result does not depend on the cut.
"""

from __future__ import annotations

import numpy as np

from datafactory.paths.planes import TOUCH_M
from shared.physics.compiled import compiled

CRACK_M = 1e-3
"""Gaps between triangles that count as closed [m]."""
STRAIGHT_M = 1e-5
"""Largest difference from a straight line that counts as straight [m]."""
SHORTEST_M = 1e-5
"""Pieces along the line that are shorter are left out [m]."""
HALVINGS = 10
"""Of a piece in which the reach bends, at most."""
INSIDE = 1e-6
"""Share of a piece by which its ends are moved inwards, off the triangles' corners."""
DIRECTIONS = 45
"""In which the reach of a face is sampled over a right angle: every two degrees."""
FARTHEST_M = 50.0
"""Triangles that begin farther from the point, or that have no part in the first quarter, are not looked at [m]."""


@compiled(cache=False)
def flattened(triangles, members, origin, along, away):
    """[n, 3, 2] the triangles of a face in coordinates of its plane, from ``origin`` along two unit vectors [m]."""
    flat = np.empty((len(members), 3, 2))
    for t in range(len(members)):
        for c in range(3):
            z, a = 0.0, 0.0
            for k in range(3):
                off = triangles[members[t], c, k] - origin[k]
                z += off * along[k]
                a += off * away[k]
            flat[t, c, 0], flat[t, c, 1] = z, a
    return flat


@compiled(cache=False)
def _mirrored(flat, along, away):
    """The triangles [n, 3, 2] with either coordinate as it is or, by -1, reversed."""
    turned = np.empty_like(flat)
    for t in range(len(flat)):  # by elements: slices and rows take seconds to compile
        for c in range(3):
            turned[t, c, 0], turned[t, c, 1] = flat[t, c, 0] * along, flat[t, c, 1] * away
    return turned


@compiled(cache=False)
def strips(first, second):
    """[S, 6] pieces of the common edge of two faces, and how far both reach from it on the side of the second axis.

    :param first, second: [n, 3, 2] triangles (along the edge, away from it) [m]
    :return: start and end along the edge, reach of the first face at both, reach of the second at both [m]; pieces
        without reach are left out
    """
    low, high = -np.inf, np.inf
    for face in (first, second):
        start, stop = np.inf, -np.inf
        for t in range(len(face)):
            near = min(face[t, 0, 1], face[t, 1, 1], face[t, 2, 1])
            far = max(face[t, 0, 1], face[t, 1, 1], face[t, 2, 1])
            if near <= TOUCH_M and far >= -TOUCH_M:
                start = min(start, face[t, 0, 0], face[t, 1, 0], face[t, 2, 0])
                stop = max(stop, face[t, 0, 0], face[t, 1, 0], face[t, 2, 0])
        low, high = max(low, start), min(high, stop)
    if not high > low:
        return np.zeros((0, 6))
    one, other = overlapping(first, 0, low, high), overlapping(second, 0, low, high)
    # No triangle without a part on that side of the edge reaches anywhere there.
    one_side, other_side = overlapping(one, 1, 0.0, np.inf), overlapping(other, 1, 0.0, np.inf)
    if len(one_side) == 0 or len(other_side) == 0:
        return np.zeros((0, 6))
    corners = np.empty(3 * (len(one) + len(other)) + 2)
    corners[0], corners[1], count = low, high, 2
    for face in (one, other):
        for t in range(len(face)):
            for c in range(3):
                if low < face[t, c, 0] < high:
                    corners[count] = face[t, c, 0]
                    count += 1
    return _strips(one_side, other_side, np.sort(corners[:count]))


@compiled(cache=False)
def overlapping(face, axis, low, high):
    """The triangles of a face [n, 3, 2] of which a part lies between two values of a coordinate."""
    kept = np.empty(len(face), dtype=np.bool_)
    for t in range(len(face)):
        kept[t] = max(face[t, 0, axis], face[t, 1, axis], face[t, 2, axis]) > low
        kept[t] &= min(face[t, 0, axis], face[t, 1, axis], face[t, 2, axis]) < high
    return face[kept]


@compiled(cache=False)
def _strips(first, second, corners):
    found = np.zeros((64, 6))
    count = 0
    for k in range(len(corners) - 1):
        pieces = [(corners[k], corners[k + 1], 0)]
        while len(pieces) > 0:
            low, high, depth = pieces.pop()
            if high - low < SHORTEST_M:
                continue
            inner = INSIDE * (high - low)
            middle = 0.5 * (low + high)
            one_low, one_high = reach(first, low + inner), reach(first, high - inner)
            two_low, two_high = reach(second, low + inner), reach(second, high - inner)
            bend = max(
                abs(reach(first, middle) - 0.5 * (one_low + one_high)),
                abs(reach(second, middle) - 0.5 * (two_low + two_high)),
            )
            if bend > STRAIGHT_M and depth < HALVINGS:
                pieces.append((middle, high, depth + 1))
                pieces.append((low, middle, depth + 1))
                continue
            if max(min(one_low, two_low), min(one_high, two_high)) <= 0.0:
                continue
            if count == len(found):
                found = np.concatenate((found, np.zeros_like(found)))
            found[count, 0], found[count, 1] = low, high
            found[count, 2], found[count, 3] = one_low, one_high
            found[count, 4], found[count, 5] = two_low, two_high
            if count > 0 and _goes_on(found[count - 1], found[count]):
                found[count - 1, 1] = high
                found[count - 1, 3], found[count - 1, 5] = one_high, two_high
            else:
                count += 1
    return found[:count].copy()


@compiled(cache=False)
def _goes_on(before, after):
    """Whether two pieces are one: they touch, and both faces' reach lies on one straight line."""
    if after[0] - before[1] > SHORTEST_M:
        return False
    share = (before[1] - before[0]) / (after[1] - before[0])
    for k in (2, 4):
        straight = before[k] + share * (after[k + 1] - before[k])
        if max(abs(before[k + 1] - straight), abs(after[k] - straight)) > 10.0 * STRAIGHT_M:
            return False
    return True


@compiled(cache=False)
def reach(triangles, along):
    """How far the triangles [n, 3, 2] reach from (along, 0) towards (along, inf) without a gap [m]."""
    count = len(triangles)
    low, high = np.empty(count), np.empty(count)
    crossed = 0
    for t in range(count):
        near, far = np.inf, -np.inf
        for c in range(3):
            d = (c + 1) % 3
            z, z_next = triangles[t, c, 0], triangles[t, d, 0]
            if z == z_next or along < min(z, z_next) or along > max(z, z_next):
                continue
            share = (along - z) / (z_next - z)
            away = triangles[t, c, 1] + share * (triangles[t, d, 1] - triangles[t, c, 1])
            near, far = min(near, away), max(far, away)
        if far > 0.0:
            low[crossed], high[crossed] = near, far
            crossed += 1
    total, grown = 0.0, True
    while grown:
        grown = False
        for t in range(crossed):
            if high[t] > total and low[t] <= total + (CRACK_M if total > 0.0 else TOUCH_M):
                total, grown = high[t], True
    return total


@compiled(cache=False)
def reach_around(triangles, angles):
    """[N] how far the triangles [n, 3, 2] reach from (0, 0) in the directions (cos, sin) of angles [N] [m]."""
    result = np.empty(len(angles))
    turned = np.empty_like(triangles)
    for k in range(len(angles)):
        cosine, sine = np.cos(angles[k]), np.sin(angles[k])
        for t in range(len(triangles)):
            for c in range(3):
                x, y = triangles[t, c, 0], triangles[t, c, 1]
                turned[t, c, 0] = -sine * x + cosine * y
                turned[t, c, 1] = cosine * x + sine * y
        result[k] = reach(turned, 0.0)
    return result


@compiled()
def all_strips(triangles, order, starts, pairs, origin, along, across):
    """The strips [S, 6] of all four quarters of every pair, with the pair [S] and the sides [S, 2] of each."""
    found, owner, sides = np.zeros((1024, 6)), np.zeros(1024, dtype=np.int64), np.zeros((1024, 2))
    count = 0
    for p in range(len(pairs)):
        one, other = pairs[p]
        first = flattened(triangles, order[starts[one] : starts[one + 1]], origin[p], along[p], across[p, 0])
        second = flattened(triangles, order[starts[other] : starts[other + 1]], origin[p], along[p], across[p, 1])
        for quarter in range(4):
            side_first, side_second = 1.0 - 2.0 * (quarter // 2), 1.0 - 2.0 * (quarter % 2)
            pieces = strips(_mirrored(first, 1.0, side_first), _mirrored(second, 1.0, side_second))
            while count + len(pieces) > len(found):
                found, owner = np.concatenate((found, np.zeros_like(found))), np.concatenate((owner, owner))
                sides = np.concatenate((sides, sides))
            for s in range(len(pieces)):
                for k in range(6):  # an assignment of rows takes 4 s to compile
                    found[count, k] = pieces[s, k]
                owner[count], sides[count, 0], sides[count, 1] = p, side_first, side_second
                count += 1
    return found[:count].copy(), owner[:count].copy(), sides[:count].copy()


@compiled()
def quarters(triangles, order, starts, triples, apex, edges, normals):
    """[M, 3, 4, N] reach of each face in the four quarters between its edges: both edges, the second reversed, ..."""
    angles = (np.arange(DIRECTIONS) + 0.5) * 0.5 * np.pi / DIRECTIONS
    result = np.zeros((len(triples), 3, 4, DIRECTIONS))
    for m in range(len(triples)):
        for i in range(3):
            face, one, other = triples[m, i], edges[m, (i + 1) % 3], edges[m, (i + 2) % 3]
            members = order[starts[face] : starts[face + 1]]
            across, sense = np.empty(3), 0.0
            for k in range(3):
                after, last = (k + 1) % 3, (k + 2) % 3
                across[k] = normals[m, i, after] * one[last] - normals[m, i, last] * one[after]
                sense += across[k] * other[k]
            flat = flattened(triangles, members, apex[m], one, across)
            for quarter in range(4):
                turned = _mirrored(flat, 1.0 - 2.0 * (quarter // 2), (1.0 - 2.0 * (quarter % 2)) * np.sign(sense))
                reach = reach_around(overlapping(overlapping(turned, 0, 0.0, FARTHEST_M), 1, 0.0, FARTHEST_M), angles)
                for n in range(DIRECTIONS):
                    result[m, i, quarter, n] = reach[n]
    return result
