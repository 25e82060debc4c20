"""Captures in .npy, .npz, .mat and HDF5 files: arrays whose axes are stated, or guessed by their lengths.

Axes are named as in ``"chirp (tx rx) sample"``: one word for each axis, and in brackets those that were joined to one,
the slowest first. The words are frame, chirp, tx, rx, sample, and iq for an axis of real and imaginary part. "tx" is
counted as the TX send. An axis of length 1 may be left out.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shared.physics.errors import InputError
from shared.radar import CaptureRadar, Radar
from shared.radar.boards import BOARDS
from trainer.captures.options import Reading
from trainer.captures.samples import as_cube, chosen_frames

NAMES = ("frame", "chirp", "tx", "rx", "sample", "iq")
GUESSES = (
    "(chirp tx) rx sample",
    "frame (chirp tx) rx sample",
    "chirp (tx rx) sample",
    "frame chirp (tx rx) sample",
    "chirp tx rx sample",
    "frame chirp tx rx sample",
    "chirp sample (rx tx)",
    "frame chirp sample (rx tx)",
)
"""Tried in this order: what OpenRadar's ``organize`` gives, the same after ``separate_tx``, and this project's own."""

Axes = tuple[tuple[str, ...], ...]


def parse_axes(text: str) -> Axes:
    """The words of each axis.

    :raises InputError: other words than :data:`NAMES`, one twice, brackets that do not match
    """
    groups = re.findall(r"\(([^()]*)\)|([^\s()]+)", text)
    axes = tuple(tuple((joined or single).split()) for joined, single in groups)
    words = [word for axis in axes for word in axis]
    rest = re.sub(r"\([^()]*\)|[^\s()]+", "", text)
    if rest.strip() or not words or set(words) - set(NAMES) or len(set(words)) != len(words) or not all(axes):
        problem = f"{text!r}"
        raise InputError("--axes", problem, f"words of {', '.join(NAMES)}, each once, as in 'chirp (tx rx) sample'")
    return axes


def read_array_capture(
    path: Path, of_board: CaptureRadar, reading: Reading, arrays: Mapping[str, NDArray[Any]]
) -> tuple[NDArray[np.complex64], str]:
    """([frame, chirp, sample, C] in the file's unit, the axes that were taken).

    Real arrays without an axis "iq" are real samples, and what is read must have them. Whole numbers from 0 to 65535 of
    which some are beyond 32767 are 16-bit numbers with a sign that was lost, as in a capture that was read as uint16.

    :param arrays: of the file
    :raises InputError: no array that fits the radar, several, real samples for complex ones or the other way round, or
        samples that are not finite
    """
    radar, axes, variable = of_board.radar, reading.axes, reading.variable
    arrays = {name: values for name, values in arrays.items() if values.dtype.kind in "iufc"}
    if variable is not None and variable not in arrays:
        raise InputError(path, f"no array {variable!r}", f"one of {sorted(arrays)}")
    candidates = arrays if variable is None else {variable: arrays[variable]}
    patterns = GUESSES if axes is None else (axes,)
    fitting = {
        name: (pattern, lengths)
        for name, values in candidates.items()
        for pattern in reversed(patterns)  # the first that fits remains
        if (lengths := _lengths(values, parse_axes(pattern), radar)) is not None
    }
    if len(fitting) != 1:
        found = ", ".join(f"{name} {list(values.shape)}" for name, values in candidates.items()) or "no arrays"
        raise InputError(path, f"{len(fitting)} arrays that fit, of {found}", _expected(radar, axes))
    ((name, (pattern, lengths)),) = fitting.items()
    words = [word for axis in parse_axes(pattern) for word in axis]
    values = candidates[name]
    if np.iscomplexobj(values):
        values, words = np.stack([values.real, values.imag], axis=-1), [*words, "iq"]
    if ("iq" in words) is of_board.real:
        here, there, right = "real", "complex", "complex numbers, an axis iq, or real = true under [capture]"
        if of_board.real:
            here, there, right = "complex", "real", "real numbers"
            right += "" if BOARDS[reading.board]().profile.real else ", or real = false under [capture]"
        raise InputError(path, f"{name} has {here} samples, radar {radar.name!r} {there} ones", right)
    words += [word for word in NAMES if word not in words]
    values = with_sign(values).reshape([lengths.get(word, 1) for word in words])
    chosen = chosen_frames(path, values.shape[words.index("frame")], reading.frames, radar)
    values = values.take(np.array(chosen), axis=words.index("frame"))
    if not np.isfinite(values).all():
        raise InputError(path, f"{name} has values that are not finite", "finite samples")
    return as_cube(values, words, reading.order), pattern


def with_sign(values: NDArray[Any]) -> NDArray[Any]:
    """16-bit numbers that were read without their sign, with it; others as they are.

    A wider whole number may hold what was read as uint16; one of 16 bits or fewer has its sign.
    """
    if not values.size or (values.dtype.kind == "i" and values.dtype.itemsize <= 2):
        return values
    lowest, highest = float(values.min()), float(values.max())
    if not (lowest >= 0.0 and 2**15 <= highest < 2**16) or (values != np.floor(values)).any():
        return values
    return values.astype(np.uint16).view(np.int16).astype(np.float32)


def _sizes(radar: Radar) -> dict[str, int]:
    array, waveform = radar.array, radar.waveform
    return {
        "chirp": waveform.chirps, "tx": len(array.tx_m), "rx": len(array.rx_m), "sample": waveform.samples, "iq": 2,
    }  # fmt: skip


def _lengths(values: NDArray[Any], axes: Axes, radar: Radar) -> dict[str, int] | None:
    """The length of each word where an array has these axes, and of "iq" where it is complex; else None."""
    sizes = _sizes(radar)
    words = {word for axis in axes for word in axis}
    if values.ndim != len(axes) or any(sizes[word] != 1 for word in NAMES[1:-1] if word not in words):
        return None
    if np.iscomplexobj(values):
        if "iq" in words:
            return None
        words |= {"iq"}
    lengths = {word: sizes[word] for word in words if word != "frame"}
    for length, axis in zip(values.shape, axes, strict=True):
        known = math.prod(lengths[word] for word in axis if word != "frame")
        if "frame" in axis and length and length % known == 0:
            lengths["frame"] = length // known
        elif length != known or "frame" in axis:
            return None
    return lengths


def _expected(radar: Radar, axes: str | None) -> str:
    sizes = _sizes(radar)
    told = ", ".join(f"{word} {sizes[word]}" for word in NAMES[1:-1])
    how = "--axes, e.g. 'chirp (tx rx) sample'" if axes is None else f"the axes {axes!r}"
    return f"one array of radar {radar.name!r} ({told}) with {how}; --variable chooses among several"
