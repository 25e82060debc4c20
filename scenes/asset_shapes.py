"""Rounded bodies of facets, of which :mod:`make_assets` builds vehicles and street furniture. Metres, x ahead, z up.

A facet that samples a curved surface reflects as that surface does if its neighbours are turned by 25 degrees at most
and are of like width (docs/notes/curved.md): outlines here turn by less, in strips of like width. Vertices are kept to
a hundredth of a millimetre: rounded to a whole one they would bend a post by as much as its own facets do.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from datafactory.scenes.city.shapes import Polygon, Surface, welded

Real = NDArray[np.float64]
DECIMALS = 5


surface_of = partial(welded, decimals=DECIMALS)
placed = partial(Surface.moved, decimals=DECIMALS)


def bowed_outline(half_length: float, half_width: float, corner: float, parts: tuple[int, int, int]) -> Real:
    """[n, 2] closed plan of a vehicle, counter-clockwise: bowed ends and sides, joined by round corners.

    Each of the eight pieces is an arc that goes on into the next without a fold. Ends turn by 28 degrees in all, sides
    by 10.

    :param corner: radius of the corners [m]
    :param parts: facets of an end, of a corner and of a side
    """
    end, side = np.radians(14.0), np.radians(5.0)
    # Along either axis the four kinds of arc add up to the half size.
    across = [[np.sin(end), 1.0 - np.cos(side)], [1.0 - np.cos(end), np.sin(side)]]
    rest = [
        half_width - corner * (np.cos(side) - np.sin(end)),
        half_length - corner * (np.cos(end) - np.sin(side)),
    ]
    radius_end, radius_side = np.linalg.solve(across, rest)
    ends, corners, sides = parts
    half = 0.5 * np.pi
    pieces = [(radius_end, -end, end, ends)]
    for quarter in range(4):
        low, high = (end, half - side) if quarter % 2 == 0 else (side, half - end)
        pieces.append((corner, quarter * half + low, quarter * half + high, corners))
        flat, radius, count = ((side, radius_side, sides), (end, radius_end, ends))[quarter % 2]
        if quarter < 3:
            pieces.append((radius, (quarter + 1) * half - flat, (quarter + 1) * half + flat, count))
    at = np.array([half_length - radius_end * (1.0 - np.cos(end)), -radius_end * np.sin(end)])
    points = [at]
    for radius, first, last, count in pieces:
        angle = np.linspace(first, last, count + 1)
        arc = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        points.extend(at + arc[1:] - arc[0])
        at = points[-1]
    return np.array(points[:-1])  # the last is the first again


def round_outline(radius: float, sides: int) -> Real:
    """[sides, 2] corners on a circle, counter-clockwise."""
    angle = 2.0 * np.pi * np.arange(sides) / sides
    return radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def _facets(levels: Sequence[tuple[float, Real]]) -> Iterator[tuple[int, int, Real]]:
    """Band, strip and corners [4, 3] of every facet between outlines, one above the other."""
    rings = [np.column_stack([outline, np.full(len(outline), z)]) for z, outline in levels]
    for band, (low, high) in enumerate(pairwise(rings)):
        for strip in range(len(low)):
            beyond = (strip + 1) % len(low)
            yield band, strip, np.array([low[strip], low[beyond], high[beyond], high[strip]])


def loft(
    levels: Sequence[tuple[float, Real]],
    material: str | Callable[[int, int], str],
    floor: str = "",
    lid: str = "",
    left_out: Callable[[int, int], bool] = lambda band, strip: False,
) -> Surface:
    """A body between outlines of equal numbers of corners, one above the other.

    :param levels: height and outline [n, 2], counter-clockwise, rising
    :param material: of all sides, or of (band, strip)
    :param floor, lid: their materials; none where empty
    :param left_out: whether a facet is an opening
    """
    faces = [
        Polygon(corners, material if isinstance(material, str) else material(band, strip))
        for band, strip, corners in _facets(levels)
        if not left_out(band, strip)
    ]
    bottom, top = (np.column_stack([outline, np.full(len(outline), z)]) for z, outline in (levels[0], levels[-1]))
    if floor:
        faces.append(Polygon(bottom[::-1], floor))
    if lid:
        faces.append(Polygon(top, lid))
    return surface_of(faces)


def recess(
    levels: Sequence[tuple[float, Real]],
    left_out: Callable[[int, int], bool],
    inwards: Callable[[Real], Real],
    material: str,
) -> Surface:
    """The inside of the openings that :func:`loft` leaves: their facets moved inwards, and walls to them.

    :param inwards: from points [n, 3] of the opening to those of its ground
    """
    faces = list[Polygon]()
    count = len(levels[0][1])
    for band, strip, corners in _facets(levels):
        if not left_out(band, strip):
            continue
        faces.append(Polygon(inwards(corners), material))
        neighbours = ((band - 1, strip), (band, (strip + 1) % count), (band + 1, strip), (band, (strip - 1) % count))
        for side, (other, next_to) in enumerate(neighbours):
            open_beyond = 0 <= other < len(levels) - 1 and left_out(other, next_to)
            below_the_sill = other < 0
            if not open_beyond and not below_the_sill:
                a, b = corners[side], corners[(side + 1) % 4]
                faces.append(Polygon(np.array([a, b, *inwards(np.array([b, a]))]), material))
    return surface_of(faces)


def post(radius: float | tuple[float, float], bottom: float, top: float, material: str, sides: int = 16) -> Surface:
    """A round post about the z axis, which may taper from its foot to its head."""
    foot, head = (radius, radius) if isinstance(radius, float) else radius
    levels = [(bottom, round_outline(foot, sides)), (top, round_outline(head, sides))]
    return loft(levels, material, floor=material, lid=material)


def wheel(radius: float, width: float, x: float, y: float) -> Surface:
    """A wheel on the ground at (x, y) that rolls along x, open towards y = 0: tread of rubber, face of metal."""
    # A quarter turn, so that a corner stands on the ground.
    tread = round_outline(radius, 15)[:, ::-1] * [1.0, -1.0]
    inner, outer = -0.5 * width, 0.5 * width
    faces = list[Polygon]()
    hub = (0.0, outer - 0.03, 0.0)  # a shallow bowl: a flat disc would be a mirror of 40 dBsm
    for i in range(15):
        j = (i + 1) % 15
        a, b = ((x, z) for x, z in (tread[i], tread[j]))
        tyre = [(a[0], inner, a[1]), (a[0], outer, a[1]), (b[0], outer, b[1]), (b[0], inner, b[1])]
        faces.append(Polygon(np.array(tyre), "rubber"))
        faces.append(Polygon(np.array([(a[0], outer, a[1]), hub, (b[0], outer, b[1])]), "metal"))
    turn = np.eye(3) if y > 0.0 else np.diag([-1.0, -1.0, 1.0])  # half a turn about z on the right-hand side
    return placed(surface_of(faces), (x, y, radius), turn)
