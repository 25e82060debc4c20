"""A radar: waveform, array, front end and image grid, and its metadata."""

from __future__ import annotations

import math
from typing import Annotated, Any

import numpy as np
from jaxtyping import Float64
from pydantic import BaseModel, Field, FiniteFloat, ValidationError, model_validator

from shared.physics.errors import Told
from shared.physics.units import BOLTZMANN, REFERENCE_TEMPERATURE, db_to_power
from shared.radar.antenna import PatchPattern
from shared.radar.arrays import AntennaArray, avr_qdm_110, virtual_sensor_256
from shared.radar.front_end import FrontEnd
from shared.radar.validation import Described
from shared.radar.waveform import Waveform

MIRROR_TOLERANCE = 1e-6
"""Of a bin, within which -u_j must meet the grid. A grid that is read back from a dataset has its end rounded to 12
digits, 1e-9 bins. An image folded at an axis 1e-6 bins off has phases wrong by 1.5e-6 rad at the outermost of 256
elements, -116 dB."""


WIDEST_STEP = 0.55
"""Wavelengths between neighbours of the virtual sensor: half of one, and as much as a sensor that was laid out for
another carrier of the band differs."""
MAXIMUM_RESIDUAL_PHASE_RAD = 0.3
"""The first order of exp(j x) that the phase noise's model keeps is then wrong by at most x^2 / 2, -27 dB."""
LARGEST_GB = 2
LARGEST_ARRAY = LARGEST_GB * 10**9
"""Bytes of a frame's cube, of its image and of the matrices that make them. The default radar's cube has 50 MB, that of
the virtual sensor 268 MB; a frame takes a few times its cube to make."""


class ImageGrid(Described):
    """The angle axis of range-angle images: ``u_j = u_start + j (u_stop - u_start) / bins``.

    :param u_start: first u = sin(azimuth)
    :param u_stop: end of the axis, not on the grid
    :param bins: number of angle bins
    """

    u_start: Annotated[FiniteFloat, Field(ge=-1, lt=1)] = -0.85
    u_stop: Annotated[FiniteFloat, Field(gt=-1, le=1)] = 0.85
    bins: Annotated[int, Field(ge=1, le=2**16)] = 450

    @model_validator(mode="after")
    def _rising(self) -> ImageGrid:
        if self.u_stop <= self.u_start:
            raise ValueError(f"u_stop = {self.u_stop!r}; expected more than u_start = {self.u_start!r}")
        return self

    @property
    def step(self) -> float:
        """From one bin to the next, in u."""
        return (self.u_stop - self.u_start) / self.bins

    @property
    def u(self) -> Float64[np.ndarray, " bins"]:
        """[bins] rising u = sin(azimuth)."""
        return self.u_start + self.step * np.arange(self.bins, dtype=np.float64)

    @property
    def mirror(self) -> int | None:
        """J such that bin J - j stands at -u_j; None where the bins have no mirror images among themselves."""
        place = -2.0 * self.u_start / self.step
        return round(place) if abs(place - round(place)) < MIRROR_TOLERANCE else None


def _virtual_sensor(fields: dict[str, Any]) -> AntennaArray:
    """That of the carrier, where no other is stated."""
    carrier_hz = fields["waveform"].carrier_hz
    try:
        return virtual_sensor_256(carrier_hz)
    except ValidationError:
        problem = (
            f"carrier_hz = {carrier_hz!r} makes the virtual_sensor of 256 elements, half a wavelength apart, more than "
            "2 m wide; expected Hz, at least 19.2e9, or a table virtual_sensor with positions of its own"
        )
        told = {"error": ValueError(problem)}
        fault: Any = {"type": "value_error", "loc": ("waveform", "carrier_hz"), "input": carrier_hz, "ctx": told}
        raise ValidationError.from_exception_data("Radar", [fault]) from None


