"""What a frame is made with, decided from its own paths.

Which of its candidates a radar would not notice says :mod:`datafactory.paths.notice`. Of the effects of the signal one
is a decision: without Doppler one chirp stands for all. It is off where nothing moves, or where in no resolution cell
the paths' powers, each times the square of what its motion changes (:func:`doppler_change`), exceed the
frame's limit together. Range migration and motion within the chirp come with it; leaving them, the near field or the
patterns out saves nothing. Where the radar sends one chirp, motion within it is all that there is of motion, and
decides (:func:`intra_chirp_change`).

A decision is a function of the frame's own paths, the radar and the budget. It knows nothing of other frames, so that a
frame is the same rendered alone, by any worker, or from stored paths.

How much a frame would change without an effect of the signal follows path by path. Every figure is an amplitude ratio:
the change of an echo's response over the response's peak. A path's power times the square of its change is summed in
the truth's resolution cells, without phase, and the strongest cell is held against the strongest cell of everything.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from datafactory.paths.candidates import PANE, TARGET_SEEN
from datafactory.paths.cells import cell_map
from datafactory.paths.notice import Notice, strongest
from datafactory.paths.table import CORNER, DIFFRACTED, DIFFUSE, REFRACTED, SPECULAR, TARGET, PathTable
from shared.physics.vectors import Real, lengths
from shared.radar import Radar
from shared.radar.arrays import AntennaArray
from shared.radar.waveform import Waveform
from shared.signal.windows import unit_hann

POINTS = 64
"""Samples of the windows in these integrals; their spectra are a few bins wide."""
PADDING = 16
BLOCK = 8192
"""Paths at a time whose phases at every channel are held in memory."""


def doppler_change(radial_mps: Real, waveform: Waveform) -> Real:
    """[K] change of the range-Doppler response when an echo of this range rate stands still.

    max over the Doppler axis of |W(nu - f) - W(nu)|, W the Hann window's spectrum, f the Doppler shift in bins.
    """
    bins = np.abs(radial_mps) / waveform.velocity_step_mps
    return _shift_change(bins)


def intra_chirp_change(radial_mps: Real, waveform: Waveform) -> Real:
    """[K] change of the range response when an echo stands still within each chirp.

    Its Doppler shift moves it by 2 v T_c / lambda range bins.
    """
    bins = 2.0 * np.abs(radial_mps) * waveform.chirp_duration_s / waveform.wavelength_m
    return _shift_change(bins)


def migration_change(radial_mps: Real, waveform: Waveform) -> Real:
    """[K] change of the range-Doppler response when an echo keeps its range of mid-frame.

    max over both axes of |sum w w exp(j 2 pi (eta y + nu x)) (exp(j 2 pi m eta nu) - 1)|, m the bins it crosses.
    """
    crossed = np.abs(radial_mps) * waveform.chirps * waveform.chirp_interval_s / waveform.range_step_m
    grid, values = _migration_table()
    return np.interp(crossed, grid, values)


def plane_wave_change(paths: PathTable, array: AntennaArray, wavelength_m: float) -> Real:
    """[K] change of the array's image when waves are plane over it, a phase common to all channels taken out.

    With d_c the channels' phase errors, min over phi of rms |1 - exp(j (d_c - phi))| = sqrt(2 - 2 |mean exp(j d_c)|),
    which bounds the change of the beamformer's output (Cauchy and Schwarz).
    """
    tx, rx = array.tx[array.channel_tx], array.rx[array.channel_rx]
    found, specular = [], paths.specular
    for first in range(0, len(paths.scattered), BLOCK):
        some = paths.scattered.take(np.arange(first, min(first + BLOCK, len(paths.scattered))))
        found.append(_of_errors(_curvature(some.tx_point, tx) + _curvature(some.rx_point, rx), wavelength_m))
    # A mirror shows the TX's image; seen from it an RX stands displaced by both their places.
    displaced = rx - np.einsum("kij,cj->kci", specular.axes, tx)
    return np.concatenate([*found, _of_errors(_curvature(specular.image, displaced), wavelength_m)])


def _of_errors(error_m: Real, wavelength_m: float) -> Real:
    """[K] of :func:`plane_wave_change`, of the channels' errors in length [K, C] [m]."""
    coherence = np.abs(np.mean(np.exp(2j * np.pi * error_m / wavelength_m), axis=1))
    change: Real = np.sqrt(np.maximum(2.0 - 2.0 * coherence, 0.0))
    return change


def _curvature(point: Real, elements: Real) -> Real:
    """[K, C] spherical less plane wave's length [m] from points [K, 3] to elements [C, 3] or [K, C, 3]."""
    distance = np.maximum(lengths(point), 1e-9)[:, None]
    spherical = lengths(point[:, None] - elements)
    return spherical - (distance - np.sum(point[:, None] * elements, axis=2) / distance)


def range_rates_mps(paths: PathTable, waveform: Waveform) -> Real:
    """[K] magnitude of the range rates seen from the origin: the larger of the means over both halves of the frame.

    Twice its product with half a frame's time is the most that the round trip differs from that of mid-frame at the
    frame's edges: an echo that passes abeam, whose rate is zero for a moment, is not at rest.
    """
    half_s = 0.5 * waveform.chirps * waveform.chirp_interval_s
    ranges = np.stack([paths.at_rest(time_s).range_m() for time_s in (0.0, half_s, 2.0 * half_s)])
    return np.abs(np.diff(ranges, axis=0)).max(axis=0, initial=0.0) / half_s


