"""Which cells of a truth's image are listed in ``targets``: maxima above the noise that nothing listed explains.

The image shows a point with a response that is known: a Hann window's over range, that of the elements' window over u,
and a Hann window's over Doppler, for a row shows one Doppler cell. Every echo has sidelobes at many places, local
maxima as well. With A_j the stronger maxima, a maximum of magnitude a stays where

    a^2 > M sum_j (A_j H(d_j) W(u_j) H(f_j))^2,

H and W the envelopes of the responses at the distances d_j [range bins], u_j and f_j [Doppler cells]; within both main
lobes of range and u no maximum is one of j's sidelobes. Powers add up, as phases do not agree; M allows for what few of
them do (:data:`MARGIN`). A weak target among the sidelobes of strong ones is not told apart from them.

The cell in which a listed target shows itself is left out: same place, same Doppler cell, and no stronger than its
echoes are together.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter

from shared.dataset import Frame, Target
from shared.physics.compiled import compiled
from shared.physics.units import amplitude_to_db, db_to_amplitude
from shared.physics.vectors import Index, Mask, Real
from shared.radar import Radar
from shared.signal.windows import angle_window, hann_envelope_db

if TYPE_CHECKING:
    from datafactory.frame.measurement import Processing

CELL_SPAN_DB = 60.0
"""Truth cells further below the image's peak than this are not listed where no noise sets the limit."""
MARGIN = 4.0
"""In power: n sidelobes of one strength make n times what their powers add up to where they are in phase; four may."""
MAIN_LOBE_BINS = 1
"""Of range and Doppler, on either side of a maximum."""
HANN_SIDELOBE_DB = -31.5
"""Of the window's first sidelobe."""
FINER = 8
"""How much finer than its bins the response over u is looked at."""
OWN_SHARE = 2.0
"""In power: so much stronger than a target's echoes added in phase may its cell be, beside what surrounds it."""


class Response(NamedTuple):
    """Envelopes of the truth's response to a point, as shares of its amplitude.

    :param over_bins: [n] by distance in range bins or Doppler cells; nothing beyond
    :param over_u: [U] by distance in angle bins
    :param lobe: angle bins of half the main lobe
    """

    over_bins: Real
    over_u: Real
    lobe: int


class Maxima(NamedTuple):
    """N places of an image.

    :param row, column: [N] range and angle bin
    :param cell: [N] Doppler cell
    :param level: [N] magnitude [sqrt(W)]
    """

    row: Index
    column: Index
    cell: Index
    level: Real

    def take(self, which: Index | Mask) -> Maxima:
        return Maxima(self.row[which], self.column[which], self.cell[which], self.level[which])


def detected_cells(magnitude: NDArray[np.float32], noise_power: float, cell_of_row: Index) -> Maxima:
    """Local maxima of a truth image [R, U] [sqrt(W)] above the noise.

    :param cell_of_row: [R] Doppler cell that each row shows
    """
    peak = float(magnitude.max())
    floor = max(float(np.sqrt(noise_power)), peak * float(db_to_amplitude(-CELL_SPAN_DB)))
    row, column = np.nonzero((magnitude == maximum_filter(magnitude, size=3)) & (magnitude > floor))
    return Maxima(row, column, cell_of_row[row], magnitude[row, column].astype(np.float64))


def listed_cells(magnitude: NDArray[np.float32], frame: Frame, radar: Radar, processing: Processing) -> list[Target]:
    """The detected cells that are targets of their own, the strongest first.

    :param magnitude: [R, U] of the truth [sqrt(W)]
    :param frame: with the targets that are listed before
    """
    response, velocity = response_of(radar, processing.truth_window), frame.velocity[0].astype(np.float64)
    cells = detected_cells(magnitude, frame.noise_power, radar.waveform.doppler_cells(velocity))
    known, chirps = _shown(frame, radar, processing), radar.waveform.chirps
    share = np.zeros(len(cells.row))
    for row, column, cell, level in zip(*known, strict=True):
        away = np.abs(cells.cell - cell)
        near = (np.abs(cells.row - row) <= MAIN_LOBE_BINS) & (np.abs(cells.column - column) <= response.lobe)
        share += level * (near & (np.minimum(away, chirps - away) <= MAIN_LOBE_BINS))
    cells = cells.take(cells.level**2 > OWN_SHARE * share**2)
    row, column, cell, level = (np.concatenate(pair) for pair in zip(known, cells, strict=True))
    order = np.argsort(-level, kind="stable")
    both, listed = Maxima(row, column, cell, level).take(order), order < len(known.row)
    stays = _unexplained(both, listed, response, chirps) & ~listed
    row, column, _, level = both.take(stays)
    values = zip(radar.waveform.ranges_m[row], radar.grid.u[column], velocity[row], amplitude_to_db(level), strict=True)
    return [Target(float(r), float(u), float(v), float(a)) for r, u, v, a in values]


