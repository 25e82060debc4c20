"""The detections of a frame: lines fitted to groups of cells, one for each target (docs/points.md).

The Hann window's main lobe is four range bins, and Doppler cells, wide; its sidelobes begin at -31 dB. What stands in a
neighbour of a group's cell is fitted in that group. Which lines are targets says :mod:`trainer.run.targets_once`.

The false alarms of a frame are those of first lines in noise, all Doppler cells searched among which the fitted ones
were chosen; as many are allowed to further lines in the groups that were heard.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, logit

from shared.physics.errors import InputError
from shared.physics.units import amplitude_to_db, db_to_power, power_to_db
from shared.radar import Radar
from shared.signal.ego_motion import EgoMotion, folded, moving_probability, velocity_period_mps
from shared.signal.model_error import model_error_ratio, with_model_error
from trainer.data.measurements import Cells
from trainer.defaults import FALSE_ALARMS
from trainer.estimators.array import LineArray
from trainer.estimators.fitting import (
    FALSE_ALARM,
    MODEL_ERROR_DB,
    GroupTest,
    RangePlace,
    fit_groups,
    line_threshold,
    score_peaks,
)
from trainer.estimators.unlike_ways import unlike_ways_db
from trainer.estimators.velocities import UNIFORM, lean, velocity_offsets
from trainer.run.false_alarms import first_line_threshold
from trainer.run.targets_once import Beams, Centres, Lines, heard_centres

CANDIDATES = 6
"""Peaks of a row's score that its fit begins with: the fit adds what is missing and drops what is needless."""
HEARD_SHARE = 0.5
"""Of the threshold of a group: a cell that holds less of its own is no centre. Half-way between bins, and between
Doppler cells, a target loses 1.4 dB to the Hann window: both together are less than this half."""
OWN_BINS = 0.75
"""A line so far from the centre of its group is left to the neighbour that is a centre too. Half a bin and a quarter
more, so that noise in the offset loses no target between two bins; what both have is listed once."""
REACH_BINS = 1.5
"""Where the neighbour is no centre, half a bin beyond it: a line farther away has its peak outside its group."""
PLACED_BINS = 0.5
"""A line whose range its cells tell no better, half a bin, is the flank of a sidelobe, at whatever level fits."""
UNSEEN_BINS = 0.25
"""The same of a line in a neighbouring bin whose peaks leave its Doppler cell out: nothing measures it there, and what
one bin more or less does to the level that fits is 6 dB and more."""
SAME_ANGLE_CELLS = 0.5
"""Lines of different groups at most so far apart, in resolution cells of the array, are one target's: the Hann window's
neighbours tell its angle to a fraction of that, and pairs half a cell apart are resolved within one group."""
GHOST_PROBABILITY = 1e-3
"""That errors of single elements add up to more than what is taken for a ghost, at one angle: as they add up at random,
their power is exponentially distributed about its mean."""
REPORTED_WITHIN_DB = 3.3
"""Of the true model error lies what a calibration reports in 19 of 20 cases, one-sided, at a standard deviation of 2 dB
(:class:`trainer.run.configuration.Imperfections`)."""
SIDEBANDS_DB = 45.0
"""Below a line of one chirp an oscillator's phase noise is looked for. That of a TI board as the imperfections have it,
-84 dBc/Hz within 300 kHz, stands 50 dB and more below in a range bin; it averages over the chirps."""
BY_LEVEL = (-0.23, 0.095, 0.0, 1.13)
"""(a, b, c, d) of a method without a detection head."""
BY_HEAD = (1.9, 0.061, 0.48, 1.03)
"""(a, b, c, d) with one."""
HIGHEST_DB = 45.0
"""Beyond, a line is as often a ghost of a strong echo as an echo: what is stronger is no more likely."""
LEAST_HEAD = 1e-4
"""Of h and of 1 - h: their logit stays finite, and heads of less do not differ."""
MOST_MIGRATION = 2.0
"""Bins: an echo that migrates farther is no longer told by a mean place and a variance (step 8 of the fit)."""
LEAST_BIN, LAST_BINS = 1.0, 2.0
"""Nearer stands what leaks from the TX into the RX, at range zero, of any phase in each channel. Where the axis
comes round its main lobe reaches into the last two bins. Its sidelobes are explained as a target's are."""


