"""Which cells of a truth's image are listed in ``targets``: maxima above the noise that nothing listed explains.

The image shows a point with a response that is known: a Hann window's over range, that of the elements' window over u.
Every echo has sidelobes at many places, local maxima as well. With A_j the stronger maxima, a maximum of magnitude a
stays where

    a^2 > M sum_j (A_j H(d_j) W(u_j))^2,

H and W the envelopes of both responses at the distances d_j [bins] and u_j; within both main lobes no maximum is one of
j's sidelobes. Powers add up, as phases do not agree; M allows for what few of them do (:data:`MARGIN`). A weak target
among the sidelobes of strong ones is not told apart from them.

The cell in which a listed target shows itself is left out: same place, same Doppler cell, and no stronger than its
echoes are together.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter

from shared.dataset import Frame, Target
from shared.physics.compiled import compiled
from shared.physics.units import amplitude_to_db, db_to_amplitude
from shared.physics.vectors import Index, Mask, Real
from shared.radar import Radar
from shared.signal.windows import angle_window, hann_envelope_db

CELL_SPAN_DB = 60.0
"""Truth cells further below the image's peak than this are not listed where no noise sets the limit."""
MARGIN = 4.0
"""In power: 6 dB."""
MAIN_LOBE_BINS = 1
"""Of range, on either side of a maximum."""
HANN_SIDELOBE_DB = -31.5
OWN_SHARE = 2.0
"""In power: so much stronger than a target's echoes added in phase may its cell be, beside what surrounds it."""


class Response(NamedTuple):
    """Envelopes of the truth's response to a point, as shares of its amplitude.

    :param over_range: [n] by distance in range bins; nothing beyond
    :param over_u: [U] by distance in angle bins
    :param lobe: angle bins of half the main lobe
    """

    over_range: Real
    over_u: Real
    lobe: int


class Maxima(NamedTuple):
    """N places of an image, the strongest first.

    :param row, column: [N] range and angle bin
    :param level: [N] magnitude [sqrt(W)]
    """

    row: Index
    column: Index
    level: Real

    def take(self, which: Index | Mask) -> Maxima:
        return Maxima(self.row[which], self.column[which], self.level[which])


def detected_cells(magnitude: NDArray[np.float32], noise_power: float) -> Maxima:
    """Local maxima of a truth image [R, U] [sqrt(W)] above the noise."""
    peak = float(magnitude.max())
    floor = max(float(np.sqrt(noise_power)), peak * float(db_to_amplitude(-CELL_SPAN_DB)))
    row, column = np.nonzero((magnitude == maximum_filter(magnitude, size=3)) & (magnitude > floor))
    level = magnitude[row, column].astype(np.float64)
    return Maxima(row, column, level).take(np.argsort(-level, kind="stable"))


def listed_cells(magnitude: NDArray[np.float32], frame: Frame, radar: Radar, window: str) -> list[Target]:
    """The detected cells that are targets of their own.

    :param magnitude: [R, U] of the truth [sqrt(W)]
    :param frame: with the targets that are listed before
    :param window: over the virtual sensor's elements, see :func:`shared.signal.windows.angle_window`
    """
    response, velocity = response_of(radar, window), frame.velocity[0].astype(np.float64)
    cells, known = detected_cells(magnitude, frame.noise_power), _of_targets(frame.targets, radar)
    doppler = radar.waveform.doppler_cells
    rate = doppler(np.array([target.velocity_mps for target in frame.targets]))
    share = np.zeros(len(cells.row))
    for target, cell in enumerate(rate):
        near = (np.abs(cells.row - known.row[target]) <= MAIN_LOBE_BINS) & (
            np.abs(cells.column - known.column[target]) <= response.lobe
        )
        share += known.level[target] * (near & (np.abs(doppler(velocity)[cells.row] - cell) <= 1))
    cells = cells.take(cells.level**2 > OWN_SHARE * share**2)
    row, column, level = (np.concatenate(pair) for pair in zip(known, cells, strict=True))
    both = Maxima(row, column, level)
    order = np.argsort(-both.level, kind="stable")
    stays = np.zeros(len(order), dtype=bool)
    stays[order] = _unexplained(*both.take(order), order < len(known.row), *response)
    cells = cells.take(stays[len(known.row) :])
    ranges, u = radar.waveform.ranges_m[cells.row], radar.grid.u[cells.column]
    values = zip(ranges, u, velocity[cells.row], amplitude_to_db(cells.level), strict=True)
    return [Target(float(r), float(at), float(v), float(a)) for r, at, v, a in values]


def _of_targets(targets: Sequence[Target], radar: Radar) -> Maxima:
    """Where an image shows them."""
    range_m, u, level_db = (
        np.array([getattr(target, name) for target in targets]) for name in ("range_m", "u", "amplitude_db")
    )
    row = np.rint(range_m / radar.waveform.range_step_m).astype(np.int64)
    column = np.rint((u - radar.grid.u_start) / radar.grid.step).astype(np.int64)
    return Maxima(row, column, db_to_amplitude(level_db))


@lru_cache(maxsize=4)
def response_of(radar: Radar, window: str) -> Response:
    """Of a radar's truth, over range to where it has fallen by :data:`CELL_SPAN_DB`."""
    away = np.arange(MAIN_LOBE_BINS + 1, 64)
    # A maximum stands at most half a bin off its place; a sidelobe is no stronger than the first.
    over_range = db_to_amplitude(np.minimum(hann_envelope_db(away - 0.5), HANN_SIDELOBE_DB))
    over_range = np.concatenate([np.ones(MAIN_LOBE_BINS + 1), over_range[over_range > db_to_amplitude(-CELL_SPAN_DB)]])
    sensor = radar.virtual_sensor
    weights, y = angle_window(window, sensor.channels), sensor.virtual[:, 1] / radar.waveform.wavelength_m
    turns = np.exp(-2j * np.pi * radar.grid.step * np.arange(radar.grid.bins)[:, None] * y)
    shape = np.abs(turns @ weights) / weights.sum()
    rises = np.flatnonzero(np.diff(shape) > 0.0)
    lobe = int(rises[0]) if len(rises) else len(shape) - 1
    envelope = np.maximum.accumulate(shape[::-1])[::-1].copy()
    envelope[: lobe + 1] = 1.0
    return Response(over_range, envelope, lobe)


@compiled()
def _unexplained(row, column, level, listed, over_range, over_u, lobe):
    """[N] which of the maxima, strongest first, are no sidelobes of stronger ones; all that are ``listed``."""
    count = len(row)
    stays = np.zeros(count, dtype=np.bool_)
    for i in range(count):
        explained = 0.0
        for j in range(i):
            far, aside = abs(row[i] - row[j]), abs(column[i] - column[j])
            if not stays[j] or far >= len(over_range) or aside >= len(over_u):
                continue
            if far > MAIN_LOBE_BINS or aside > lobe:
                explained += (level[j] * over_range[far] * over_u[aside]) ** 2
        stays[i] = listed[i] or level[i] ** 2 > MARGIN * explained
    return stays
