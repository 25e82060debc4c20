"""``trainer calibrate``: the channels of a board from captures of a reflector whose place is known.

The chirps of a capture are averaged, as the reflector stands still, and multiplied by the conjugate of its echo by
eq. (1) and (2): exact round trips, so that the reflector may stand near. What is left is the response of each channel
over the sweep (:mod:`trainer.captures.calibration`), times one amplitude and one delay for all, plus other echoes at
other beat frequencies. Under a Hann window w over the sweep

    F_c(nu) = sum_n w_n z_c(n) exp(-j 2 pi nu (n / N - 1/2)) / sum_n w_n

is largest where nu is B times the delay, and its value there is gain and phase: least squares of one complex tone under
these weights. Common to all channels is the delay by which the stated range is off. Of several captures the factors
F_kc = a_k h_c are fitted together, the best matrix of rank one (Eckart and Young, Psychometrika 1, 1936).

What is left of a capture after calibration is the power that one echo from its place does not explain,

    1 - |mean_c F_c|^2 / mean_c |F_c|^2.

Errors. Noise of power 1/S of the echo in a cell of both captures leaves (1 - 1/C) (1/S_1 + 1/S_2). An angle that is
stated wrong by e when calibrating turns all later images by -e; stated wrong for the check it is model error there,
which is why the best angle nearby is told too. One capture fits itself; it says nothing about what another leaves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from shared.dataset.writing import require_new_file
from shared.physics.errors import InputError
from shared.physics.units import amplitude_to_db, db_to_power, power_to_db
from shared.processes.declared import taking
from shared.radar import Radar
from shared.signal.signal import if_signal_of_delays, round_trip_delays
from shared.signal.windows import hann_envelope_db, unit_hann
from trainer.captures.calibration import Calibration, Reflector, write_calibration
from trainer.captures.importing import RawCapture, read_capture
from trainer.captures.options import CalibrateOptions
from trainer.captures.samples import without_echo

SEARCH_BINS = 3.0
"""A reflector stands that near to its stated range: tapes err by centimetres, boards add some of their own."""
SEARCHED = np.arange(-SEARCH_BINS, SEARCH_BINS + 0.05, 0.1)
"""The range bins, from the stated one, at which it is looked for first."""
CLEAR_DB = 15.0
"""A reflector stands that much above the median of the range profile, ..."""
SIDELOBE_MARGIN_DB = 10.0
"""... and that much above the sidelobes of every other echo."""
LEAKAGE_BINS = 2
"""The nearest bins hold what leaks from TX to RX: the main lobe of a Hann window at range zero."""
MOVES_DB = -10.0
"""An echo that moves, of the reflector's power in its range bin: the chirps' mean is then no echo that stands still."""
DELAY_BINS, FINE_BINS = 0.6, 0.02
"""Channels differ by less than the first in delay; a parabola through points the second apart errs by 1e-5 bins."""
FARTHEST_M = 1e5
NEARBY_DEG, SCAN_DEG = 4.0, 0.05
"""Angles around the stated one where a check's best is sought."""
MIRRORED_DB = 6.0
"""A check that fits that much better on the other side has its sign of angle, or the board, the other way round."""
UNEXPLAINED_DB = -3.0
"""A check of which calibration explains less than half is one of another place or board."""


@dataclass(frozen=True)
class Place:
    """A capture and where its reflector stands.

    :param angle_deg: azimuth, positive to the left
    :param options: that state range and angle
    :raises InputError: numbers that are no place ahead
    """

    source: Path
    range_m: float
    angle_deg: float
    options: tuple[str, str] = ("--range", "--angle")

    def __post_init__(self) -> None:
        of_range, of_angle = self.options
        if not 0.0 < self.range_m <= FARTHEST_M:
            raise InputError(of_range, f"{self.range_m!r}", f"metres, more than 0 and at most {FARTHEST_M:g}")
        if not -90.0 < self.angle_deg < 90.0:
            raise InputError(of_angle, f"{self.angle_deg!r}", "degrees between -90 and 90")

    @property
    def position(self) -> NDArray[np.float64]:
        """[3] in the radar frame [m], at the radar's height."""
        return _position(self.range_m, self.angle_deg)


