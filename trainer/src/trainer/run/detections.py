"""The detections of a frame: lines fitted to groups of cells, one for each target (docs/points.md).

The Hann window's main lobe is four range bins, and Doppler cells, wide; its sidelobes begin at -31 dB. What stands in a
neighbour of a group's cell is fitted in that group. Which lines are targets says :mod:`trainer.run.targets_once`.

The false alarms of a frame are those of first lines in noise, all Doppler cells searched among which the fitted ones
were chosen; as many are allowed to further lines in the groups that were heard.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, logit

from shared.physics.errors import InputError
from shared.physics.units import amplitude_to_db, db_to_power, power_to_db
from shared.radar import Radar
from shared.radar.waveform import Waveform
from shared.signal.ego_motion import EgoMotion, moving_probability
from shared.signal.model_error import model_error_ratio, with_model_error
from trainer.data.measurements import Cells
from trainer.estimators.array import LineArray, uniform_axis
from trainer.estimators.fitting import (
    FALSE_ALARM,
    MODEL_ERROR_DB,
    SEARCH_POINTS,
    GroupTest,
    RangePlace,
    fit_groups,
    line_threshold,
    score_peaks,
)
from trainer.estimators.moves import beside_lines
from trainer.estimators.velocities import UNIFORM, velocity_offsets
from trainer.run.false_alarms import first_line_threshold
from trainer.run.targets_once import Beams, Lines

CANDIDATES = 6
"""Peaks of a row's score that its fit begins with: the fit adds what is missing and drops what is needless."""
FALSE_ALARMS = 1.0
"""Expected lines of a frame of noise alone, by :mod:`trainer.run.false_alarms`."""
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
MOST_BINS = 1 << 32
"""More than a range axis has."""
BY_LEVEL = (-1.15, 0.116, 0.0)
"""(a, b, c) of a method without a detection head."""
BY_HEAD = (1.7, 0.062, 0.49)
"""(a, b, c) with one."""
HIGHEST_DB = 45.0
"""Beyond, a line is as often a ghost of a strong echo as an echo: what is stronger is no more likely."""
LEAST_HEAD = 1e-4
"""Of h and of 1 - h: their logit stays finite, and heads of less do not differ."""
MOST_MIGRATION = 2.0
"""Bins: an echo that migrates farther is no longer told by a mean place and a variance (step 8 of the fit)."""
LEAST_BIN = 1.0
"""Nearer stands what leaks from the TX into the RX, at range zero, of any phase in each channel."""


