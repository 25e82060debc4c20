"""The velocity of fitted lines to a fraction of a Doppler cell.

A line is fitted to the cells of one Doppler cell, where its angle and range are told best. With A [M C, K] the
responses of a group's lines to unit amplitudes, the amplitudes in that cell and in its two neighbours are
s_i = A^+ x_i: one least squares for all three. Of a line delta Doppler cells from the centre they are

    s_i = s (-1)^i h(i - delta) + noise,    i = -1, 0, 1

with the response h of the Hann window. Its noise is correlated from cell to cell as the window makes it, R, and of
variance sigma^2 (A^H A)^-1_kk. With W = R^-1 the likeliest delta is where

    |h(delta)^T W s|^2 / h(delta)^T W h(delta)

is largest, and by the Cramer-Rao bound its variance is

    sigma^2 (A^H A)^-1_kk / (2 |s|^2 h'^T (W - W h h^T W / h^T W h) h')

(h' the derivative by delta).

**TX in turn.** The channels of a cell are turned back by its centre's frequency (:mod:`shared.signal.tdm`). A line
delta cells above it keeps 2 pi delta i / (N M) in those of TX i, with N TX and M chirps, which over the elements'
places p_c looks like an angle. By least squares over the channels u is too small by

    delta lambda / (N M) sum_c (p_c - p) i_c / sum_c (p_c - p)^2,    p = mean_c p_c

(:func:`lean`). It is put right by delta, and its deviation has that of delta in it.

Limits: the lines of a group are told apart by range and angle alone; what shares both and
differs in velocity by less than two cells is one line here. A velocity is constant for a frame. sigma^2 is the
receiver's noise alone: what the model leaves out of an echo is alike in its three cells.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from shared.radar import Radar
from shared.signal.signal import chirp_times
from shared.signal.windows import hann_correlation, hann_response, hann_slope
from trainer.estimators.array import LineArray
from trainer.estimators.fitting import (
    FittedLines,
    RangePlace,
    alternating,
    whitening,
)
from trainer.estimators.lines import RIDGE

CELLS = np.array([-1, 0, 1])
GRID = np.linspace(-1.0, 1.0, 81)
"""Of delta; the largest is placed by a parabola through three: within 1e-3 of a cell where noise is less than that."""
FARTHEST = 0.75
"""Cells: a line farther away has its peak in a neighbour, and this cell tells nothing of it."""
UNIFORM = float(np.sqrt(1.0 / 12.0))
"""Standard deviation of what may stand anywhere in a bin or a cell, of its width."""


def velocity_offsets(
    cells: NDArray[np.complexfloating],
    bins: NDArray[np.integer],
    array: LineArray,
    place: RangePlace,
    fitted: FittedLines,
    noise_power: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(delta [B, K] of the lines of B groups, its standard deviation [B, K]) [Doppler cells].

    Where the three cells do not show a peak, delta is 0 and the deviation that of a uniform cell; NaN where there is no
    line.

    :param cells: [3, B, M, C] of the Doppler cells below, at and above the groups' own [sqrt(W)], straightened for
        u = 0 as those of :func:`trainer.estimators.fitting.fit_groups`
    :param bins: [M], :param place: as there
    :param noise_power: of one channel and cell [W]
    """
    groups, lines = fitted.u.shape
    there = np.isfinite(fitted.u) & (np.abs(fitted.amplitude) > 0.0)
    white = whitening(bins)
    response = _responses(bins, array, place, fitted, there)
    columns = np.einsum("mn,bnck->bmck", white, response).reshape(groups, -1, lines)
    x = np.einsum("mn,ibnc->ibmc", white * alternating(bins), cells).reshape(3, groups, -1)
    adjoint = columns.conj().transpose(0, 2, 1)
    gram = adjoint @ columns
    diagonal = np.arange(lines)
    gram[:, diagonal, diagonal] += np.where(there, RIDGE * x.shape[2], 1.0)
    inverse = np.linalg.inv(gram)
    amplitude = np.einsum("bkl,bln,ibn->bki", inverse, adjoint, x, optimize=True)
    sigma2 = noise_power * inverse[:, diagonal, diagonal].real
    delta, deviation = np.full(there.shape, np.nan), np.full(there.shape, np.nan)
    delta[there], deviation[there] = _offsets(amplitude[there], sigma2[there])
    return delta, deviation


def lean(array: LineArray, radar: Radar) -> float:
    """By how much the u of a lone line seems too small for each Doppler cell that it stands above its own; 0 where all
    TX send at once, or nothing tells the angle. What tells no velocity is taken as at rest."""
    place = array.positions_m - array.positions_m.mean()
    if array.elements is None or not radar.waveform.tells_velocity or not place.any():
        return 0.0
    cycles = chirp_times(radar)[array.elements[0], 0] / (radar.waveform.chirps * radar.waveform.chirp_interval_s)
    return float(array.wavelength_m * (place @ cycles) / (place @ place))


def _responses(
    bins: NDArray[np.integer], array: LineArray, place: RangePlace, fitted: FittedLines, there: NDArray[np.bool_]
) -> NDArray[np.complex128]:
    """[B, M, C, K] h(i - r + w_c u) exp(-j k (p_c u + q_c u^2 / R)), see :mod:`trainer.estimators.groups`."""
    u, offset = np.where(there, fitted.u, 0.0)[:, None], np.where(there, fitted.offset, 0.0)[:, None]
    bend = array.bend_phase(place.centre_m)[..., None]
    phase = 2.0 * np.pi / array.wavelength_m * array.positions_m[:, None] * u + bend * u**2
    turn = np.exp(-1j * phase) * there[:, None]
    walked = place.walk(array)[:, None] * u - offset
    return hann_response(bins[:, None, None] + walked[:, None]) * turn[:, None]


def _offsets(
    amplitude: NDArray[np.complex128], sigma2: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(delta [N], its deviation [N]) of amplitudes [N, 3] and the variance [N] of their noise."""
    weight = np.linalg.inv(hann_correlation(CELLS[:, None] - CELLS))
    s = amplitude * alternating(CELLS)
    shape = hann_response(CELLS - GRID[:, None])
    against = s @ (shape @ weight).T
    power = np.abs(against) ** 2 / np.einsum("gi,ij,gj->g", shape, weight, shape)
    best = np.clip(power.argmax(axis=1), 1, len(GRID) - 2)
    row = np.arange(len(s))
    left, middle, right = (power[row, best + step] for step in (-1, 0, 1))
    bend = 2.0 * middle - left - right
    shift = np.clip(0.5 * (right - left) / np.where(bend > 0.0, bend, np.inf), -0.5, 0.5)
    delta = GRID[best] + shift * (GRID[1] - GRID[0])
    away = CELLS - delta[:, None]
    h, slope = hann_response(away), -hann_slope(away)
    level, lean = np.einsum("ni,ij,nj->n", h, weight, h), np.einsum("ni,ij,nj->n", h, weight, slope)
    power2 = np.abs(np.einsum("ni,ij,nj->n", h, weight, s) / level) ** 2
    told = 2.0 * power2 * (np.einsum("ni,ij,nj->n", slope, weight, slope) - lean**2 / level)
    deviation = np.sqrt(sigma2 / np.maximum(told, 1e-300))
    peaked = (np.abs(delta) <= FARTHEST) & (deviation < UNIFORM)
    return np.where(peaked, delta, 0.0), np.where(peaked, deviation, UNIFORM)