def _shown(frame: Frame, radar: Radar, processing: Processing) -> Maxima:
    """Where an image shows the targets that are listed before.

    Motion within the chirp shows an echo 2 v T_c / lambda bins farther than it is. Without Doppler all stand still.
    """
    waveform, targets = radar.waveform, frame.targets
    range_m, u, velocity, level_db = (
        np.array([getattr(target, name) for target in targets], dtype=np.float64)
        for name in ("range_m", "u", "velocity_mps", "amplitude_db")
    )
    velocity = velocity if processing.doppler else np.zeros_like(velocity)
    bins = range_m / waveform.range_step_m
    if processing.intra_chirp_motion:
        bins += 2.0 * velocity * waveform.chirp_duration_s / waveform.wavelength_m
    row, column = np.rint(bins), np.rint((u - radar.grid.u_start) / radar.grid.step)
    cell = waveform.doppler_cells(velocity)
    return Maxima(row.astype(np.int64), column.astype(np.int64), cell, db_to_amplitude(level_db))


@lru_cache(maxsize=4)
def response_of(radar: Radar, window: str) -> Response:
    """Of a radar's truth, over range and Doppler to where it has fallen by :data:`CELL_SPAN_DB`.

    :param window: over the virtual sensor's elements, see :func:`shared.signal.windows.angle_window`
    """
    away = np.arange(MAIN_LOBE_BINS + 1, 64)
    # A maximum stands at most half a bin off its place; a sidelobe is no stronger than the first.
    over_bins = db_to_amplitude(np.minimum(hann_envelope_db(away - 0.5), HANN_SIDELOBE_DB))
    over_bins = np.concatenate([np.ones(MAIN_LOBE_BINS + 1), over_bins[over_bins > db_to_amplitude(-CELL_SPAN_DB)]])
    sensor, bins = radar.virtual_sensor, np.arange(radar.grid.bins)
    weights, y = angle_window(window, sensor.channels), sensor.virtual[:, 1] / radar.waveform.wavelength_m
    step = radar.grid.step / FINER
    shape = np.abs(np.exp(-2j * np.pi * step * np.arange(FINER * len(bins))[:, None] * y) @ weights) / weights.sum()
    rises = np.flatnonzero(np.diff(shape) > 0.0)
    lobe = int(rises[0] if len(rises) else len(shape) - 1) // FINER
    # Elements further apart than half a wavelength repeat it: a grating lobe is a main lobe.
    spacing = float(np.diff(np.unique(y)).max(initial=0.0))
    period = 1.0 / (spacing * radar.grid.step) if spacing > 0.0 else 2.0 * len(bins)
    near = np.abs(bins - period * np.rint(bins / period))
    # Half a bin nearer, as over range; a sidelobe or two beyond, so that the envelope's end does not stand in a null.
    shape = shape[: int(FINER * (near.max() + 2 * lobe + 1))]
    envelope = np.maximum.accumulate(shape[::-1])[::-1]
    over_u = envelope[np.maximum(FINER * (near - 0.5), 0.0).astype(np.int64)]
    return Response(over_bins, np.where(near <= lobe, 1.0, over_u), lobe)


@compiled()
def _unexplained(maxima, listed, response, chirps):
    """[N] which of the maxima, strongest first, are no sidelobes of stronger ones; all that are ``listed``."""
    row, column, cell, level = maxima
    over_bins, over_u, lobe = response
    count = len(row)
    stays = np.zeros(count, dtype=np.bool_)
    for i in range(count):
        explained = 0.0
        for j in range(i):
            far, aside, apart = abs(row[i] - row[j]), abs(column[i] - column[j]), abs(cell[i] - cell[j])
            apart = min(apart, chirps - apart)
            if not stays[j] or max(far, apart) >= len(over_bins) or aside >= len(over_u):
                continue
            if far > MAIN_LOBE_BINS or aside > lobe:
                explained += (level[j] * over_bins[far] * over_u[aside] * over_bins[apart]) ** 2
        stays[i] = listed[i] or level[i] ** 2 > MARGIN * explained
    return stays
