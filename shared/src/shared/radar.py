"""A radar: waveform, array, front end and image grid; its presets, its TOML file and its metadata."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, ValidationError, model_validator

from shared.antenna import Pattern, car_radar_pattern
from shared.arrays import AntennaArray, avr_qdm_110, virtual_sensor_256
from shared.errors import InputError
from shared.units import BOLTZMANN, REFERENCE_TEMPERATURE, db_to_power, dbm_to_watt
from shared.waveform import Waveform


class FrontEnd(BaseModel):
    """Transmit power, noise figure and element patterns.

    :param transmit_power_dbm: power of one TX [dBm]
    :param noise_figure_db: receiver noise figure F [dB] at 290 K
    :param tx_pattern: pattern of every TX element
    :param rx_pattern: pattern of every RX element
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    transmit_power_dbm: FiniteFloat = 10.0
    noise_figure_db: Annotated[FiniteFloat, Field(ge=0)] = 12.0
    tx_pattern: Pattern = Field(default_factory=car_radar_pattern)
    rx_pattern: Pattern = Field(default_factory=car_radar_pattern)

    @property
    def transmit_power_w(self) -> float:
        return dbm_to_watt(self.transmit_power_dbm)


class ImageGrid(BaseModel):
    """The angle axis of range-angle images: ``u_j = u_start + j (u_stop - u_start) / bins``.

    :param u_start: first u = sin(azimuth)
    :param u_stop: end of the axis, not on the grid
    :param bins: number of angle bins
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    u_start: Annotated[FiniteFloat, Field(ge=-1, lt=1)] = -0.85
    u_stop: Annotated[FiniteFloat, Field(gt=-1, le=1)] = 0.85
    bins: Annotated[int, Field(ge=1)] = 450

    @model_validator(mode="after")
    def _rising(self) -> ImageGrid:
        if self.u_stop <= self.u_start:
            raise ValueError(f"u_stop = {self.u_stop!r}; expected more than u_start = {self.u_start!r}")
        return self

    @property
    def step(self) -> float:
        return (self.u_stop - self.u_start) / self.bins

    @property
    def u(self) -> NDArray[np.float64]:
        """[bins] rising u = sin(azimuth)."""
        return self.u_start + self.step * np.arange(self.bins, dtype=np.float64)


class Radar(BaseModel):
    """Everything about the sensor; frozen, and written into what is made with it.

    :param name: preset name or the TOML file's own
    :param virtual_sensor: the truth's array, at the same origin
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: str = "custom"
    waveform: Waveform = Field(default_factory=Waveform)
    array: AntennaArray = Field(default_factory=avr_qdm_110)
    front_end: FrontEnd = Field(default_factory=FrontEnd)
    grid: ImageGrid = Field(default_factory=ImageGrid)
    virtual_sensor: AntennaArray = Field(default_factory=lambda data: virtual_sensor_256(data["waveform"].carrier_hz))

    @property
    def sample_noise_power_w(self) -> float:
        """Receiver noise in one complex sample, k T0 F f_s [W]."""
        noise_factor = float(db_to_power(self.front_end.noise_figure_db))
        return BOLTZMANN * REFERENCE_TEMPERATURE * noise_factor * self.waveform.sample_rate_hz

    def metadata(self) -> dict[str, Any]:
        """Radar, array and axes as plain JSON values, for the Parquet schema and the manifest."""
        waveform, grid = self.waveform, self.grid
        velocities = waveform.velocities_mps
        return {
            "radar": {
                "name": self.name,
                **waveform.model_dump(),
                "slope_hz_per_s": waveform.slope_hz_per_s,
                "sample_rate_hz": waveform.sample_rate_hz,
                "wavelength_m": waveform.wavelength_m,
                "range_window": "hann",
                "doppler_window": "hann",
                **self.front_end.model_dump(),
            },
            "array": {**_positions(self.array), "order": "rx-major"},
            "virtual_sensor": {**_positions(self.virtual_sensor), "order": "rx-major"},
            "axes": {
                "range_m": {"start": 0.0, "step": waveform.range_step_m, "bins": waveform.range_bins},
                "u": {"start": grid.u_start, "step": grid.step, "bins": grid.bins},
                "velocity_mps": {
                    "start": float(velocities[0]),
                    "stop": float(velocities[0]) + waveform.velocity_step_mps * waveform.chirps,
                    "step": waveform.velocity_step_mps,
                    "bins": waveform.chirps,
                },
            },
        }


def _positions(array: AntennaArray) -> dict[str, list[list[float]]]:
    return {"tx_m": [list(position) for position in array.tx_m], "rx_m": [list(position) for position in array.rx_m]}


def _virtual_preset() -> Radar:
    waveform = Waveform()
    return Radar(name="avr-qdm-110-virtual", waveform=waveform, array=virtual_sensor_256(waveform.carrier_hz))


PRESETS = {"avr-qdm-110": lambda: Radar(name="avr-qdm-110"), "avr-qdm-110-virtual": _virtual_preset}
"""The paper's sensor and its enhanced virtual twin, by the name that ``--radar`` takes."""

DEFAULT_RADAR = "avr-qdm-110"


def load_radar(name_or_path: str) -> Radar:
    """A preset by name, or a TOML file with the tables ``waveform``, ``array``, ``front_end``, ``grid``.

    The file states only what differs from the default radar.

    :raises InputError: an unknown name, an unreadable file, a field or value that the radar does not allow
    """
    if name_or_path in PRESETS:
        return PRESETS[name_or_path]()
    path = Path(name_or_path)
    if not path.is_file():
        raise InputError("--radar", f"no preset and no file {name_or_path!r}", f"a TOML file or one of {list(PRESETS)}")
    try:
        document = tomllib.loads(path.read_text(encoding="utf-8"))
        return Radar.model_validate({"name": path.stem, **document})
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, OSError) as error:
        raise InputError(path, f"not readable as TOML: {error}", "a TOML file in UTF-8") from error
    except ValidationError as error:
        raise InputError(path, *first_validation_error(error)) from error


def first_validation_error(error: ValidationError) -> tuple[str, str]:
    """The first fault of a pydantic validation as (field and value, what would be right)."""
    fault = error.errors()[0]
    field = ".".join(str(part) for part in fault["loc"]) or "document"
    if fault["type"] == "extra_forbidden":
        return f"unknown field {field}", "a field of this table; see the documentation"
    if fault["type"] == "value_error":
        return f"{field}: {fault['ctx']['error']}", ""
    return f"{field} = {fault['input']!r}", fault["msg"][0].lower() + fault["msg"][1:]