@dataclass(frozen=True, eq=False)
class Detections:
    """N detections, the strongest first.

    :param range_m: [N] by the beat frequency, fitted where a neighbouring bin shows the target, else its bin's [m]
    :param u: [N] sin(azimuth)
    :param velocity: [N] fitted where the cells beside its Doppler cell are known, else that cell's [m/s]
    :param amplitude_db: [N] of the line in its range-Doppler cell [dB re 1 sqrt(W)]
    :param u_std: [N] standard deviation of u by the Cramer-Rao bound
    :param probability: [N] that an echo stands there, by :func:`line_probability`
    :param range_std: [N] likewise of the range, that of a uniform bin where it is the bin's [m]
    :param velocity_std: [N] likewise of the velocity [m/s]
    :param moving: [N] probability that it does not belong to the static world; NaN where the sensor's own motion is not
        known, and of one chirp
    :param doppler_cell: [N] on the rising velocity axis, where its range-Doppler cell stands
    :param snr_db: [N] of the line in its cell, all channels added, over the noise that the fit was told [dB]
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
    new, waveform, axis = seen.new, radar.waveform, radar.grid.u
    cells = np.rint(np.asarray(velocity, dtype=np.float64) / waveform.velocity_step_mps).astype(np.int64)
    range_m = np.maximum(np.arange(snapshots.shape[1]), 1) * waveform.range_step_m
    straight = np.exp(-1j * array.bend_phase(range_m))
    about = new if centre is None else new & centre
    first = first_line_threshold(sought.false_alarms, radar, array, centre is not None)
    least = HEARD_SHARE * first * sought.noise_power
    peak, row = _centres(*_heard(snapshots * straight, about, array, least), cells)
    score = image[peak, row].astype(np.float64)
    if probability is not None:
        score *= np.sqrt(probability[peak, row])
    further = line_threshold(array, min(sought.false_alarms / max(len(row), 1), FALSE_ALARM))
    test = GroupTest(sought.noise_power, sought.model_error_db, first, further)
    candidates = score_peaks(score, axis, CANDIDATES)
    found, part = [], []
    for peaks_at, members in _patterns(peak, row, cells, new):
        bins = np.array(list(peaks_at))
        places = [(peaks_at[step], row[members] + step) for step in peaks_at]
        # All cells of a group as its centre: bent by their own ranges, near bins would have other noise in common.
        values, *others = (
            np.stack([there[place] for place in places], axis=1) * straight[row[members], None]
            for there in (snapshots, *(() if seen.beside is None else seen.beside))
        )
        migration = _migration(cells[peak, row][members], waveform)
        at = RangePlace(range_m[row[members]], waveform.range_step_m, migration)
        fitted = fit_groups(values, bins, array, at, candidates[members], test)
        power = np.mean(np.abs(values) ** 2, axis=2)
        noise = with_model_error(sought.noise_power, power.max(axis=1), model_error_ratio(sought.model_error_db))
        group, line = np.nonzero(np.abs(fitted.amplitude) > 0.0)
        shift = np.zeros(fitted.u.shape), np.full(fitted.u.shape, UNIFORM)
        if others:
            below, above = others
            shift = velocity_offsets(np.stack([below, values, above]), bins, array, at, fitted, sought.noise_power)
        columns = (fitted.u, fitted.offset, np.abs(fitted.amplitude), fitted.u_std, fitted.offset_std, *shift)
        found.append(np.stack([values[group, line] for values in columns]))
        part.append(np.stack([members[group], power.sum(axis=1)[group], noise[group]]))
    u, offset, amplitude, u_std, offset_std, shift, shift_std = np.concatenate([np.empty((7, 0)), *found], axis=1)
    group, energy, noise = np.concatenate([np.empty((3, 0)), *part], axis=1)
    group = group.astype(np.intp)
    half_bin = 0.5 * radar.grid.step
    shown = (u >= axis[0] - half_bin) & (u <= axis[-1] + half_bin)
    shown &= ~(offset_std > PLACED_BINS) & (row[group] + offset >= LEAST_BIN)
    cell, nearest = cells[peak[group], row[group]], np.rint(row[group] + offset).astype(np.intp)
    at_a_centre = np.isin(_place(cell, nearest), _place(cells[peak, row], row))
    shown &= np.abs(offset) <= np.where(at_a_centre, OWN_BINS, REACH_BINS)
    lines = Lines(group, energy, row[group] + offset, cell, u, u_std, amplitude_to_db(amplitude), waveform.chirps)
    near = SAME_ANGLE_CELLS * array.resolution_cell
    kept = lines.once(np.flatnonzero(shown), near)
    kept = lines.explained_by_none(kept, near, float(np.sqrt(least / array.channels)))
    # What the waves of simulated data leave is no error of an element.
    error = max(model_error_ratio(sought.model_error_db) - model_error_ratio(MODEL_ERROR_DB), 0.0)
    kept = lines.no_ghosts(kept, array, -np.log(GHOST_PROBABILITY) * error * float(db_to_power(REPORTED_WITHIN_DB)))
    beams = Beams(snapshots * straight, np.where(new, cells, np.iinfo(np.int64).max), range_m, array)
    kept = lines.no_sidebands(kept, beams, SIDEBANDS_DB + float(power_to_db(waveform.chirps)))
    # The cell that a line stands in; the centre's where that one is not known.
    own = _peak_in(cells, new, cell[kept], nearest[kept])
    peaks = np.where(own >= 0, own, peak[group[kept]])
    rows = np.where(own >= 0, nearest[kept], row[group[kept]])
    head = None if probability is None else _around(probability, peaks, rows, u[kept], axis)
    snr_db = lines.level_db[kept] + power_to_db(array.channels / noise[kept])
    centre_mps = np.asarray(velocity, dtype=np.float64)[peaks, rows]
    return Detections(
        range_m=lines.place[kept] * waveform.range_step_m,
        u=u[kept],
        velocity=centre_mps + shift[kept] * waveform.velocity_step_mps,
        amplitude_db=lines.level_db[kept],
        u_std=u_std[kept],
        probability=line_probability(snr_db, head),
        range_std=np.where(np.isnan(offset_std[kept]), UNIFORM, offset_std[kept]) * waveform.range_step_m,
        velocity_std=shift_std[kept] * waveform.velocity_step_mps,
        moving=np.full(len(kept), np.nan),
        doppler_cell=(lines.cell[kept] + waveform.chirps // 2) % waveform.chirps,
        snr_db=snr_db,
    )


def line_probability(snr_db: NDArray[np.float64], head: NDArray[np.floating] | None) -> NDArray[np.float64]:
    """P [N] that an echo stands at lines of L = ``snr_db`` [N], h = ``head`` [N]; None without a detection head.

    A line that passed the test for noise may still be none: the flank of a neighbour, a ghost of a board's
    errors, an echo of unlike ways out and back, which no one angle explains. How often that is so falls with the line's
    level L over the noise that the fit is told [dB], all channels added, and where a network has a detection head with
    the logit of what that says at the line:

        P = 1 / (1 + exp(-(a + b L + c logit h)))

    (Platt, "Probabilistic outputs for support vector machines", 1999: the head's own h is the share of pixels that hold
    a peak of the truth, which few do). a, b and c are near what fits the lines of simulated drives through two cities
    best, of which the paths are known; ``python tests/benchmarks/driven_points.py`` prints those of one drive:
    docs/notes/points.md. Limit: lines of a board's phase noise are told from echoes by neither level nor head.
    """
    a, b, c = BY_LEVEL if head is None else BY_HEAD
    said = 0.0 if head is None else logit(np.clip(head, LEAST_HEAD, 1.0 - LEAST_HEAD))
    return np.asarray(expit(a + b * np.minimum(snr_db, HIGHEST_DB) + c * said))


def with_moving(found: Detections, motion: EgoMotion | None, radar: Radar) -> Detections:
    """The detections with ``moving`` by the sensor's motion; as they are where it, or their velocity, is not known."""
    if motion is None or radar.waveform.chirps == 1:
        return found
    seen = found.range_m, found.u, found.velocity, found.u_std, found.velocity_std
    return replace(found, moving=moving_probability(motion, radar, *seen))


