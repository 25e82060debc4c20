"""The boxes of a frame: the scene's things as the radar has them, at mid-frame.

A frame's motions are those of its start, for all of its duration (:mod:`datafactory.paths.table`). A box is carried to
mid-frame by its velocity relative to the radar, as the places in the column ``targets`` are.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np
from numpy.typing import NDArray

from datafactory.paths.table import PathTable
from datafactory.scenes.boxes import SeenThing
from datafactory.scenes.motion import triple
from shared.dataset import Box
from shared.radar import Radar

Real = NDArray[np.float64]


def boxes_of(things: Sequence[SeenThing], paths: PathTable, radar: Radar) -> tuple[tuple[Box, ...], dict[str, int]]:
    """The boxes in a radar's range and field of view, and how many there are within and without.

    A box counts as within where its middle or a corner is.

    :param paths: illuminated, for the boxes' power
    """
    every = (paths.scattered, paths.specular)
    index = np.concatenate([part.object_index for part in every])
    power = np.concatenate([np.abs(part.amplitude) ** 2 for part in every])
    known = index >= 0
    by_object = np.bincount(index[known], power[known], minlength=len(paths.objects))
    boxes, outside = [], 0
    for thing in things:
        center = np.array(thing.center) + np.array(thing.velocity) * radar.waveform.mid_frame_s
        if not _within(_outline(thing, center), radar):
            outside += 1
            continue
        yaw = float(np.arctan2(thing.forward[1], thing.forward[0]))
        total = float(by_object[list(thing.indices)].sum())
        boxes.append(Box(triple(center), thing.size, yaw, thing.velocity, thing.class_name, thing.name, total))
    return tuple(boxes), {"boxes": len(boxes), "boxes_out_of_view": outside}


def _outline(thing: SeenThing, center: Real) -> Real:
    """[9, 3] the middle and the corners of a box [m]."""
    corners = np.array([(0.0, 0.0, 0.0), *product((-0.5, 0.5), repeat=3)])
    return center + corners * np.array(thing.size) @ np.array([thing.forward, thing.left, thing.up])


def _within(places: Real, radar: Radar) -> bool:
    """Whether any of [n, 3] places [m] is ahead, within the range and between the first and the last bin of u."""
    range_m = np.linalg.norm(places, axis=1)
    u = places[:, 1] / np.maximum(range_m, 1e-9)
    waveform, bins = radar.waveform, radar.grid.u
    ahead = (places[:, 0] > 0.0) & (range_m <= waveform.ranges_m[-1])
    return bool((ahead & (u >= bins[0]) & (u <= bins[-1])).any())
