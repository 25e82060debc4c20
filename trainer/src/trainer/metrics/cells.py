"""Detections in range and angle, each with a score and a level, held against the cells of the truth image.

A truth cell is a 3 x 3 maximum of the truth image that the channels can see above the noise and beside the row's
strongest echo. A detection is a 3 x 3 maximum of a method's score. It is matched to a truth cell at most one range bin
and two angle bins away, one to one. An unmatched detection beyond 5 m is a false alarm where it reads more than 10 dB
above all that the truth has around it; elsewhere it counts neither way. :mod:`trainer.metrics.ranking` makes curves of
many frames of it.

The level must be right: an image that reads far too low everywhere has no false alarms.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.ndimage import label, maximum_filter, mean

from shared.physics.errors import InputError
from shared.physics.units import db_to_power

LEAST_SNR_DB = 13.0
"""C |A|^2 / noise_power of a truth cell: with all channels summed a single target is found nearly always."""
ROW_SPAN_DB = 25.0
"""A truth cell stands at most this far below its row's maximum; the truth's own sidelobes lie at -30 dB."""
LEAST_RANGE_M = 5.0
"""Nearer waves are curved over the input array, and no method is told so: there nothing is missed and nothing false."""
REACH = (1, 2)
"""Largest distance of a detection from its truth cell [range bins, angle bins]."""
FALSE_ALARM_DB = 10.0
"""Level of a false alarm above the truth's maximum within that reach, at least."""

_AROUND = (2 * REACH[0] + 1, 2 * REACH[1] + 1)


@dataclass(frozen=True, eq=False)
class CellScores:
    """What became of the detections of one frame.

    :param matched: [m] scores of the detections that found a truth cell, falling
    :param false_alarms: [f] scores of the false alarms, falling
    :param truths: number of truth cells
    """

    matched: NDArray[np.float64]
    false_alarms: NDArray[np.float64]
    truths: int


def local_maxima(magnitude: NDArray[np.floating]) -> NDArray[np.intp]:
    """[n, 2] (range bin, angle bin) of the positive 3 x 3 maxima of an image [R, U], row by row.

    A plateau is one maximum, at the bin next to its mean place. A bin at the image's border needs to exceed only the
    neighbours that it has.
    """
    # The highest along a row first: what reaches that of the three rows around it is the highest of nine.
    highest = magnitude.copy()
    np.maximum(highest[:, 1:], magnitude[:, :-1], out=highest[:, 1:])
    np.maximum(highest[:, :-1], magnitude[:, 1:], out=highest[:, :-1])
    top = (magnitude == highest) & (magnitude > 0.0)
    top[1:] &= magnitude[1:] >= highest[:-1]
    top[:-1] &= magnitude[:-1] >= highest[1:]
    return _one_of_each_plateau(top)


def truth_cells(image: NDArray[np.floating], noise_power: float, channels: int, range_step: float) -> NDArray[np.intp]:
    """[n, 2] (range bin, angle bin) of the cells that a method of ``channels`` channels should find, row by row.

    They are those of :func:`visible_cells` beyond 5 m.

    :param range_step: of the rows, the first of which is at 0 [m]
    """
    places = visible_cells(image, noise_power, channels)
    return places[places[:, 0] * range_step > LEAST_RANGE_M]


def visible_cells(image: NDArray[np.floating], noise_power: float, channels: int) -> NDArray[np.intp]:
    """[n, 2] (range bin, angle bin) of the maxima that ``channels`` channels can see, at any range, row by row.

    They are the 3 x 3 maxima A of the truth with C |A|^2 / noise_power above 13 dB, within 25 dB of their row's
    maximum.

    :param image: [R, U] truth, linear magnitude [sqrt(W)]
    :param noise_power: of one channel in one range-Doppler cell [W]; 0 where there is no noise
    :param channels: C, how many the method uses
    :raises InputError: no image, or one that is not finite
    """
    magnitude = _image("truth", image)
    least = np.sqrt(db_to_power(LEAST_SNR_DB) * noise_power / channels)
    places = local_maxima(magnitude)
    level = magnitude[places[:, 0], places[:, 1]]
    within = level >= db_to_power(-ROW_SPAN_DB / 2.0) * magnitude.max(axis=1, initial=0.0)[places[:, 0]]
    return places[(level > least) & within]