def _position(range_m: float, angle_deg: float) -> NDArray[np.float64]:
    angle = np.deg2rad(angle_deg)
    return range_m * np.array([np.cos(angle), np.sin(angle), 0.0])


@dataclass(frozen=True)
class Left:
    """Of a capture after calibration, relative to the reflector's power.

    :param stated_db: with the stated place
    :param best_db: at the angle nearby that leaves the least
    :param best_deg: that angle
    :param mirrored_db: at the angle with the other sign
    """

    stated_db: float
    best_db: float
    best_deg: float
    mirrored_db: float


@taking(CalibrateOptions)
def calibrate(asked: CalibrateOptions) -> Calibration:
    """Measure a board's channels and write them to ``out``, a TOML file, as ``trainer calibrate`` does.

    The residual of ``check`` becomes the model error; without it that of each capture after calibration with the
    others, where there are several.

    >>> calibrate("iwr1843", captures="corner.bin", ranges=5.02, angles=0.0, out="calibration.toml")  # doctest: +SKIP

    :raises InputError: a capture that cannot be read or without a reflector at the stated place
    """
    out, board, check = asked.out, asked.board, None
    stated = zip(asked.captures, asked.ranges, asked.angles, strict=True)
    places = [Place(Path(item), range_m, angle_deg) for item, range_m, angle_deg in stated]
    if asked.check is not None and asked.check_range is not None and asked.check_angle is not None:
        check = Place(asked.check, asked.check_range, asked.check_angle, ("--check-range", "--check-angle"))
    require_new_file(out, ".toml")
    captures, lines = list[RawCapture](), list[str]()
    for place in places:
        read = read_capture(place.source, asked)
        lines += [*read.notes, *_moving(read, place)]
        captures.append(_average(read))
        if captures[-1].radar != captures[0].radar:
            raise InputError(place.source, "other chirps than the first capture", "the same")
    calibration = _fit(captures, places, board)
    lines += [
        f"{place.source}: leaves {residual(capture, place, calibration).stated_db:.1f} dB (it was fitted to it)"
        for capture, place in zip(captures, places, strict=True)
    ]
    tried: list[tuple[RawCapture, Place, Calibration]] = []
    if check is not None:
        read = read_capture(check.source, asked)
        lines += [*read.notes, *_moving(read, check)]
        tried.append((read, check, calibration))
    elif len(places) > 1:
        for index, place in enumerate(places):
            others = [i for i in range(len(places)) if i != index]
            fitted = _fit([captures[i] for i in others], [places[i] for i in others], board)
            tried.append((captures[index], place, fitted))
    if tried:
        left = [residual(*one) for one in tried]
        for (_, place, _), one in zip(tried, left, strict=True):
            lines += _told(place, one)
        mean = float(power_to_db(np.mean(db_to_power([one.best_db for one in left]))))
        calibration = calibration.model_copy(update={"model_error_db": mean})
    else:
        lines.append("what another reflector leaves is not known: --check CAPTURE --check-range R --check-angle A")
    write_calibration(out, calibration)
    for line in (*_summary(out, calibration), *lines):
        asked.announce(line)
    return calibration


def _average(capture: RawCapture) -> RawCapture:
    """With the mean over all frames and chirps in place of them: [1, 1, sample, C]."""
    mean = capture.cube.mean(axis=(0, 1), dtype=np.complex128)[None, None]
    return replace(capture, cube=mean.astype(np.complex64))