def pattern_change(paths: PathTable, radar: Radar) -> Real:
    """[K] change of an illuminated echo's amplitude when every direction gets boresight's gain, over the amplitude."""
    front_end = radar.front_end
    departure = np.concatenate([paths.scattered.tx_point, paths.specular.departure()])
    ahead = np.array([1.0, 0.0, 0.0])
    gain = front_end.tx_pattern.power_gain(departure) * front_end.rx_pattern.power_gain(paths.arrival())
    boresight = float(front_end.tx_pattern.power_gain(ahead) * front_end.rx_pattern.power_gain(ahead))
    return np.abs(np.sqrt(boresight / np.maximum(gain, 1e-30 * boresight)) - 1.0)


def _shift_change(bins: Real) -> Real:
    grid, values = _shift_table()
    return np.interp(bins, grid, values)


@lru_cache(maxsize=1)
def _shift_table() -> tuple[Real, Real]:
    place = (np.arange(POINTS) - POINTS / 2) / POINTS
    window = unit_hann(POINTS)
    grid = np.concatenate([[0.0], np.geomspace(1e-4, 3.0, 200)])
    moved = window * (np.exp(2j * np.pi * grid[:, None] * place) - 1.0)
    return grid, np.abs(np.fft.fft(moved, PADDING * POINTS, axis=1)).max(axis=1)


@lru_cache(maxsize=1)
def _migration_table() -> tuple[Real, Real]:
    place = (np.arange(POINTS) - POINTS / 2) / POINTS
    window = unit_hann(POINTS)
    weight = np.outer(window, window)
    grid = np.concatenate([[0.0], np.geomspace(1e-3, 8.0, 60)])
    values = [
        np.abs(np.fft.fft2(weight * (np.exp(2j * np.pi * crossed * np.outer(place, place)) - 1.0), (256, 256))).max()
        for crossed in grid
    ]
    return grid, np.array(values)


@dataclass(frozen=True, eq=False)
class Decided:
    """What a frame's radar would notice.

    :param limit_w: power that may be left out of a resolution cell [W]
    :param worth: [N] of the table's candidates, those that are followed
    """

    limit_w: float
    worth: NDArray[np.bool_]

    @staticmethod
    def of(table: PathTable, notice: Notice) -> Decided:
        """:param table: as traced, at the radar's wavelength"""
        limit = notice.limit_w(table)
        return Decided(limit, notice.worth(table.candidates, limit))

    def kept(self, table: PathTable) -> PathTable:
        """The table without the paths that are not followed, of a frame traced for this radar those beyond panes."""
        panes = bool(self.worth[table.candidates.family == PANE].any())
        seen = table.candidates.family == TARGET_SEEN

        def kept(candidate: NDArray[np.int32], kinds: NDArray[np.uint8]) -> NDArray[np.bool_]:
            followed = np.append(self.worth, True)[candidate]  # -1, of what is always there, is the last
            followed |= np.append(seen, False)[candidate] & (kinds & DIFFRACTED == 0)  # point targets in plain sight
            return followed if panes else followed & (kinds & REFRACTED == 0)

        scattered, specular = table.scattered, table.specular
        return table.take(kept(scattered.candidate, scattered.kinds), kept(specular.candidate, specular.kinds))


def doppler_called_for(paths: PathTable, radar: Radar, truth_window: str, limit_w: float) -> bool:
    """Whether a frame's illuminated paths may not stand still: where nothing may be left out, if anything moves.

    :param limit_w: power that may be left out of a resolution cell [W]
    """
    if not paths.moves():
        return False
    if limit_w == 0.0:
        return True
    change = doppler_change if radar.waveform.chirps > 1 else intra_chirp_change
    for some in (strongest(paths), paths):  # a few are enough in most frames that move
        share = change(range_rates_mps(some, radar.waveform), radar.waveform) ** 2
        if cell_map(some, radar, truth_window).sums(share).max(initial=0.0) > limit_w:
            return True
    return False


def bounces_more_than_once(paths: PathTable) -> NDArray[np.bool_]:
    """[K] whether a path has two or more bounces; diffraction at an edge does not count as one, and the bounces in a
    right-angled corner are an effect of their own.
    """
    return np.asarray((paths.every("depth") > 1) & (paths.every("kinds") & (DIFFRACTED | CORNER) == 0))


KINDS = {
    "specular": SPECULAR,
    "diffuse": DIFFUSE,
    "refraction": REFRACTED,
    "diffraction": DIFFRACTED,
    "corners": CORNER,
    "rcs_targets": TARGET,
}
"""Effects that a path shows by its kinds."""


def path_effects(paths: PathTable) -> dict[str, bool]:
    """Effects on paths that a frame has: whether any path in it is of that kind."""
    there = int(np.bitwise_or.reduce(paths.every("kinds"), initial=0))
    found = {name: bool(there & kind) for name, kind in KINDS.items()}
    return {**found, "multi_bounce": bool(bounces_more_than_once(paths).any())}