class Radar(Told, BaseModel, frozen=True, extra="forbid"):
    """Everything about the sensor; frozen, and written into what is made with it.

    :param name: preset name or the TOML file's own
    :param waveform: the chirps
    :param array: the elements of the input
    :param front_end: powers, noise, patterns, polarisation, imperfections
    :param grid: the angle axis of images
    :param virtual_sensor: the truth's array, at the same origin
    :raises ValidationError: turns of TX that overlap, and what else these allow only together
    """

    name: str = "custom"
    waveform: Waveform = Field(default_factory=Waveform)
    array: AntennaArray = Field(default_factory=avr_qdm_110)
    front_end: FrontEnd = Field(default_factory=FrontEnd)
    grid: ImageGrid = Field(default_factory=ImageGrid)
    virtual_sensor: AntennaArray = Field(default_factory=_virtual_sensor)

    @model_validator(mode="after")
    def _of_bounded_size(self) -> Radar:
        waveform, bins = self.waveform, self.grid.bins
        channels, elements = self.array.channels, self.virtual_sensor.channels
        sizes = [
            (f"chirps = {waveform.chirps} x samples = {waveform.samples} x {channels} channels", "a cube",
             8 * waveform.chirps * waveform.samples * channels),
            (f"range_bins = {waveform.range_bins} x grid.bins = {bins}", "an image", 4 * waveform.range_bins * bins),
            (f"samples = {waveform.samples} x {elements} virtual elements", "a chirp of the virtual sensor",
             16 * waveform.samples * elements),
            (f"grid.bins = {bins} x {max(channels, elements)} elements", "a steering matrix",
             16 * bins * max(channels, elements)),
        ]  # fmt: skip
        if self.front_end.phase_noise is not None:
            correlation = f"samples = {waveform.samples}, squared, of front_end.phase_noise"
            sizes.append((correlation, "a range correlation", 8 * waveform.samples**2))
        for factors, what, size in sizes:
            if size > LARGEST_ARRAY:
                raise ValueError(f"{factors} make {what} of {size / 1e9:.3g} GB; expected at most {LARGEST_GB} GB")
        return self

    @model_validator(mode="after")
    def _allowed_together(self) -> Radar:
        waveform, tx_count = self.waveform, len(self.array.tx_m)
        turn = waveform.chirp_interval_s / tx_count
        # A part in 1e9: intervals written as a rounded multiple of the duration are meant to be that multiple.
        if waveform.multiplexing == "tdm" and turn < waveform.chirp_duration_s * (1.0 - 1e-9):
            raise ValueError(
                f"waveform.chirp_interval_s = {waveform.chirp_interval_s!r} leaves each of {tx_count} TX {turn:g} s; "
                f"expected at least {tx_count} x chirp_duration_s = {tx_count * waveform.chirp_duration_s:g} with tdm"
            )
        sensor = self.virtual_sensor
        if len(sensor.tx_m) != 1:
            raise ValueError(f"virtual_sensor.tx_m has {len(sensor.tx_m)} TX; expected 1, which lights the truth")
        steps = np.linalg.norm(np.diff(sensor.rx, axis=0), axis=1) / waveform.wavelength_m
        if steps.max(initial=0.0) > WIDEST_STEP:
            raise ValueError(
                f"virtual_sensor.rx_m has neighbours {steps.max():.3g} wavelengths apart; expected RX in their order "
                "along a line, half a wavelength apart"
            )
        for end in ("tx", "rx"):
            pattern, polarization = (getattr(self.front_end, f"{end}_{name}") for name in ("pattern", "polarization"))
            axis = {"V": "z", "H": "y"}[polarization]
            if isinstance(pattern, PatchPattern) and pattern.resonant_along != axis:
                raise ValueError(
                    f"front_end.{end}_pattern.resonant_along = {pattern.resonant_along!r}; expected {axis!r} with "
                    f"{end}_polarization = {polarization!r}"
                )
        noise = self.front_end.phase_noise
        if noise is not None and noise.residual_rad(waveform) > MAXIMUM_RESIDUAL_PHASE_RAD:
            raise ValueError(
                f"front_end.phase_noise leaves {noise.residual_rad(waveform):.2g} rad on the farthest echo; expected "
                f"at most {MAXIMUM_RESIDUAL_PHASE_RAD} rad, where its model holds"
            )
        return self

    def __str__(self) -> str:
        waveform, grid = self.waveform, self.grid
        sent = "all TX at once" if waveform.multiplexing == "simultaneous" else "TX in turn"
        chirps, velocity = "1 chirp", "one chirp tells none"
        if waveform.chirps > 1:
            chirps, velocity = f"{waveform.chirps} chirps", "two chirps tell none"
        if waveform.tells_velocity:
            step = waveform.velocity_step_mps
            velocity = f"+-{waveform.velocity_span_mps / 2.0:.3g} m/s in steps of {step:.3g} m/s"
        return "\n".join([
            f"radar {self.name}: {waveform.carrier_hz / 1e9:g} GHz, {waveform.bandwidth_hz / 1e6:g} MHz swept, "
            f"{chirps} of {waveform.samples} samples, {sent}",
            f"array: {self.array}",
            f"range: {waveform.range_bins} bins of {waveform.range_step_m:.3g} m, to "
            f"{waveform.range_bins * waveform.range_step_m:.3g} m; "
            f"velocity: {velocity}",
            f"image: {waveform.range_bins} x {grid.bins} (range, u), u from {grid.u_start:g} to {grid.u_stop:g}",
            f"truth: of {self.virtual_sensor.channels} channels",
        ])  # fmt: skip

    @property
    def of_one_chirp(self) -> Radar:
        """This radar with frames of a single chirp."""
        return self.model_copy(update={"waveform": self.waveform.model_copy(update={"chirps": 1})})

    @property
    def sample_noise_power_w(self) -> float:
        """Receiver noise in one complex sample, k T0 F f_s [W]."""
        noise_factor = float(db_to_power(self.front_end.noise_figure_db))
        return BOLTZMANN * REFERENCE_TEMPERATURE * noise_factor * self.waveform.sample_rate_hz

    @property
    def velocity_intervals(self) -> int:
        """How many widths of the Doppler axis this radar tells apart, K; 1 where all TX send at once.

        Of N TX that take turns, channels of TX i and i' at one place know the interval h modulo N / gcd(N, i - i'); all
        places together, modulo N over the common divisor. 1 where no two TX share a virtual element.
        """
        if self.waveform.multiplexing != "tdm":
            return 1
        tx, (_, element) = self.array.channel_tx, self.array.unique_elements(self.waveform.wavelength_m)
        _, first, at = np.unique(element, return_index=True, return_inverse=True)
        return len(self.array.tx_m) // math.gcd(len(self.array.tx_m), *np.unique(tx - tx[first[at]]).tolist())

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
            "array": {**self.array.model_dump(mode="json"), "order": "rx-major"},
            "virtual_sensor": {**self.virtual_sensor.model_dump(mode="json"), "order": "rx-major"},
            "axes": {
                "range_m": {"start": 0.0, "step": waveform.range_step_m, "bins": waveform.range_bins},
                "u": {"start": grid.u_start, "step": grid.step, "bins": grid.bins},
                "velocity_mps": {
                    "start": float(velocities[0]),
                    "stop": float(velocities[0]) + waveform.velocity_span_mps,
                    "step": waveform.velocity_step_mps,
                    "bins": waveform.chirps,
                },
            },
        }
