"""``trainer import``: the raw capture of a board to a cube with its radar."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from shared.dataset.locations import sha256_of
from shared.dataset.writing import require_new_file
from shared.physics.errors import InputError, require_utf8
from shared.physics.units import amplitude_to_db, dbm_to_watt, power_to_db
from shared.processes.declared import taking
from shared.radar import CaptureRadar, Radar, board_radar, load_capture_radar
from shared.radar.boards import BOARDS
from trainer.captures.array_files import read_array_capture
from trainer.captures.binary_files import (
    DEVICES,
    Lanes,
    cascade_files,
    read_cascade,
    read_dca1000,
    sizes_of_cascade,
    sizes_of_lanes,
)
from trainer.captures.calibration import Calibration, read_calibration
from trainer.captures.cascade_calibration import read_cascade_calibration
from trainer.captures.cube_file import Capture, Scale, measured_noise, require_moderate, write_cube
from trainer.captures.options import ImportOptions, Reading
from trainer.captures.reading import SUFFIXES, read_arrays
from trainer.captures.samples import (
    EXPECTED_SAMPLES,
    OTHER_SIDE_DB,
    Sizes,
    chosen_frames,
    first_frame,
    flatness_db,
    other_side_db,
    without_echo,
)

DOUBTFUL_LANES_DB, OTHER_LANES_DB = 1.0, 3.0
"""A file whose range profile is that much narrower as one of the other number of lanes may be, and is taken to be, of
another board."""
WORD_BITS = 16
"""Of the numbers of .bin files; a converter of fewer bits leaves the upper ones to the sign."""
LAYOUT_OF = {"iwr1443": "4-lane", "mmwcas": "cascade", "mmwcas-azimuth": "cascade"}
"""Of a board's .bin files; of the others "2-lane"."""


@dataclass(frozen=True, eq=False)
class RawCapture:
    """A capture as it was read, before calibration.

    :param cube: [frame, chirp, sample, C] complex64 [sqrt(W)], or counts
    :param sha256: of the files
    :param dead: channels without an echo
    :param notes: what a user should know, a line each
    """

    cube: NDArray[np.complex64]
    radar: Radar
    sha256: str
    scale: Scale
    dead: tuple[int, ...]
    notes: tuple[str, ...]


@taking(ImportOptions)
def import_capture(asked: ImportOptions) -> Capture:
    """Read a capture and write it to ``out``, in one step, as ``trainer import`` does.

    >>> import_capture("iwr1843", capture="adc_data.bin", out="cube.npz")  # doctest: +SKIP

    :returns: what the cube's file says of it (:mod:`trainer.captures.cube_file`)
    :raises InputError: a capture that does not fit board and chirps, a calibration of another board or waveform, an
        ``out`` that is no .npz or there already
    """
    source, out, calibration = asked.capture, asked.out, asked.calibration
    require_new_file(out, ".npz")
    found = None if calibration is None else _calibration(calibration, asked)
    raw = read_capture(source, asked)
    cube, dead = raw.cube, raw.dead
    if found is not None:
        cube, dead = found.applied(cube, raw.radar), tuple(sorted({*dead, *found.dead_channels}))
    noise_power = measured_noise(cube, raw.radar, dead)
    if not noise_power > 0.0:
        expected = "noise in more than half of the channels and cells, as a board records it"
        raise InputError(source, "noise of 0 beside samples that are not 0", expected)
    capture = Capture(
        source=source.name, source_sha256=raw.sha256, board=asked.board, frames=len(cube),
        scale=raw.scale, noise_power=noise_power,
        calibration=None if calibration is None else sha256_of(calibration),
        model_error_db=None if found is None else found.model_error_db, dead_channels=dead,
    )  # fmt: skip
    write_cube(out, cube, raw.radar, capture)
    for line in (*raw.notes, *_summary(out, cube, raw.radar, capture)):
        asked.announce(line)
    return capture


def _calibration(path: Path, reading: Reading) -> Calibration:
    """That of a file, for what is to be read."""
    radar = described(reading).radar
    if path.suffix == ".mat":
        return read_cascade_calibration(path).calibration(reading.board, radar)
    found = read_calibration(path)
    found.require_fits(str(path), reading.board, radar)
    return found


