"""The calibration file of the TI cascade's own scripts, ``calibrateResults*.mat`` (MMWCAS-RF-EVM, mmWave Studio).

A corner reflector far ahead, averaged over the chirps. ``calibResult`` has of each TX and RX, by the board's numbers,

- ``Rx_fft`` [bins, RX, TX]: FFT of the samples under a Hann window of unit mean square, padded to ``bins``;
- ``RangeMat`` [TX, RX]: the bin of the reflector's peak;
- ``PeakValMat`` [TX, RX]: the value there.

``params`` has the chirp's ``Slope_MHzperus`` and ``Sampling_Rate_sps``. The scripts (``calibrationCascade``) multiply
sample n of a capture by

    exp(-2 pi j d / bins * (f_c / f) (S / S_c) n) exp(-j arg(peak / peak_ref))

with d the bins from the reference channel's peak, S and f slope and sample rate of the capture, S_c and f_c those of
the file. Gains are left as they are. Limits: d is whole, so that a delay is known to half
a bin; the file does not say its carrier, nor the reflector's range, whose curved wave front these phases make flat:
the lines of a capture are then fitted with a curvature that is wrong by that of the reflector.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shared.physics.errors import InputError
from shared.physics.units import amplitude_to_db
from shared.radar import Radar, validated
from shared.radar.arrays import Position
from shared.radar.boards import mirrored, mmwcas
from trainer.captures.calibration import SAME_PLACE_M, Calibration
from trainer.captures.reading import read_arrays
from trainer.captures.samples import without_echo

SPECTRA, PEAKS, BINS = "calibResult/Rx_fft", "calibResult/PeakValMat", "calibResult/RangeMat"
SLOPE, SAMPLE_RATE = "params/Slope_MHzperus", "params/Sampling_Rate_sps"
BOARDS = ("mmwcas", "mmwcas-azimuth")
TX, RX = 12, 16
REFERENCE = (11, 0)
"""The last TX on the azimuth line, TX12, and RX1."""
SLOPES = (1.0, 300.0)
"""MHz/us that the devices can send."""
SAME_CHIRP = 1e-3
"""Slopes and sample rates that differ relatively by less are the same: registers round a slope to 0.05 MHz/us."""
NO_SAMPLE = 0.01
"""Of (pi / (N + 1))^4, the power that the window leaves of the last of N samples relative to the largest, with N the
number of bins, for there are no more samples: 1e-16 of 10 240. Double precision leaves 1e-30 behind the last one."""


@dataclass(frozen=True, eq=False)
class CascadeCalibration:
    """What the file holds.

    :param spectra: [bins, RX, TX] complex
    :param peaks: [TX, RX] complex
    :param bins: [TX, RX] of the peaks
    :param slope_hz_per_s, sample_rate_hz: of its chirp
    """

    path: Path
    spectra: NDArray[np.complexfloating]
    peaks: NDArray[np.complexfloating]
    bins: NDArray[np.float64]
    slope_hz_per_s: float
    sample_rate_hz: float

    def calibration(self, board: str, radar: Radar) -> Calibration:
        """What the scripts do to a capture of this radar, as gain, phase and delay of its channels.

        :raises InputError: another board or other elements than the cascade's, delays that no board has
        """
        tx, rx = self._elements(board, radar)
        waveform = radar.waveform
        relative = self.peaks / self.peaks[REFERENCE]
        delay = (self.bins - self.bins[REFERENCE]) / len(self.spectra) * self.sample_rate_hz / self.slope_hz_per_s
        # The peak's phase is that of sample 0, a calibration's that of the middle of the sweep.
        phase = np.rad2deg(np.angle(relative) + np.pi * waveform.bandwidth_hz * delay)
        level = amplitude_to_db(np.abs(self.peaks))
        dead = without_echo(level)[np.ix_(tx, rx)].T.reshape(-1)
        delays, phases = (np.where(dead, 0.0, each[np.ix_(tx, rx)].T.reshape(-1)) for each in (delay, phase))
        fields = {
            "board": board, "array": radar.array, "carrier_hz": waveform.carrier_hz,
            "bandwidth_hz": waveform.bandwidth_hz, "gain_db": (0.0,) * len(dead), "phase_deg": phases.tolist(),
            "delay_s": delays.tolist(), "dead_channels": np.flatnonzero(dead).tolist(), "captures": (),
        }  # fmt: skip
        return validated(Calibration, fields, self.path)

    def samples(self, board: str, radar: Radar) -> NDArray[np.complex64]:
        """[1, 1, sample, C] the mean chirp that the spectra are of.

        :raises InputError: another board or other elements, another chirp than the radar's
        """
        tx, rx = self._elements(board, radar)
        waveform = radar.waveform
        sent = {
            SLOPE: (1e-12 * self.slope_hz_per_s, 1e-12 * waveform.bandwidth_hz / waveform.chirp_duration_s),
            SAMPLE_RATE: (self.sample_rate_hz, waveform.samples / waveform.chirp_duration_s),
        }
        for name, (there, here) in sent.items():
            if abs(there - here) > SAME_CHIRP * here:
                raise InputError(self.path, f"{name} = {there:g}", f"{here:g}, as the capture's --radar has it")
        windowed = np.fft.ifft(self.spectra, axis=0)
        power = np.sum(np.abs(windowed) ** 2, axis=(1, 2))
        least = NO_SAMPLE * (np.pi / (len(windowed) + 1)) ** 4
        count = int(np.flatnonzero(power > least * power.max())[-1]) + 1
        if count != waveform.samples:
            raise InputError(self.path, f"{SPECTRA} is of {count} samples", f"{waveform.samples}, as --radar has it")
        # MATLAB's hanning, which has no 0 at its ends.
        window = 0.5 * (1.0 - np.cos(2.0 * np.pi * np.arange(1, count + 1) / (count + 1)))
        scale = window / np.sqrt(np.mean(window**2))
        chosen = windowed[:count][:, rx][:, :, tx].reshape(count, -1)
        return np.asarray((chosen / scale[:, None])[None, None].astype(np.complex64))

    def _elements(self, board: str, radar: Radar) -> tuple[list[int], list[int]]:
        """Indices of the radar's TX and RX among the board's."""
        if board not in BOARDS:
            problem = f"{PEAKS} is of the cascade's {TX} TX x {RX} RX"
            raise InputError(self.path, problem, f"a calibration of board {board!r}: trainer calibrate makes one")
        whole = mmwcas().array
        for array in (whole, mirrored(whole)):
            tx, rx = _indices(radar.array.tx_m, array.tx_m), _indices(radar.array.rx_m, array.rx_m)
            if tx is not None and rx is not None:
                return tx, rx
        problem = f"{PEAKS} is of the elements of {BOARDS[0]!r}"
        raise InputError(self.path, problem, "a --radar whose TX and RX are among them")


def read_cascade_calibration(path: Path, arrays: Mapping[str, NDArray[Any]] | None = None) -> CascadeCalibration:
    """The file of TI's scripts.

    :param arrays: of the file, where they have been read
    :raises InputError: a field that is missing, of another shape, or not finite
    """
    found = read_arrays(path) if arrays is None else arrays
    for name in (SPECTRA, PEAKS, BINS, SLOPE, SAMPLE_RATE):
        if name not in found:
            known = ", ".join(sorted(found)) or "no numbers"
            raise InputError(path, f"no {name} ({known})", "a calibrateResults*.mat of TI's cascade scripts")
        if not found[name].size or not np.isfinite(found[name]).all():
            raise InputError(path, f"{name} has values that are not finite, or none", "finite numbers")
    shapes = {SPECTRA: ("bins", RX, TX), PEAKS: (TX, RX), BINS: (TX, RX)}
    for name, shape in shapes.items():
        there = found[name].shape
        if len(there) != len(shape) or there[-2:] != shape[-2:]:
            expected = " x ".join(map(str, shape))
            raise InputError(path, f"{name} is {' x '.join(map(str, there))}", f"{expected}, of the four devices")
    slope, rate = (float(found[name].real.flat[0]) for name in (SLOPE, SAMPLE_RATE))
    if not SLOPES[0] <= slope <= SLOPES[1]:
        raise InputError(path, f"{SLOPE} = {slope:g}", f"MHz/us, {SLOPES[0]:g} to {SLOPES[1]:g}")
    if rate <= 0.0:
        raise InputError(path, f"{SAMPLE_RATE} = {rate:g}", "samples a second, more than 0")
    for name in (SPECTRA, PEAKS):
        if not found[name].any():
            raise InputError(path, f"{name} is 0 throughout", "the echo of a reflector")
    level = amplitude_to_db(np.abs(found[PEAKS]))
    if without_echo(level)[REFERENCE]:
        problem = f"{PEAKS} of the reference, TX{REFERENCE[0] + 1} and RX{REFERENCE[1] + 1}, has no echo"
        raise InputError(path, problem, "a calibration of a board whose TX12 and RX1 work")
    bins = found[BINS].real.astype(np.float64)
    return CascadeCalibration(path, found[SPECTRA], found[PEAKS], bins, 1e12 * slope, rate)


def _indices(positions: tuple[Position, ...], among: tuple[Position, ...]) -> list[int] | None:
    """Of the same places; None where one is not there."""
    apart = np.abs(np.array(positions)[:, None] - np.array(among)).max(axis=2)
    return apart.argmin(axis=1).tolist() if (apart.min(axis=1) < SAME_PLACE_M).all() else None
