"""From the cube to the range-channel matrix: the paper's section II-C, with the Doppler choice made explicit."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.fft
from jaxtyping import Complex, Float, Float32, Float64, Int, Int64

from shared.physics.units import db_to_amplitude
from shared.radar import Radar
from shared.radar.waveform import Waveform
from shared.signal.tdm import compensated, most_coherent, phasors, turns
from shared.signal.windows import unit_hann

RAYLEIGH_MEAN = 0.886
"""Mean magnitude of complex noise of unit power, sqrt(pi) / 2."""
RAYLEIGH_DEVIATION = 0.463
"""Standard deviation of that magnitude, sqrt(1 - pi / 4)."""
DETECTION_DEVIATIONS = 6.0
"""A second or third Doppler peak stands this many deviations of the channel mean above the noise."""
PEAK_SPAN_DB = 80.0
"""... and at most this far below the strongest of its range bin."""


@dataclass(frozen=True)
class DopplerSelection:
    """The D strongest Doppler peaks of every range bin.

    :param cells: [D, R] Doppler indices on the rising velocity axis
    :param range_channel: [D, R, C] complex64 values there, all channels, [sqrt(W)]
    :param magnitude: [R, chirps] mean magnitude over channels, the map that the choice was made on [sqrt(W)]
    :param interval: [D, R] widths of the Doppler axis to add to the velocities of the cells, see :func:`unfold`
    """

    cells: Int64[np.ndarray, "peaks rows"]
    range_channel: Complex[np.ndarray, "peaks rows channels"]
    magnitude: Float32[np.ndarray, "rows chirps"]
    interval: Int64[np.ndarray, "peaks rows"]

    def velocities_mps(self, waveform: Waveform) -> Float64[np.ndarray, "peaks rows"]:
        """[D, R] velocity of each peak [m/s], positive is receding."""
        return waveform.velocities_mps[self.cells] + waveform.velocity_span_mps * self.interval


def range_doppler(
    cube: Complex[np.ndarray, "chirps samples channels"], radar: Radar
) -> Complex[np.ndarray, "rows chirps channels"]:
    """[R, chirps, C] range-Doppler spectra of a cube [chirps, samples, C], velocity rising.

    Hann windows in range and Doppler; each FFT is divided by its window's sum, so that an on-grid target reads |A|. Of
    TX that take turns the channels are turned back to TX 0 (:func:`shared.signal.tdm.compensated`).
    """
    waveform = radar.waveform
    expected = (waveform.chirps, waveform.samples)
    if cube.ndim != 3 or cube.shape[:2] != expected:
        raise ValueError(f"cube of shape {cube.shape}; expected [chirp, sample, channel] = {expected} + (channels,)")
    # Chirp by chirp, then range by range: what is worked on stays in the cache.
    weights = unit_hann(waveform.samples).astype(np.float32)[:, None]
    slow_weights = unit_hann(waveform.chirps).astype(np.float32)
    rows = waveform.range_bins
    spectrum = np.empty((rows, waveform.chirps, cube.shape[2]), dtype=np.result_type(cube, np.complex64))
    for chirp, (samples, weight) in enumerate(zip(cube, slow_weights, strict=True)):
        over_range = scipy.fft.fft(samples * weights, axis=0, overwrite_x=True)[:rows]
        np.multiply(over_range, weight, out=spectrum[:, chirp])
    half = (waveform.chirps + 1) // 2
    for row in spectrum:
        over_doppler = scipy.fft.fft(row, axis=0)
        row[waveform.chirps - half :], row[: waveform.chirps - half] = over_doppler[:half], over_doppler[half:]
    return compensated(spectrum, radar)


def strongest_doppler(level: Float[np.ndarray, "rows chirps"]) -> Int64[np.ndarray, " rows"]:
    """[R] the Doppler cell of the highest of levels [R, chirps]; of two chirps, whose cells are alike because the Hann
    window leaves one of them, that at rest."""
    chirps = level.shape[1]
    return level.argmax(axis=1) if chirps != 2 else np.full(len(level), chirps // 2)


def select_doppler(
    spectra: Complex[np.ndarray, "rows chirps channels"], noise_power: float, peaks: int = 3
) -> DopplerSelection:
    """The D = ``peaks`` strongest Doppler cells of every range bin of ``spectra`` [R, chirps, C].

    The first is the maximum of the mean magnitude over channels. The others are local maxima along (circular) Doppler,
    strongest first, with a mean magnitude of at least (0.886 + 6 * 0.463 / sqrt(C)) sqrt(noise_power) and of at least
    the first - 80 dB; where there are fewer, the first again. Noise alone has many local maxima: hence the threshold.
    The skirt of a strong line has none: hence local maxima rather than the next strongest cells.
    """
    _, chirps, channels = spectra.shape
    magnitude = np.abs(spectra).mean(axis=2)
    first = strongest_doppler(magnitude)
    strongest = np.take_along_axis(magnitude, first[:, None], axis=1)
    threshold = (RAYLEIGH_MEAN + DETECTION_DEVIATIONS * RAYLEIGH_DEVIATION / np.sqrt(channels)) * np.sqrt(noise_power)
    candidate = (magnitude > np.roll(magnitude, 1, axis=1)) & (magnitude >= np.roll(magnitude, -1, axis=1))
    least = np.maximum(threshold, strongest * float(db_to_amplitude(-PEAK_SPAN_DB)))
    candidate &= (magnitude >= least) & (magnitude > 0)
    np.put_along_axis(candidate, first[:, None], False, axis=1)
    ranked = np.argsort(np.where(candidate, -magnitude, np.inf), axis=1, kind="stable")
    cells = np.repeat(first[None], peaks, axis=0)
    for peak in range(1, min(peaks, chirps + 1)):
        following = ranked[:, peak - 1]
        exists = np.take_along_axis(candidate, following[:, None], axis=1)[:, 0]
        cells[peak] = np.where(exists, following, first)
    return selection_at(spectra, cells, magnitude)


def selection_at(
    spectra: Complex[np.ndarray, "rows chirps channels"],
    cells: Int[np.ndarray, "peaks rows"] | Int[np.ndarray, " rows"],
    magnitude: Float[np.ndarray, "rows chirps"] | None = None,
) -> DopplerSelection:
    """The values of ``spectra`` [R, chirps, C] in given Doppler cells.

    :param cells: [D, R] or, for one of every range bin, [R]
    :param magnitude: [R, chirps] mean over the channels, where it is known already
    """
    cells = np.atleast_2d(cells).astype(np.int64)
    if magnitude is None:
        magnitude = np.abs(spectra).mean(axis=2)
    return DopplerSelection(
        cells=cells,
        range_channel=np.ascontiguousarray(spectra[np.arange(len(spectra))[None, :], cells]),
        magnitude=magnitude.astype(np.float32),
        interval=np.zeros_like(cells),
    )


def unfold(selection: DopplerSelection, radar: Radar) -> DopplerSelection:
    """The selection turned to the velocity interval of each peak, as far as a TDM radar's coinciding elements tell it.

    Velocities lie within :attr:`shared.radar.Radar.velocity_intervals` intervals around 0. Of intervals that the
    channels do not tell apart the one of least velocity is taken. Zeros have interval 0, as all have where all TX send
    at once. See :mod:`shared.signal.tdm`.
    """
    turn, known, chirps = turns(radar), radar.velocity_intervals, radar.waveform.chirps
    if not turn.any():
        return selection
    interval = most_coherent(selection.range_channel, radar) if known > 1 else np.zeros_like(selection.cells)
    cycles = (selection.cells - chirps // 2) / chirps
    interval -= known * np.floor((cycles + interval) / known + 0.5).astype(np.int64)
    rows = np.arange(len(selection.magnitude))
    below, above = (selection.magnitude[rows, (selection.cells + step) % chirps] for step in (-1, 1))
    interval += known * ((cycles + interval == -0.5 * known) & (below > above))
    turned = selection.range_channel * phasors(interval[..., None] * turn, selection.range_channel)
    return replace(selection, range_channel=turned, interval=interval)


def doppler_neighbours(
    spectra: Complex[np.ndarray, "rows chirps channels"], selection: DopplerSelection, radar: Radar
) -> Complex[np.ndarray, "2 peaks rows channels"]:
    """The cells below and above each one of a selection, TX turned back as in the cell itself. The axis is a circle.

    An echo that stands between cells shows in several of them, and has one velocity.

    :param spectra: those that the selection was made from
    """
    turn, chirps = turns(radar), radar.waveform.chirps
    cells = np.stack([(selection.cells + step) % chirps for step in (-1, 1)])
    values = spectra[np.arange(len(spectra)), cells]
    if not turn.any():
        return values
    own = (selection.cells + chirps * selection.interval).astype(np.float64)
    return values * phasors((own - cells)[..., None] / chirps * turn, values)