def read_capture(source: Path, reading: Reading) -> RawCapture:
    """The samples of a capture with the radar that they are of.

    A calibration file of TI's scripts is a capture too: the mean chirp of its reflector.

    :raises InputError: see :func:`import_capture`
    """
    require_utf8(source)
    of_board = described(reading)
    radar, notes = of_board.radar, list[str]()
    if source.suffix in SUFFIXES:
        if reading.layout is not None:
            raise InputError("--layout", f"{reading.layout!r} of {source}", "no --layout: it is of .bin files")
        arrays = read_arrays(source)
        if any(name.startswith("calibResult/") for name in arrays):  # of TI's scripts, whole or not
            of_arrays = (("--axes", reading.axes), ("--variable", reading.variable), ("--order", reading.order))
            for option, value in of_arrays:
                if value is not None:
                    problem, expected = f"{value!r} of {source}", f"no {option}: TI's file says how it is laid out"
                    raise InputError(option, problem, expected)
            chosen_frames(source, 1, reading.frames, radar)
            radar = radar.of_one_chirp
            cube = read_cascade_calibration(source, arrays).samples(reading.board, radar)
        else:
            cube, axes = read_array_capture(source, of_board, reading, arrays)
            notes.append(f"axes of {source}: {axes}")
        digest = sha256_of(source)
    else:
        cube, digest = _of_binary(source, reading, of_board, notes)
    begin, end = reading.frames or (0, None)
    if end is not None and len(cube) < end - begin:
        notes.append(f"frames {begin} to {begin + len(cube) - 1} of {source}, which has no more")
    if not cube.any():
        raise InputError(source, "all samples are 0", EXPECTED_SAMPLES)
    if empty := first_frame(cube):
        notes.append(f"empty frames first: {empty}; noise and dead channels are those of frame {empty}")
    if (excess := other_side_db(cube)) > OTHER_SIDE_DB:
        notes.append(
            f"warning: the last range bins hold {excess:.0f} dB more than the first: is --order or --layout another? "
            "An echo in the last two bins looks the same"
        )
    converter = radar.front_end.converter
    if converter is not None:
        full_scale = 2 ** (converter.bits - 1)
        parts = cube.view(np.float32)
        largest = max(float(parts.max()), -float(parts.min())) / (2.0 if of_board.real else 1.0)
        if converter.bits < WORD_BITS and largest > full_scale:
            expected = f"at most {full_scale} of front_end.converter.bits = {converter.bits}, or the bits of the file"
            raise InputError(source, f"samples of {largest:.0f} counts", expected)
        cube *= np.float32(np.sqrt(dbm_to_watt(converter.full_scale_dbm)) / full_scale)
    require_moderate(source, cube)
    scale: Scale = "relative" if converter is None else "sqrt(W)"
    return RawCapture(cube, radar, digest, scale, dead_channels(cube), tuple(notes))


def described(reading: Reading) -> CaptureRadar:
    """The radar of what is to be read.

    :raises InputError: a radar file that is not right
    """
    if reading.radar is None:
        return CaptureRadar(board_radar(reading.board, reading.mirror), bool(BOARDS[reading.board]().profile.real))
    return load_capture_radar(str(reading.radar), reading.board, reading.mirror)


def _of_binary(
    source: Path, reading: Reading, of_board: CaptureRadar, notes: list[str]
) -> tuple[NDArray[np.complex64], str]:
    """([frame, chirp, sample, C] counts, SHA-256) of .bin files."""
    layout = reading.layout or LAYOUT_OF.get(reading.board, "2-lane")
    if reading.axes is not None or reading.variable is not None:
        raise InputError("--axes or --variable", f"beside {source}", f"a file of arrays: {', '.join(SUFFIXES)}")
    if layout == "cascade":
        cube = read_cascade(source, of_board, reading)
        files, sizes = cascade_files(source), sizes_of_cascade(of_board.radar)
        notes += [said for file in files if (said := _cut_off(file, sizes))]
        digests = [sha256_of(file) for file in files]
        return cube, hashlib.sha256("".join(digests).encode()).hexdigest()
    if source.is_dir():
        expected = "a .bin file, or --board mmwcas or --layout cascade for the folder of a cascade"
        raise InputError("CAPTURE", f"{source}, a folder, beside board {reading.board} and layout {layout}", expected)
    if not source.is_file():
        names = f"a .bin of a DCA1000, {', '.join(SUFFIXES)}, or the folder of {' and '.join(DEVICES)} of a cascade"
        raise InputError("CAPTURE", f"{source}", names)
    lanes: Lanes = "4-lane" if layout == "4-lane" else "2-lane"
    if reading.order is None and of_board.quadrature_first is not None and not of_board.real:
        reading = replace(reading, order="qi" if of_board.quadrature_first else "iq")
        swap = f"SampleSwap = {of_board.quadrature_first:d} of adcbufCfg says"
        notes.append(f"order {reading.order}, as {swap}; --order goes before it")
    cube = read_dca1000(source, of_board, reading, lanes)
    notes += filter(None, [_cut_off(source, sizes_of_lanes(of_board, lanes))])
    if reading.layout is None and not of_board.real:
        notes += _other_lanes(source, reading, of_board, lanes, cube)
    return cube, sha256_of(source)