def _moving(capture: RawCapture, place: Place) -> list[str]:
    """A line that warns of what moves in the reflector's range bin."""
    waveform = capture.radar.waveform
    chirp = _demodulated(_average(capture), place)
    at = np.array([SEARCHED[_searched(chirp).argmax()]])
    weights = _tone(len(chirp), at)[0, :, None] * _echo(capture.radar, place).conj()
    window = unit_hann(waveform.chirps)
    chirps = np.einsum("fmnc,nc->fmc", capture.cube, weights) * window[:, None]
    power = np.mean(np.abs(np.fft.fft(chirps, axis=1)) ** 2, axis=(0, 2))
    every_bin = np.fft.fft(unit_hann(len(chirp))[:, None] * capture.cube[0], axis=1)
    noise = np.sum(window**2) * np.median(np.mean(np.abs(every_bin) ** 2, axis=(0, 2)))
    beside = power[2:-1]  # of the main lobe of what stands still
    if not beside.size or beside.max() < float(db_to_power(CLEAR_DB)) * noise:
        return []
    cell = 2 + int(beside.argmax())
    level = float(power_to_db(power[cell] / max(float(power[0]), np.finfo(np.float64).tiny)))
    if level < MOVES_DB:
        return []
    slowest = (min(cell, waveform.chirps - cell) - 1) * waveform.velocity_step_mps  # the main lobe has three cells
    there = f"at {place.range_m:g} m something moves at {slowest:.2f} m/s or faster"
    return [f"warning: {place.source}: {there}, {level:+.0f} dB beside what stands still"]


def _fit(captures: Sequence[RawCapture], places: Sequence[Place], board: str) -> Calibration:
    responses = list(map(_response, captures, places))
    radar = captures[0].radar
    dead = _dead(captures, [factor for factor, _ in responses])
    alive = np.setdiff1d(np.arange(radar.array.channels), dead)
    if not len(alive):
        raise InputError(places[0].source, "no channel with an echo of the reflector", "one at least")
    for place, (_, at) in zip(places, responses, strict=True):
        if far := [str(channel) for channel in alive if np.isnan(at[channel])]:
            problem = f"channels {', '.join(far)} stand {DELAY_BINS:g} range bins or more off what they have in common"
            most_ps = 1e12 * DELAY_BINS / radar.waveform.bandwidth_hz
            raise InputError(place.source, problem, f"delays within {most_ps:.0f} ps, by a narrower sweep say")
    factors = np.array([factor[alive] for factor, _ in responses])
    channel = np.ones(radar.array.channels, np.complex128)
    channel[alive] = np.linalg.svd(factors, full_matrices=False)[2][0]
    phase = np.angle(np.vdot(channel[alive], factors[0]))  # of the singular vector it is arbitrary
    channel[alive] *= np.exp(1j * phase) / np.exp(np.mean(np.log(np.abs(channel[alive]))))
    bins = np.zeros(radar.array.channels)
    bins[alive] = np.mean([at[alive] - at[alive].mean() for _, at in responses], axis=0)
    waveform = radar.waveform
    return Calibration(
        board=board, array=radar.array, carrier_hz=waveform.carrier_hz, bandwidth_hz=waveform.bandwidth_hz,
        gain_db=tuple(amplitude_to_db(channel).tolist()), phase_deg=tuple(np.rad2deg(np.angle(channel)).tolist()),
        delay_s=tuple((bins / waveform.bandwidth_hz).tolist()), dead_channels=tuple(dead.tolist()),
        captures=tuple(
            Reflector(source=place.source.name, source_sha256=capture.sha256, range_m=place.range_m,
                      angle_deg=place.angle_deg)
            for capture, place in zip(captures, places, strict=True)
        ),
    )  # fmt: skip


def _dead(captures: Sequence[RawCapture], factors: Sequence[NDArray[np.complex128]]) -> NDArray[np.intp]:
    """Channels that had no echo in a capture, of the reflector or at all."""
    dead = {channel for capture in captures for channel in capture.dead}
    for factor in factors:
        dead |= set(np.flatnonzero(without_echo(amplitude_to_db(factor))).tolist())
    return np.array(sorted(dead), dtype=np.intp)