def score_cells(
    truth: NDArray[np.floating],
    level: NDArray[np.floating],
    noise_power: float,
    channels: int,
    range_step: float,
    score: NDArray[np.floating] | None = None,
) -> CellScores:
    """Hold a method's image against the truth of its frame.

    At every threshold of the score the matched detections above it are as many as one-to-one matching allows: a
    detection of lower score never takes a truth cell from one of higher score, but the latter moves to another cell
    within its own reach if that makes room (augmenting paths, Kuhn 1955). Of detections of equal score those that
    would else be false alarms are matched first. So neither the cell that a detection is tried with first nor the order
    of equal scores changes anything.

    :param truth: [R, U] linear magnitude [sqrt(W)]
    :param level: [R, U] the method's magnitude [sqrt(W)]. It alone says what is a false alarm, so that an image
        without this unit cannot stand here
    :param noise_power: see :func:`truth_cells`, as ``channels`` and ``range_step``
    :param score: [R, U] by which detections are found and ranked, in any unit; the level by default
    :raises InputError: images of different shapes or not finite, and what :func:`truth_cells` refuses
    """
    true, reading = _image("truth", truth), _image("level", level)
    ranking = reading if score is None else _image("score", score)
    if not true.shape == reading.shape == ranking.shape:
        raise InputError("images", f"shapes {true.shape}, {reading.shape}, {ranking.shape}", "images of one shape")
    cells = truth_cells(true, noise_power, channels, range_step)
    found = local_maxima(ranking)
    rows, bins = found.T
    rank = ranking[rows, bins]
    ceiling = db_to_power(FALSE_ALARM_DB / 2.0) * maximum_filter(true, _AROUND, mode="constant")
    alarm = (reading[rows, bins] > ceiling[rows, bins]) & (rows * range_step > LEAST_RANGE_M)
    order = np.lexsort((~alarm, -rank))
    found, rank, alarm = found[order], rank[order], alarm[order]
    matched = match_cells(found, cells, true.shape)
    return CellScores(rank[matched], rank[alarm & ~matched], len(cells))


def match_cells(found: NDArray[np.intp], cells: NDArray[np.intp], shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """[n] which detections [n, 2], best first, have a truth cell [m, 2] within :data:`REACH` to themselves."""
    cell_at = np.full((shape[0] + 2 * REACH[0], shape[1] + 2 * REACH[1]), -1)
    cell_at[cells[:, 0] + REACH[0], cells[:, 1] + REACH[1]] = np.arange(len(cells))
    windows = sliding_window_view(cell_at, _AROUND)
    near = windows[found[:, 0], found[:, 1]].reshape(len(found), _AROUND[0] * _AROUND[1])
    served: dict[int, int] = {}  # cell to detection
    holds: dict[int, int] = {}  # detection to cell
    full: set[int] = set()  # cells from which no way leads to a free one, now and later

    def find_room(detection: int) -> bool:
        reached: dict[int, int] = {}  # cell to the detection that could take it
        queue = [detection]
        for one in queue:
            for cell in near[one].tolist():
                if cell < 0 or cell in reached or cell in full:
                    continue
                reached[cell] = one
                if cell in served:
                    queue.append(served[cell])
                    continue
                free: int | None = cell
                while free is not None:
                    taker = reached[free]
                    left = holds.get(taker)
                    served[free], holds[taker] = taker, free
                    free = left
                return True
        full.update(reached)
        return False

    matched = np.zeros(len(found), dtype=bool)
    for detection in np.flatnonzero(near.max(axis=1, initial=-1) >= 0).tolist():
        matched[detection] = find_room(detection)
    return matched


def _one_of_each_plateau(top: NDArray[np.bool_]) -> NDArray[np.intp]:
    """[n, 2] places of a mask [R, U], one for each group of adjacent bins."""
    places = np.argwhere(top)
    around = np.pad(top, 1)
    rows, bins = places.T + 1
    if not any(around[rows + down, bins + aside].any() for down, aside in ((0, 1), (1, -1), (1, 0), (1, 1))):
        return places
    groups, count = label(top, np.ones((3, 3)))
    of_place = groups[places[:, 0], places[:, 1]]
    every = np.arange(1, count + 1)
    middle = np.stack([mean(places[:, axis], of_place, every) for axis in (0, 1)], axis=1)
    distance = np.sum((places - middle[of_place - 1]) ** 2, axis=1)
    nearest = np.lexsort((distance, of_place))
    chosen = nearest[np.searchsorted(of_place[nearest], every)]
    return places[np.sort(chosen)]


def _image(name: str, image: NDArray[np.floating]) -> NDArray[np.float64]:
    magnitude = np.asarray(image, dtype=np.float64)
    if magnitude.ndim != 2 or not np.isfinite(magnitude).all():
        raise InputError(name, f"shape {magnitude.shape}, finite or not", "a finite image [R, U]")
    return magnitude