def _cut_off(file: Path, sizes: Sizes) -> str:
    """What to say of a file that ends within a frame; "" of one that does not."""
    rest = file.stat().st_size % (2 * sizes.numbers)
    return f"{file} ends within a frame: its last {rest} bytes are left out" if rest else ""


def _other_lanes(
    source: Path, reading: Reading, of_board: CaptureRadar, lanes: Lanes, cube: NDArray[np.complex64]
) -> list[str]:
    """A remark on a file that may be one of the other number of lanes.

    :raises InputError: one that is by all appearances
    """
    other: Lanes = "2-lane" if lanes == "4-lane" else "4-lane"
    numbers, of_other = (sizes_of_lanes(of_board, each).numbers for each in (lanes, other))
    if reading.frames is None and source.stat().st_size % (2 * of_other):
        return []
    # The frame that holds the first one that is not empty, or its begin.
    first = (first_frame(cube) + (reading.frames or (0,))[0]) * numbers // of_other
    try:
        turned = read_dca1000(source, of_board, replace(reading, frames=(first, first + 1)), other)
    except InputError:  # no whole one, or zeros alone
        return []
    narrower = flatness_db(cube) - flatness_db(turned)
    said = f"as {other} its range profile is {narrower:.1f} dB narrower than as {lanes}"
    if narrower > OTHER_LANES_DB:
        raise InputError(source, said, f"another board than {reading.board!r}, or --layout {lanes} if it is one")
    return [f"warning: {said}: is it of another board than {reading.board!r}?"] if narrower > DOUBTFUL_LANES_DB else []


def dead_channels(cube: NDArray[np.complex64]) -> tuple[int, ...]:
    """Channels of [frame, chirp, sample, C] without an echo: by the first frame that is not empty, its samples without
    their mean."""
    first = cube[first_frame(cube)].astype(np.complex128)  # single precision squares no more than 1e19
    first -= first.mean(axis=1, keepdims=True)
    level = power_to_db(np.mean(np.abs(first) ** 2, axis=(0, 1)))
    return tuple(np.flatnonzero(without_echo(level)).tolist())


def _summary(out: Path, cube: NDArray[np.complex64], radar: Radar, capture: Capture) -> list[str]:
    waveform, array = radar.waveform, radar.array
    strongest = float(amplitude_to_db(np.abs(cube).max()))
    velocities = f", velocities to {waveform.velocity_span_mps / 2.0:.2f} m/s" if waveform.tells_velocity else ""
    lines = [
        f"{capture.frames} frames of {waveform.chirps} chirps x {waveform.samples} samples x {array.channels} channels "
        f"({len(array.tx_m)} TX, {len(array.rx_m)} RX) in {out}",
        f"sampled sweep {waveform.carrier_hz / 1e9:.4f} to {(waveform.carrier_hz + waveform.bandwidth_hz) / 1e9:.4f} "
        f"GHz, range bins of {waveform.range_step_m:.4f} m{velocities}",
        f"scale {capture.scale}: largest sample {strongest:.1f} dB, noise {power_to_db(capture.noise_power):.1f} dB",
    ]
    if capture.dead_channels:
        lines.append(f"dead channels: {', '.join(map(str, capture.dead_channels))}")
    if capture.calibration is None:
        lines.append("not calibrated: trainer calibrate, then --calibration")
    elif capture.model_error_db is None:
        lines.append("calibrated; what it leaves of a reflector is not known: trainer calibrate --check")
    else:
        lines.append(f"calibrated; it leaves {capture.model_error_db:.1f} dB of a reflector")
    return lines
