"""Gain, phase and delay of each channel of a board: the file, and how it is applied.

A channel multiplies the echo by

    H_c(f) = g_c exp(j phi_c) exp(j 2 pi (f - f_ref) delta_c)

over the frequencies f that are swept: gain and phase at the reference frequency and a delay beside those of eq. (2). A
cube is calibrated by the division by H_c at the frequency of each sample. Only differences between channels are known:
the mean gain is 1, the mean delay 0.

Limits: H_c does not depend on the angle, so that coupling between elements and patterns that differ are not in it; what
they leave is the model error. It holds for the board, the order of TX and the sweep that it was measured with, or one
that overlaps it.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, FiniteFloat, model_validator

from shared.dataset.documents import sealed, unsealed
from shared.dataset.writing import write_text
from shared.physics.errors import InputError
from shared.physics.units import db_to_amplitude
from shared.radar import Radar, read_toml, validated
from shared.radar.arrays import AntennaArray
from shared.radar.validation import Described
from trainer.captures.cube_file import Sha256

SAME_PLACE_M = 1e-6


class Reflector(Described):
    """A capture of a reflector whose place is known.

    :param range_m: from the radar's origin
    :param angle_deg: azimuth, positive to the left
    """

    source: str
    source_sha256: Sha256
    range_m: Annotated[FiniteFloat, Field(gt=0, le=1e5)]
    angle_deg: Annotated[FiniteFloat, Field(ge=-90, le=90)]


class Calibration(Described):
    """What the channels of a board do to an echo.

    :param board: name, see :mod:`shared.radar.boards`
    :param array: elements in use, TX in the order they send
    :param carrier_hz: begin of the sweep that it was measured with
    :param bandwidth_hz: of that sweep; gain and phase are those of its middle
    :param gain_db, phase_deg, delay_s: [C]
    :param dead_channels: without an echo; their gain is 0 dB, their phase and delay 0
    :param model_error_db: power that another reflector leaves after calibration, relative to its power; None where none
        was tried
    :param captures: that it comes from
    """

    board: str
    array: AntennaArray
    carrier_hz: Annotated[FiniteFloat, Field(gt=0)]
    bandwidth_hz: Annotated[FiniteFloat, Field(gt=0)]
    gain_db: tuple[Annotated[FiniteFloat, Field(ge=-100, le=100)], ...]
    phase_deg: tuple[Annotated[FiniteFloat, Field(ge=-1e4, le=1e4)], ...]
    delay_s: tuple[Annotated[FiniteFloat, Field(ge=-1e-6, le=1e-6)], ...]
    dead_channels: tuple[Annotated[int, Field(ge=0)], ...] = ()
    model_error_db: FiniteFloat | None = None
    captures: tuple[Reflector, ...]

    @model_validator(mode="after")
    def _of_all_channels(self) -> Calibration:
        channels = self.array.channels
        for name in ("gain_db", "phase_deg", "delay_s"):
            if len(getattr(self, name)) != channels:
                raise ValueError(f"{name} has {len(getattr(self, name))} numbers; expected {channels}, one a channel")
        if any(channel >= channels for channel in self.dead_channels):
            raise ValueError(f"dead_channels = {list(self.dead_channels)}; expected channels below {channels}")
        return self

    def response(self, frequency_hz: NDArray[np.float64]) -> NDArray[np.complex128]:
        """[F, C] H_c at frequencies [F]."""
        factor = db_to_amplitude(np.array(self.gain_db)) * np.exp(1j * np.deg2rad(self.phase_deg))
        offset = frequency_hz - (self.carrier_hz + 0.5 * self.bandwidth_hz)
        return factor * np.exp(2j * np.pi * offset[:, None] * np.array(self.delay_s))

    def applied(self, cube: NDArray[np.complex64], radar: Radar) -> NDArray[np.complex64]:
        """A cube [..., sample, C] of this board, calibrated."""
        waveform = radar.waveform
        swept = waveform.carrier_hz + waveform.bandwidth_hz * np.arange(waveform.samples) / waveform.samples
        return np.asarray(cube * (1.0 / self.response(swept)).astype(np.complex64))

    def require_fits(self, path: str, board: str, radar: Radar) -> None:
        """Refuse a radar that this was not measured with.

        :raises InputError: another board, other elements or another order of TX, a sweep of other frequencies
        """
        if board != self.board:
            raise InputError(path, f"of board {self.board!r}", f"one of {board!r}")
        for end in ("tx", "rx"):
            here, there = getattr(radar.array, end), getattr(self.array, end)
            if here.shape != there.shape or np.abs(here - there).max() > SAME_PLACE_M:
                problem = f"its {len(there)} {end.upper()} are not the capture's {len(here)}, or in another order"
                raise InputError(path, problem, "a calibration with the chirps of this capture")
        begin, end_hz = radar.waveform.carrier_hz, radar.waveform.carrier_hz + radar.waveform.bandwidth_hz
        if not (begin < self.carrier_hz + self.bandwidth_hz and self.carrier_hz < end_hz):
            told = f"{self.carrier_hz / 1e9:.3f} to {(self.carrier_hz + self.bandwidth_hz) / 1e9:.3f} GHz"
            raise InputError(
                path, f"measured from {told}", f"the capture's {begin / 1e9:.3f} to {end_hz / 1e9:.3f} GHz"
            )


def write_calibration(path: Path, calibration: Calibration) -> None:
    """Write a TOML file, sealed with the SHA-256 of its entries, in one step."""
    entries = {name: value for name, value in calibration.model_dump(mode="json").items() if value is not None}
    write_text(path, to_toml(sealed(entries)))


def to_toml(document: Mapping[str, Any]) -> str:
    """A line for each entry of a document of plain JSON values."""
    return "".join(f"{name} = {_value(value)}\n" for name, value in document.items())


def _value(value: Any) -> str:
    """Numbers, strings and lists of them are written alike in JSON and TOML, but for U+007F, which TOML wants escaped;
    tables are not, on their own or listed."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{name} = {_value(inner)}" for name, inner in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(_value(inner) for inner in value) + "]"
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def read_calibration(path: Path) -> Calibration:
    """A file of :func:`write_calibration`.

    :raises InputError: missing, not TOML, changed since it was written, or not a calibration
    """
    expected = "a calibration of trainer calibrate"
    document = read_toml(path, expected)
    if missing := [
        name for name, field in Calibration.model_fields.items() if field.is_required() and name not in document
    ]:
        raise InputError(path, f"is no calibration, without {', '.join(missing)}", expected)
    try:
        return validated(Calibration, unsealed(path, document), path)
    except TypeError as error:  # a date, which TOML has and a document has not
        raise InputError(path, f"not readable: {error}", expected) from error
