"""What is common to all raw captures: 16-bit numbers of a file, its size, and the samples that they are.

A reader gives the samples of some frames in the order of its format; :func:`as_cube` brings them into
[frame, chirp, sample, C] with C rx-major, as everything here has them.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shared.physics.errors import InputError
from shared.physics.units import db_to_power
from shared.radar import Radar
from shared.radar.radar import LARGEST_ARRAY
from trainer.captures.options import Frames, Order

LARGEST_CUBE = 3 * LARGEST_ARRAY
"""Bytes of all frames together: what a .npz is read up to."""
DEAD_DB = 25.0
"""A channel that much weaker than the median channel has no echo: gains differ by a few dB."""
PACKET = struct.pack("<IIIH", 1, 1456, 0, 0)
"""The header of the first packet that a DCA1000 sends: its number, its length, and the bytes before it."""
EXPECTED_SAMPLES = "a capture, or other frames with --frames"
"""Where all are 0."""
NEAR_BINS, OTHER_SIDE_DB = 4, 10.0
"""TX leak into RX at a range of almost 0, in the first bins after bin 0. Where the last bins, which are those of
negative frequencies, hold that much more, I and Q are the other way round, or the bytes are something else."""
BESIDE_DB = 10.0
"""What leaks stands beside bin 0: where the very last bin holds that much less than another of the last ones, that one
holds an echo from the end of the range axis. Nothing tells an echo within the last two bins from the leak."""


@dataclass(frozen=True)
class Sizes:
    """Of a frame as it was recorded.

    :param lanes: RX in the file, where that is not the radar's number
    """

    chirps: int
    tx: int
    rx: int
    samples: int
    real: bool
    lanes: int | None = None

    @property
    def numbers(self) -> int:
        """16-bit numbers of a frame."""
        return self.chirps * self.tx * (self.lanes or self.rx) * self.samples * (1 if self.real else 2)

    def __str__(self) -> str:
        kind = "real" if self.real else "complex"
        lanes = f"{self.lanes} lanes" if self.lanes else f"{self.rx} RX"
        return f"{self.chirps} chirps x {self.tx} TX x {lanes} x {self.samples} {kind} samples"


def sizes_of(radar: Radar, real: bool, lanes: int | None = None) -> Sizes:
    """What a frame of the radar has."""
    array, waveform = radar.array, radar.waveform
    return Sizes(waveform.chirps, len(array.tx_m), len(array.rx_m), waveform.samples, real, lanes)


def frames_there(path: Path, sizes: Sizes, chosen: Frames | None = None) -> int:
    """Whole frames of a file of 16-bit numbers. It may end within another one where some are chosen.

    :raises InputError: no frame, or a part of one, with the sizes that would fit; packets with their headers
    """
    try:
        there = path.stat().st_size
        with path.open("rb") as handle:
            begin = handle.read(len(PACKET))
    except OSError as error:
        raise InputError(path, f"not readable: {error.strerror}", "a capture") from error
    if begin == PACKET:
        raise InputError(path, "holds the headers of its packets", "the adc_data.bin that mmWave Studio makes of it")
    frame = 2 * sizes.numbers
    count, rest = divmod(there, frame)
    if count and (not rest or chosen is not None):
        return count
    fitting = ", ".join(f"{n * frame}" for n in range(max(count, 1), max(count, 1) + 3))
    others = _that_fit(there, sizes)
    hint = f"; the file would fit {others}" if others and there else ""
    hint += f"; whole frames in it: {count} (--frames 0:{count})" if count else ""
    raise InputError(path, f"{there} bytes", f"a multiple of {frame} ({sizes}): {fitting}, ...{hint}")


def _that_fit(there: int, sizes: Sizes) -> str:
    """Other numbers of TX, RX or kinds of samples that make whole frames of the file, as text."""
    kinds = [(f"{tx} TX", replace(sizes, tx=tx)) for tx in range(1, 5) if tx != sizes.tx]
    if not sizes.lanes:
        kinds += [(f"{rx} RX", replace(sizes, rx=rx)) for rx in range(1, 5) if rx != sizes.rx]
    kinds.append(("complex samples" if sizes.real else "real samples", replace(sizes, real=not sizes.real)))
    return " or ".join(name for name, kind in kinds if there >= 2 * kind.numbers and there % (2 * kind.numbers) == 0)


def chosen_frames(path: Path, count: int, chosen: Frames | None, radar: Radar) -> range:
    """Frames ``chosen[0]`` to ``chosen[1] - 1`` of ``count``, all by default.

    :raises InputError: none of them there, or more than a cube may hold
    """
    begin, last = chosen or (0, None)
    end = count if last is None else last
    if not 0 <= begin < min(end, count):
        raise InputError(
            "--frames", f"{begin}:{'' if last is None else end} of {path}, which has {count}", f"a part of 0:{count}"
        )
    frames = range(begin, min(end, count))
    size = 8 * len(frames) * radar.waveform.chirps * radar.waveform.samples * radar.array.channels
    if size > LARGEST_CUBE:
        problem = f"{len(frames)} frames make a cube of {size / 1e9:.3g} GB"
        raise InputError(path, problem, f"at most {LARGEST_CUBE / 1e9:g} GB; choose some with --frames BEGIN:END")
    return frames


def read_numbers(path: Path, sizes: Sizes, frames: range) -> NDArray[np.int16]:
    """[frame, numbers] of these frames, little-endian.

    :raises InputError: not readable, or all zero
    """
    try:
        start, size = 2 * frames.start * sizes.numbers, len(frames) * sizes.numbers
        numbers = np.fromfile(path, dtype="<i2", count=size, offset=start)
    except OSError as error:
        raise InputError(path, f"not readable: {error.strerror or error}", "a capture") from error
    if not numbers.any():
        raise InputError(path, "all samples are 0", EXPECTED_SAMPLES)
    return numbers.reshape(len(frames), sizes.numbers)


def as_cube(numbers: NDArray[Any], axes: Sequence[str], order: Order | None) -> NDArray[np.complex64]:
    """[frame, chirp, sample, C] of real numbers with the axes "frame", "chirp", "tx", "rx", "sample" and "iq".

    The last is of length 2, or of length 1 where the samples are real. Twice a real sample A cos(phase) has
    A exp(j phase) in the positive half of its range spectrum; the other half is its mirror image, which the range bins
    of a radar of real samples leave out. After the Hann window of range the image leaks next to nothing into the half
    that is used: -58 dB of the strongest echo in a chirp of 32 samples, less in a longer one. The analytic signal by
    Hilbert's transform does without the image, but has no window where it cuts at 0 and the Nyquist frequency: it errs
    by -30 dB there, in bins 0, 1 and 15.
    """
    wanted = ("iq", "frame", "chirp", "sample", "rx", "tx")
    parts = numbers.transpose([list(axes).index(axis) for axis in wanted])
    if len(parts) == 1:
        samples = (2.0 * parts[0].astype(np.float32)).astype(np.complex64)
    else:
        samples = np.empty(parts.shape[1:], np.complex64)
        samples.real, samples.imag = parts[::-1] if order == "qi" else parts
    return np.ascontiguousarray(samples.reshape(*samples.shape[:3], -1))


def first_frame(cube: NDArray[np.complexfloating]) -> int:
    """The first frame of [frame, ...] that is not empty, of which noise, dead channels and I and Q are judged; 0 where
    all samples are 0. A recording may begin before its board does."""
    return next((frame for frame, samples in enumerate(cube) if samples.any()), 0)


def without_echo(level_db: NDArray[np.floating]) -> NDArray[np.bool_]:
    """Which of these channels are :data:`DEAD_DB` below the median one."""
    return np.asarray(level_db < np.median(level_db) - DEAD_DB)


def flatness_db(cube: NDArray[np.complex64]) -> float:
    """Geometric over arithmetic mean of the range profile's power without the samples' mean, of the first frame that is
    not empty [dB].

    0 for noise alone, and the lower the fewer range bins hold the power: samples that are put together in a wrong order
    spread every echo over more bins. In simulated scenes of 1 to 20 echoes at 10 to 40 dB SNR the wrong of "2-lane" and
    "4-lane" was always the flatter, by 1.2 to 25 dB; in OpenRadar's capture by 6 dB.
    """
    frame = cube[first_frame(cube)]
    power = _range_profile(frame - frame.mean(axis=1, keepdims=True)) + np.finfo(np.float64).tiny
    return float(10.0 * np.log10(np.exp(np.mean(np.log(power))) / power.mean()))


def other_side_db(cube: NDArray[np.complex64]) -> float:
    """Power of the last range bins over that of the first ones, of the first frame that is not empty [dB]: large where
    I and Q are the other way round; 0 where that is an echo from the end of the range axis."""
    power = _range_profile(cube[first_frame(cube)]) + np.finfo(np.float64).tiny
    if len(power) < 3:
        return 0.0
    bins = min(NEAR_BINS, (len(power) - 1) // 2)
    if power[-bins:].max() > power[-1] * db_to_power(BESIDE_DB):
        return 0.0
    return float(10.0 * np.log10(power[-bins:].sum() / power[1 : bins + 1].sum()))


def _range_profile(frame: NDArray[np.complex64]) -> NDArray[Any]:
    """[sample] mean power of the bins of a frame [chirp, sample, C]."""
    spectrum: NDArray[Any] = np.fft.fft(frame * np.hanning(frame.shape[1])[:, None], axis=1)
    return np.asarray(np.mean(np.abs(spectrum) ** 2, axis=(0, 2)))