def _demodulated(capture: RawCapture, place: Place) -> NDArray[np.complex128]:
    """[sample, C] the averaged chirp times the conjugate of the reflector's echo."""
    return np.asarray(capture.cube[0, 0] * _echo(capture.radar, place).conj())


def _echo(radar: Radar, place: Place) -> NDArray[np.complex128]:
    """[sample, C] of the reflector in one chirp."""
    return np.asarray(if_signal_of_delays(radar.of_one_chirp, _delays(radar, place.position))[0])


def _delays(radar: Radar, position: NDArray[np.float64]) -> NDArray[np.float64]:
    """[C, 1] of an echo from a place that does not move [s]."""
    return np.asarray(round_trip_delays(radar.of_one_chirp, position, np.zeros(3)))


def _spectrum(chirp: NDArray[np.complex128], bins: NDArray[np.float64]) -> NDArray[np.complex128]:
    """[nu, C] F_c at ``bins`` [nu]."""
    return np.asarray(_tone(len(chirp), bins) @ chirp)


def _tone(samples: int, bins: NDArray[np.float64]) -> NDArray[np.complex128]:
    """[nu, sample] what the samples are multiplied by for F_c at ``bins`` [nu]."""
    turn = np.exp(-2j * np.pi * bins[:, None] * (np.arange(samples) / samples - 0.5))
    return np.asarray(turn * unit_hann(samples))


def _searched(chirp: NDArray[np.complex128]) -> NDArray[np.float64]:
    """[nu] power at :data:`SEARCHED`, mean of the channels."""
    return np.asarray(np.mean(np.abs(_spectrum(chirp, SEARCHED)) ** 2, axis=1))


def _standing_at(capture: RawCapture, place: Place, chirp: NDArray[np.complex128]) -> float:
    """The range bin, from the stated one, of the reflector in the averaged chirp [sample, C], see ``_demodulated``.

    :raises InputError: none there
    """
    power = _searched(chirp)
    peak = int(power.argmax())
    profile = np.mean(np.abs(np.fft.fft(unit_hann(len(chirp))[:, None] * chirp, axis=0)) ** 2, axis=1)
    level = float(power_to_db(power[peak] / max(float(np.median(profile)), np.finfo(np.float64).tiny)))
    step, bins = capture.radar.waveform.range_step_m, np.fft.fftfreq(len(chirp), 1.0 / len(chirp))
    away = bins - SEARCHED[peak]
    sidelobes = (power_to_db(profile) + hann_envelope_db(away) + SIDELOBE_MARGIN_DB)[np.abs(away) > 2.0]
    hidden = bool((sidelobes > float(power_to_db(power[peak]))).any())
    if peak in (0, len(SEARCHED) - 1) or level < CLEAR_DB or hidden:
        problem = f"no reflector within {SEARCH_BINS * step:.2g} m of {place.range_m:g} m"
        range_m = place.range_m + bins * step
        # Beyond leakage from TX to RX, and without the mirror image of real samples.
        ahead = (range_m >= LEAKAGE_BINS * step) & (range_m <= capture.radar.waveform.ranges_m[-1])
        told = f"the strongest echo of the capture stands at {range_m[np.where(ahead, profile, 0.0).argmax()]:.2f} m"
        expected = f"one {CLEAR_DB:g} dB above the median of the range profile and clear of others' sidelobes"
        raise InputError(place.source, f"{problem} ({told})", expected)
    return float(SEARCHED[peak])