def _heard(
    snapshots: NDArray[np.complexfloating], new: NDArray[np.bool_], array: LineArray, least: float
) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.float64]]:
    """(peaks [n], rows [n]) of the cells in which an angle takes more than ``least`` [W], and what it takes [n] [W]."""
    peak, row = np.nonzero(new)
    cells = np.asarray(snapshots, dtype=np.complex128)[peak, row]
    most = beside_lines(cells, array, uniform_axis(array, SEARCH_POINTS), np.empty((len(cells), 0)))[0].max(axis=1)
    heard = most > least
    return peak[heard], row[heard], most[heard]


def _centres(
    peak: NDArray[np.intp], row: NDArray[np.intp], energy: NDArray[np.float64], cells: NDArray[np.int64]
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """(peaks, rows) of the cells about which groups are made, in their order.

    The strongest is one; the next strongest is one if it is no neighbour of a stronger one in range; and so on.

    :param peak, row: [n] of the cells that were heard; :param energy: [n] what their best angle takes [W]
    :param cells: [D, R] the Doppler cell of each peak
    """
    places, taken = _place(cells[peak, row], row).tolist(), set[int]()
    kept = []
    for index in np.argsort(-energy, kind="stable").tolist():
        if places[index] not in taken:
            kept.append(index)
            taken |= {places[index] - 1, places[index] + 1}
    kept.sort()
    return peak[kept], row[kept]


def _place(cell: NDArray[np.int64], row: NDArray[np.integer]) -> NDArray[np.int64]:
    """A number for each Doppler cell and range bin; that of the next bin is one more."""
    return cell * MOST_BINS + row


def _migration(cell: NDArray[np.int64], waveform: Waveform) -> NDArray[np.float64]:
    """[n] range bins through which an echo migrates in the frame, at most: v T over a bin is d B / f_c in cell d.

    The velocity may be folded once, unless the echo would migrate by more than MOST_MIGRATION then.
    """
    bins_a_cell = waveform.bandwidth_hz / waveform.carrier_hz
    own, folded = np.abs(cell) * bins_a_cell, (waveform.chirps - np.abs(cell)) * bins_a_cell
    return np.where(folded <= MOST_MIGRATION, folded, np.minimum(own, MOST_MIGRATION))


def _peak_in(
    cells: NDArray[np.int64], new: NDArray[np.bool_], cell: NDArray[np.int64], row: NDArray[np.intp]
) -> NDArray[np.intp]:
    """[n] which peak of a range bin holds a Doppler cell, -1 where none does, or there is no such bin.

    :param cells: [D, R] the Doppler cell of each peak; :param new: [D, R] those that count; :param cell, row: [n]
    """
    there = np.clip(row, 0, cells.shape[1] - 1)
    same = (cells[:, there] == cell) & new[:, there] & (there == row)
    return np.where(same.any(axis=0), same.argmax(axis=0), -1)


def _patterns(
    peak: NDArray[np.intp], row: NDArray[np.intp], cells: NDArray[np.int64], new: NDArray[np.bool_]
) -> Iterator[tuple[dict[int, NDArray[np.intp]], NDArray[np.intp]]]:
    """By which neighbouring bins hold a centre's Doppler cell too: ({bins from it: [n] peaks}, [n] the centres)."""
    beside = {step: _peak_in(cells, new, cells[peak, row], row + step) for step in (-1, 1)}
    for left in (False, True):
        for right in (False, True):
            members = np.flatnonzero(((beside[-1] >= 0) == left) & ((beside[1] >= 0) == right))
            if len(members):
                steps = [-1] * left + [0] + [1] * right
                yield {step: beside[step][members] if step else peak[members] for step in steps}, members


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