@dataclass(frozen=True, eq=False)
class Detections:
    """N detections, the strongest first.

    :param range_m: [N] by the beat frequency, fitted where a neighbouring bin shows the target, else its bin's [m]
    :param u: [N] sin(azimuth)
    :param velocity: [N] fitted where the cells beside its Doppler cell are known, else that cell's [m/s]
    :param amplitude_db: [N] of the line in its range-Doppler cell [dB re 1 sqrt(W)]
    :param u_std: [N] standard deviation of u by the Cramer-Rao bound; of TX in turn with that of the velocity
    :param probability: [N] that an echo stands there, by :func:`line_probability`
    :param range_std: [N] likewise of the range, that of a uniform bin where it is the bin's [m]
    :param velocity_std: [N] likewise of the velocity [m/s]
    :param moving: [N] probability that it is of something that moves; NaN where the sensor's own motion is not
        known, and of less than three chirps
    :param doppler_cell: [N] on the rising velocity axis, where its range-Doppler cell stands
    :param snr_db: [N] of the line in its cell, all channels added, over the noise that the fit was told [dB]
    :param unlike_ways_db: [N] of its cell, by :func:`trainer.estimators.unlike_ways.unlike_ways_db` [dB]
    """

    range_m: NDArray[np.float64]
    u: NDArray[np.float64]
    velocity: NDArray[np.float64]
    amplitude_db: NDArray[np.float64]
    u_std: NDArray[np.float64]
    probability: NDArray[np.float64]
    range_std: NDArray[np.float64]
    velocity_std: NDArray[np.float64]
    moving: NDArray[np.float64]
    doppler_cell: NDArray[np.int64]
    snr_db: NDArray[np.float64]
    unlike_ways_db: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.u)


@dataclass(frozen=True)
class Sought:
    """What counts as a detection.

    :param noise_power: of one channel and cell [W]
    :param model_error_db: see :func:`trainer.estimators.fitting.fit_lines`
    :param false_alarms: expected lines of a frame of noise alone
    """

    noise_power: float
    model_error_db: float = MODEL_ERROR_DB
    false_alarms: float = FALSE_ALARMS


