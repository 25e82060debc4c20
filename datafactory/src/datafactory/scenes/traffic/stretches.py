"""Straight stretches of free ground: where a road runs, and where vehicles could drive without turning.

A mesh that does not turn keeps whatever was found of its shape at every time (:mod:`datafactory.scenes.motion`); one
that turns is searched for edges, corners and curved surfaces anew in every frame. Traffic therefore drives straight,
and a road is a straight stretch. Candidates are points in the middle of the free ground, each with the heading in
which a strip of a given width goes on for the longest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from datafactory.scenes.ground import CLEARANCE_M, Ground
from datafactory.scenes.regions import SHARES
from datafactory.scenes.things import Strip

Real = NDArray[np.float64]
Mask = NDArray[np.bool_]

WIDTHS_M = (7.9, 5.6, 3.9)
"""Half widths that a road needs: with parked cars on both sides of two lanes, with two lanes, with one."""
WORTH = (1.0, 0.9, 0.6)
"""Of a metre of each."""
HEADINGS = 72
CANDIDATES = 400
REACH_M = 60
"""How far a stretch goes on to either side of its candidate, at most."""
SHORTEST_M = 36.0
WIDEST_M = 10.0
"""From its middle a road takes no more, however open the ground is."""
APART_M = 3.0
"""Between two stretches."""
UNEVEN_M = 0.1
"""How far the ground may be off a plane where vehicles drive."""


@dataclass(frozen=True)
class Stretch:
    """A straight piece of road.

    :param strip: its place, as wide as it is free
    :param plane: height [m] of its middle, and its slopes along and to the left
    :param region: of the split that its middle belongs to, see :class:`Ground`
    """

    strip: Strip
    plane: tuple[float, float, float]
    region: int

    def point(self, along: float, left: float) -> Real:
        """[3] world place on its plane [m]."""
        cosine, sine = np.cos(self.strip.heading_rad), np.sin(self.strip.heading_rad)
        x, y = self.strip.middle
        z = self.plane[0] + self.plane[1] * along + self.plane[2] * left
        return np.array([x + cosine * along - sine * left, y + sine * along + cosine * left, z])

    def axes(self, turn_rad: float) -> Real:
        """[3, 3] rows ahead, left and up of what stands on its plane, turned to the left of its heading."""
        heading = self.strip.heading_rad + turn_rad
        ahead = self.plane[1] * np.cos(turn_rad) + self.plane[2] * np.sin(turn_rad)
        aside = self.plane[2] * np.cos(turn_rad) - self.plane[1] * np.sin(turn_rad)
        return tilted(heading, float(ahead), float(aside))


def tilted(heading_rad: float, slope_ahead: float, slope_left: float) -> Real:
    """[3, 3] rows ahead, left and up of what stands on a plane with these slopes."""
    cosine, sine = np.cos(heading_rad), np.sin(heading_rad)
    ahead = np.array([cosine, sine, slope_ahead]) / np.hypot(1.0, slope_ahead)
    up = np.cross(ahead, [-sine, cosine, slope_left])
    up /= np.linalg.norm(up)
    return np.stack([ahead, np.cross(up, ahead), up])


def clear_width(ground: Ground, blocked: Mask) -> Real:
    """[nx, ny] radius [m] of the circle around a cell's middle in which nothing stands and no edge is."""
    free = np.pad(ground.free & ~blocked, 1)
    away: Real = ndimage.distance_transform_edt(free)[1:-1, 1:-1] * ground.cell_m
    return np.where(away > 0.0, away - np.sqrt(0.5) * ground.cell_m + CLEARANCE_M, 0.0)