def _response(capture: RawCapture, place: Place) -> tuple[NDArray[np.complex128], NDArray[np.float64]]:
    """([C] F_c of the channels at its best nu, [C] those nu in range bins; NaN at the ends of the search)."""
    chirp = _demodulated(capture, place)
    fine = _standing_at(capture, place, chirp) + np.arange(-DELAY_BINS, DELAY_BINS + 0.5 * FINE_BINS, FINE_BINS)
    values = np.abs(_spectrum(chirp, fine)) ** 2
    at = np.clip(values.argmax(axis=0), 1, len(fine) - 2)
    channels = np.arange(chirp.shape[1])
    below, here, above = (values[at + shift, channels] for shift in (-1, 0, 1))
    curvature = below - 2.0 * here + above
    moved = np.divide(0.5 * (below - above), curvature, out=np.zeros_like(here), where=curvature < 0.0)
    bins = fine[at] + FINE_BINS * np.clip(moved, -1.0, 1.0)
    inside = (values.argmax(axis=0) > 0) & (values.argmax(axis=0) < len(fine) - 1)
    return np.asarray(np.sum(_tone(len(chirp), bins).T * chirp, axis=0)), np.where(inside, bins, np.nan)


def residual(capture: RawCapture, place: Place, calibration: Calibration) -> Left:
    """What a capture leaves after calibration.

    :raises InputError: no reflector at the stated place
    """
    capture = _average(capture)
    calibrated = replace(capture, cube=calibration.applied(capture.cube, capture.radar))
    dead = sorted({*capture.dead, *calibration.dead_channels})
    alive = np.setdiff1d(np.arange(capture.radar.array.channels), dead)
    chirp = _demodulated(calibrated, place)[:, alive]
    factor = _spectrum(chirp, np.array([_standing_at(capture, place, chirp)]))[0]
    middle = capture.radar.waveform.mid_sweep_hz
    stated = _delays(capture.radar, place.position)[alive, 0]

    def left_at(angle_deg: float) -> float:
        delay = _delays(capture.radar, _position(place.range_m, angle_deg))[alive, 0]
        seen = factor * np.exp(-2j * np.pi * middle * (delay - stated))
        return float(power_to_db(max(1.0 - np.abs(seen.mean()) ** 2 / np.mean(np.abs(seen) ** 2), 1e-12)))

    scan = place.angle_deg + np.arange(-NEARBY_DEG, NEARBY_DEG + SCAN_DEG, SCAN_DEG)
    near = scan[np.argmin([left_at(angle) for angle in scan])]
    best = minimize_scalar(left_at, bounds=(near - SCAN_DEG, near + SCAN_DEG), method="bounded")
    return Left(left_at(place.angle_deg), float(best.fun), float(best.x), left_at(-place.angle_deg))


def _told(place: Place, left: Left) -> list[str]:
    lines = [
        f"{place.source}: leaves {left.stated_db:.1f} dB at {place.angle_deg:g} deg; at {left.best_deg:.2f} deg, where "
        f"it fits best, {left.best_db:.1f} dB"
    ]
    if left.mirrored_db < left.stated_db - MIRRORED_DB and left.mirrored_db < left.best_db - MIRRORED_DB:
        lines.append(f"warning: it leaves {left.mirrored_db:.1f} dB at {-place.angle_deg:g} deg: see --mirror")
    elif left.best_db > UNEXPLAINED_DB:
        lines.append("warning: that is most of its power; are angle and board right?")
    return lines


def _summary(out: Path, calibration: Calibration) -> list[str]:
    alive = np.setdiff1d(np.arange(calibration.array.channels), calibration.dead_channels)
    gain, phase, delay = (np.array(v)[alive] for v in (calibration.gain_db, calibration.phase_deg, calibration.delay_s))
    turned = np.angle(np.exp(1j * np.deg2rad(phase)) * np.conj(np.mean(np.exp(1j * np.deg2rad(phase)))))
    lines = [
        f"{len(alive)} channels in {out}: gain {gain.std():.2f} dB rms, phase {np.rad2deg(turned).std():.1f} deg rms, "
        f"delay {1e12 * delay.std():.1f} ps rms"
    ]
    if calibration.dead_channels:
        lines.append(f"dead channels: {', '.join(map(str, calibration.dead_channels))}")
    return lines