def find_detections(
    image: NDArray[np.floating],
    probability: NDArray[np.floating] | None,
    seen: Cells,
    radar: Radar,
    array: LineArray,
    sought: Sought,
) -> Detections:
    """The detections of one frame.

    :param image: [D, R, U] of each Doppler peak; the fit begins with the peaks of image * sqrt(probability)
    :param probability: [D, R, U] of a target, None for a network without a detection head
    :param seen: in the channels of ``array``; a cell that repeats an earlier one of its range bin is left out
    :raises InputError: shapes that do not fit
    """
    snapshots, velocity, centre = seen.range_channel, seen.velocity, seen.centre
    expected = (*np.shape(snapshots)[:2], radar.grid.bins)
    if np.shape(image) != expected or np.shape(velocity) != expected[:2]:
        raise InputError("detections", f"an image {np.shape(image)}, velocities {np.shape(velocity)}", f"{expected}")
    if array.tells_no_angle:  # where it stands beside the origin would look like an angle
        array = replace(array, positions_m=np.zeros(array.channels))
    axis, chirps = radar.grid.u, radar.waveform.chirps
    cells = np.rint(np.asarray(velocity, dtype=np.float64) / radar.waveform.velocity_step_mps).astype(np.int64)
    range_m = _range_m(radar, len(cells[0]))
    straight = np.exp(-1j * array.bend_phase(range_m))
    first = first_line_threshold(sought.false_alarms, radar, array, centre is not None)
    least = HEARD_SHARE * first * sought.noise_power
    about = seen.new if centre is None else seen.new & centre
    centres = heard_centres(snapshots * straight, cells, seen.new, about, array, least)
    score = image[centres.peak, centres.row].astype(np.float64)
    if probability is not None:
        score *= np.sqrt(probability[centres.peak, centres.row])
    further = line_threshold(array, min(sought.false_alarms / max(len(centres), 1), FALSE_ALARM))
    test = GroupTest(sought.noise_power, sought.model_error_db, first, further)
    lines = _fitted(seen, straight, centres, score_peaks(score, axis, CANDIDATES), test, radar, array)
    near = SAME_ANGLE_CELLS * array.resolution_cell
    kept = lines.once(np.flatnonzero(_shown(lines, centres, radar)), near)
    kept = lines.explained_by_none(kept, near, float(np.sqrt(least / array.channels)))
    place = lines.place[kept]
    kept = kept[(place >= LEAST_BIN) & (place <= radar.waveform.samples - LAST_BINS)]
    # What the waves of simulated data leave is no error of an element.
    error = max(model_error_ratio(sought.model_error_db) - model_error_ratio(MODEL_ERROR_DB), 0.0)
    kept = lines.no_ghosts(kept, array, -np.log(GHOST_PROBABILITY) * error * float(db_to_power(REPORTED_WITHIN_DB)))
    beams = Beams(snapshots * straight, np.where(seen.new, cells, np.iinfo(np.int64).max), range_m, array)
    kept = lines.no_sidebands(kept, beams, SIDEBANDS_DB + float(power_to_db(chirps)))
    # The cell that a line stands in; the centre's where that one is not known.
    group, nearest = lines.group[kept], np.rint(lines.place[kept]).astype(np.intp)
    own = centres.holding(lines.cell[kept], nearest)
    peaks = np.where(own >= 0, own, centres.peak[group])
    rows = np.where(own >= 0, nearest, centres.row[group])
    head = None if probability is None else _around(probability, peaks, rows, lines.u[kept], axis)
    unlike_db = unlike_ways_db((snapshots * straight)[peaks, rows], array)
    snr_db = lines.level_db[kept] + power_to_db(array.channels / lines.noise[kept])
    centre_mps = np.asarray(velocity, dtype=np.float64)[peaks, rows]
    offset_std = lines.offset_std[kept]
    # The cells tell the range from the array's middle; the list has that from the radar's origin.
    nearer_m = np.where(np.isnan(offset_std), 0.0, 0.5 * array.positions_m.mean() * lines.u[kept])
    return Detections(
        range_m=lines.place[kept] * radar.waveform.range_step_m + nearer_m,
        u=lines.u[kept],
        # Half a cell beyond either end of the axis is its other end.
        velocity=folded(centre_mps + lines.shift[kept] * radar.waveform.velocity_step_mps, velocity_period_mps(radar)),
        amplitude_db=lines.level_db[kept],
        u_std=lines.u_std[kept],
        probability=line_probability(snr_db, unlike_db, head),
        range_std=np.where(np.isnan(offset_std), UNIFORM, offset_std) * radar.waveform.range_step_m,
        velocity_std=lines.shift_std[kept] * radar.waveform.velocity_step_mps,
        moving=np.full(len(kept), np.nan),
        doppler_cell=(lines.cell[kept] + chirps // 2) % chirps,
        snr_db=snr_db,
        unlike_ways_db=unlike_db,
    )


def _range_m(radar: Radar, bins: int) -> NDArray[np.float64]:
    """[bins] of the first range bins [m], by which wave fronts bend; that of bin 0 is bin 1's."""
    return np.maximum(np.arange(bins), 1) * radar.waveform.range_step_m


def _fitted(
    seen: Cells,
    straight: NDArray[np.complex128],
    centres: Centres,
    candidates: NDArray[np.float64],
    test: GroupTest,
    radar: Radar,
    array: LineArray,
) -> Lines:
    """Lines of the group about each centre, those of equal groups together.

    :param straight: [R, C] what undoes the bend of wave fronts at each bin's range
    :param candidates: [n, P] angles that each fit begins with, NaN for none
    """
    waveform, range_m, leaning = radar.waveform, _range_m(radar, len(straight)), lean(array, radar)
    # Of no group: an index, and the nine other columns below.
    parts: list[list[NDArray[Any]]] = [[np.empty(0, dtype=np.intp), *[np.empty(0)] * 9]]
    for peaks_at, members in centres.patterns():
        row, bins = centres.row[members], np.array(list(peaks_at))
        places = [(peaks_at[step], row + step) for step in peaks_at]
        # All cells of a group as its centre: bent by their own ranges, near bins would have other noise in common.
        values, *others = (
            np.stack([there[place] for place in places], axis=1) * straight[row, None]
            for there in (seen.range_channel, *(() if seen.beside is None else seen.beside))
        )
        at = RangePlace(range_m[row], waveform.range_step_m, _migration(centres.cell[members], radar))
        lines = fit_groups(values, bins, array, at, candidates[members], test)
        power = np.mean(np.abs(values) ** 2, axis=2)
        noise = with_model_error(test.noise_power, power.max(axis=1), model_error_ratio(test.model_error_db))
        shift = np.zeros(lines.u.shape), np.full(lines.u.shape, UNIFORM)
        if others:
            below, above = others
            shift = velocity_offsets(np.stack([below, values, above]), bins, array, at, lines, test.noise_power)
        group, line = np.nonzero(np.abs(lines.amplitude) > 0.0)
        u, u_std = lines.u + leaning * shift[0], np.hypot(lines.u_std, leaning * shift[1])
        columns = (u, lines.offset, np.abs(lines.amplitude), u_std, lines.offset_std, *shift)
        u, offset, amplitude, *told = (column[group, line] for column in columns)
        energy = power.sum(axis=1)[group]
        parts.append([members[group], energy, noise[group], u, offset, amplitude_to_db(amplitude), *told])
    group, energy, noise, u, offset, *rest = (np.concatenate(column) for column in zip(*parts, strict=True))
    place = np.asarray(centres.row[group] + offset, dtype=np.float64)
    around = waveform.samples if waveform.range_bins == waveform.samples else np.inf
    return Lines(waveform.chirps, around, place, centres.cell[group], group, energy, noise, u, offset, *rest)


def _shown(lines: Lines, centres: Centres, radar: Radar) -> NDArray[np.bool_]:
    """[N] whether a line lies in the field of view, is placed by its cells, and is nearest to its own centre."""
    axis, half_bin = radar.grid.u, 0.5 * radar.grid.step
    in_view = (lines.u >= axis[0] - half_bin) & (lines.u <= axis[-1] + half_bin)
    beside = {side: centres.holding(centres.cell, centres.row + side) >= 0 for side in (-1, 1)}
    seen = (np.abs(lines.offset) <= OWN_BINS) | np.where(lines.offset < 0.0, *(beside[s][lines.group] for s in (-1, 1)))
    placed = ~(lines.offset_std > np.where(seen, PLACED_BINS, UNSEEN_BINS))
    at_a_centre = centres.are_at(lines.cell, np.rint(lines.place).astype(np.intp))
    return in_view & placed & (np.abs(lines.offset) <= np.where(at_a_centre, OWN_BINS, REACH_BINS))


def line_probability(
    snr_db: NDArray[np.float64], unlike_db: NDArray[np.float64], head: NDArray[np.floating] | None
) -> NDArray[np.float64]:
    """P [N] that an echo stands at lines of L = ``snr_db`` [N], G = ``unlike_db`` [N], h = ``head`` [N]; None without a
    detection head.

    A line that passed the test for noise may still be none: the flank of a neighbour, a ghost of a board's
    errors, an echo of unlike ways out and back, which no one angle explains. How often that is so falls with the line's
    level L over the noise that the fit is told [dB], all channels added, and rises with what an echo of unlike ways
    explains more of its cell, G [dB] (:mod:`trainer.estimators.unlike_ways`). Where a network has a detection head, the
    logit of what that says at the line counts too:

        P = 1 / (1 + exp(-(a + b L + c logit h - d G)))

    (Platt, "Probabilistic outputs for support vector machines", 1999: the head's own h is the share of pixels that hold
    a peak of the truth, which few do). a, b, c and d are near what fits the lines of simulated drives through two
    cities best, of which the paths are known; ``python tests/benchmarks/driven_points.py`` prints those of one drive:
    docs/notes/points.md. Limit: lines of a board's phase noise are told from echoes by none of these.
    """
    a, b, c, d = BY_LEVEL if head is None else BY_HEAD
    said = 0.0 if head is None else logit(np.clip(head, LEAST_HEAD, 1.0 - LEAST_HEAD))
    return np.asarray(expit(a + b * np.minimum(snr_db, HIGHEST_DB) + c * said - d * unlike_db))


def with_moving(found: Detections, motion: EgoMotion | None, radar: Radar) -> Detections:
    """The detections with ``moving`` by the sensor's motion; as they are where it, or their velocity, is not known."""
    if motion is None or not radar.waveform.tells_velocity:
        return found
    seen = found.range_m, found.u, found.velocity, found.u_std, found.velocity_std, found.probability
    return replace(found, moving=moving_probability(motion, radar, *seen))


def _migration(cell: NDArray[np.int64], radar: Radar) -> NDArray[np.float64]:
    """[n] range bins through which an echo migrates in the frame, at most: v T over a bin is d B / f in cell d, f being
    mid-sweep's.

    The velocity may be folded once, unless the echo would migrate by more than MOST_MIGRATION then; not where elements
    that coincide tell its interval, which the cell then counts.
    """
    waveform = radar.waveform
    bins_a_cell = waveform.bandwidth_hz / waveform.mid_sweep_hz
    own, folded = np.abs(cell) * bins_a_cell, (waveform.chirps - np.abs(cell)) * bins_a_cell
    may_fold = (folded <= MOST_MIGRATION) & (radar.velocity_intervals == 1)
    return np.where(may_fold, folded, np.minimum(own, MOST_MIGRATION))


def _around(
    probability: NDArray[np.floating],
    peak: NDArray[np.intp],
    row: NDArray[np.intp],
    u: NDArray[np.float64],
    axis: NDArray[np.float64],
) -> NDArray[np.float64]:
    """[N] the larger probability of the two bins around each angle: a head marks the bin, the line falls beside it."""
    below = np.clip(np.searchsorted(axis, u, side="right") - 1, 0, len(axis) - 1)
    above = np.minimum(below + 1, len(axis) - 1)
    return np.maximum(probability[peak, row, below], probability[peak, row, above]).astype(np.float64)