def find_stretches(ground: Ground, blocked: Mask, wanted_m: float, rng: np.random.Generator) -> tuple[Stretch, ...]:
    """Stretches of road of a total length, in every split's region as its share.

    :param blocked: [nx, ny] where none may be, though it is free
    :param wanted_m: total length; less is found where there is no more
    """
    width = clear_width(ground, blocked)
    ridge = ground.street & (width >= WIDTHS_M[-1]) & (width >= ndimage.maximum_filter(width, 3))
    cells = np.argwhere(ridge)
    if not len(cells):
        return ()
    cells = cells[rng.permutation(len(cells))[:CANDIDATES]]
    found = _candidates(ground, width, cells)
    order = sorted(range(len(found)), key=lambda n: -found[n][0] * rng.uniform(0.75, 1.0))
    chosen: list[Stretch] = []
    left_over: list[Strip] = []
    lengths = [0.0] * len(SHARES)
    for number in order:
        strip = found[number][1]
        region = _region(ground, strip)
        if region < 0 or lengths[region] >= wanted_m * SHARES[region] / sum(SHARES):
            left_over.append(strip)
        elif (stretch := _fitting(ground, strip, region, chosen)) is not None:
            chosen.append(stretch)
            lengths[region] += stretch.strip.length_m
    for strip in left_over:
        if sum(lengths) >= wanted_m:
            break
        region = _region(ground, strip)
        if (stretch := _fitting(ground, strip, region, chosen)) is not None:
            chosen.append(stretch)
            lengths[max(region, 0)] += stretch.strip.length_m
    return tuple(chosen)


def _candidates(ground: Ground, width: Real, cells: NDArray[np.int64]) -> list[tuple[float, Strip]]:
    """The best strip through each cell, with its worth; those that are too short left out."""
    heading = np.pi * np.arange(HEADINGS) / HEADINGS
    along = np.arange(-REACH_M, REACH_M + 1)
    middle = np.array(ground.origin) + (cells + 0.5) * ground.cell_m
    x = middle[:, 0, None, None] + along * np.cos(heading)[:, None]
    y = middle[:, 1, None, None] + along * np.sin(heading)[:, None]
    free = ground.values_at(width, x, y)
    best: list[tuple[float, Strip] | None] = [None] * len(cells)
    for least, worth in zip(WIDTHS_M, WORTH, strict=True):
        wide = free >= least
        ahead = np.logical_and.accumulate(wide[..., REACH_M:], axis=-1).sum(axis=-1) - 1
        behind = np.logical_and.accumulate(wide[..., REACH_M::-1], axis=-1).sum(axis=-1) - 1
        length = ahead + behind
        which = length.argmax(axis=1)
        for n, k in enumerate(which):
            metres = float(length[n, k])
            if metres < SHORTEST_M or (best[n] is not None and best[n][0] >= worth * metres):  # type: ignore[index]
                continue
            shift = 0.5 * (ahead[n, k] - behind[n, k])
            run = free[n, k, REACH_M - behind[n, k] : REACH_M + ahead[n, k] + 1]
            x0, y0 = (middle[n] + shift * np.array([np.cos(heading[k]), np.sin(heading[k])])).tolist()
            best[n] = (worth * metres, Strip((x0, y0), float(heading[k]), metres, min(float(run.min()), WIDEST_M)))
    return [item for item in best if item is not None]


def _region(ground: Ground, strip: Strip) -> int:
    i, j = ground.cell_of(np.array(strip.middle[0]), np.array(strip.middle[1]))
    return int(ground.region[int(i), int(j)])


def _fitting(ground: Ground, strip: Strip, region: int, others: Sequence[Stretch]) -> Stretch | None:
    """The strip as a road, shorter where the ground bends; None where it is in another's way or too uneven."""
    if any(strip.overlaps(other.strip, APART_M) for other in others):
        return None
    half = min(strip.half_width_m - CLEARANCE_M, 3.0)
    while strip.length_m >= SHORTEST_M:
        along, left = (axis.ravel() for axis in np.meshgrid(
            np.linspace(-0.5, 0.5, 41) * strip.length_m, np.linspace(-half, half, 5)
        ))  # fmt: skip
        flat = Stretch(strip, (0.0, 0.0, 0.0), region)
        x, y = np.array([flat.point(a, b)[:2] for a, b in zip(along, left, strict=True)]).T
        z = ground.heights_at(x, y)
        if np.isfinite(z).all():
            base = np.stack([np.ones_like(along), along, left], axis=1)
            plane = np.linalg.lstsq(base, z, rcond=None)[0]
            if np.abs(base @ plane - z).max() <= UNEVEN_M:
                level, rise, tilt = (float(value) for value in plane)
                return Stretch(strip, (level, rise, tilt), region)
        strip = Strip(strip.middle, strip.heading_rad, 0.7 * strip.length_m, strip.half_width_m)
    return None
