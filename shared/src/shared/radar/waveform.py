"""The chirp sequence: eq. (1) and (3) of the paper as numbers, and the axes that follow from them."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
from jaxtyping import Float64, Int64, Real
from pydantic import Field, FiniteFloat, model_validator

from shared.physics.units import SPEED_OF_LIGHT
from shared.radar.validation import Described

Frequency = Annotated[FiniteFloat, Field(gt=0, le=1e13)]
Duration = Annotated[FiniteFloat, Field(ge=1e-9, le=1e3)]
"""Limits far outside of radar, and far inside of what products of a few of them can overflow."""


class Waveform(Described):
    """An FMCW chirp sequence, sampled as complex IF signal.

    Sample n of a chirp is taken at ``t = n T_c / samples``; chirp m starts at ``m * chirp_interval_s``. With
    ``multiplexing="simultaneous"`` all TX send at once as if perfectly orthogonal; with ``"tdm"`` they take turns, TX i
    starting ``i * chirp_interval_s / TX count`` after TX 0.

    :param carrier_hz: frequency at the start of the sweep, f_c [Hz]
    :param bandwidth_hz: swept bandwidth B [Hz]
    :param chirp_duration_s: sweep time T_c [s]; all of it is sampled
    :param chirp_interval_s: time from one chirp of a TX to its next [s]
    :param chirps: chirps a frame
    :param samples: complex samples a chirp
    :param range_bins: range bins kept, from range 0; as many as samples where these are fewer and it is not stated
    :param multiplexing: how the TX share the time: "simultaneous" or "tdm"
    :param residual_video_phase: add the term -mu tau^2 / 2 that eq. (1) leaves out
    """

    carrier_hz: Frequency = 77e9
    bandwidth_hz: Frequency = 1e9
    chirp_duration_s: Duration = 80.6e-6
    chirp_interval_s: Duration = 80.6e-6
    chirps: Annotated[int, Field(ge=1, le=2**16)] = 128
    samples: Annotated[int, Field(ge=1, le=2**20)] = 1024
    range_bins: Annotated[int, Field(ge=1)] = 630
    multiplexing: Literal["simultaneous", "tdm"] = "simultaneous"
    residual_video_phase: bool = False

    @model_validator(mode="before")
    @classmethod
    def _no_more_bins_than_samples(cls, given: Any) -> Any:
        samples = given.get("samples") if isinstance(given, dict) and "range_bins" not in given else None
        if isinstance(samples, int) and samples < cls.model_fields["range_bins"].default:
            return {**given, "range_bins": samples}
        return given

    @model_validator(mode="after")
    def _consistent(self) -> Waveform:
        if self.chirp_interval_s < self.chirp_duration_s:
            raise ValueError(
                f"chirp_interval_s = {self.chirp_interval_s!r} is shorter than chirp_duration_s = "
                f"{self.chirp_duration_s!r}; expected at least as long"
            )
        if self.range_bins > self.samples:
            raise ValueError(f"range_bins = {self.range_bins!r}; expected at most samples = {self.samples}")
        return self

    @property
    def slope_hz_per_s(self) -> float:
        """Chirp rate mu = B / T_c, eq. (3)."""
        return self.bandwidth_hz / self.chirp_duration_s

    @property
    def sample_rate_hz(self) -> float:
        """Samples of a chirp over its duration [Hz]."""
        return self.samples / self.chirp_duration_s

    @property
    def mid_sweep_hz(self) -> float:
        """f_c + B/2, where the range window has its weight: the frequency of angle and Doppler."""
        return self.carrier_hz + self.bandwidth_hz / 2.0

    @property
    def wavelength_m(self) -> float:
        """Wavelength at mid-sweep [m]."""
        return SPEED_OF_LIGHT / self.mid_sweep_hz

    @property
    def range_step_m(self) -> float:
        """Range bin c / 2B [m]."""
        return SPEED_OF_LIGHT / (2.0 * self.bandwidth_hz)

    @property
    def unambiguous_range_m(self) -> float:
        """Range beyond which an echo folds back onto a nearer bin [m]."""
        return self.samples * self.range_step_m

    @property
    def velocity_step_mps(self) -> float:
        """Doppler bin lambda / (2 M T) [m/s]."""
        return self.wavelength_m / (2.0 * self.chirps * self.chirp_interval_s)

    @property
    def velocity_span_mps(self) -> float:
        """Width of the Doppler axis lambda / (2 T) [m/s]: velocities that far apart fall into one Doppler cell."""
        return self.velocity_step_mps * self.chirps

    @property
    def tells_velocity(self) -> bool:
        """Whether a frame tells velocities: one chirp tells none, and of two the Hann window leaves one."""
        return self.chirps > 2

    @property
    def mid_frame_s(self) -> float:
        """Centre of the Doppler window [s] after the start of chirp 0."""
        return 0.5 * self.chirps * self.chirp_interval_s

    @property
    def ranges_m(self) -> Float64[np.ndarray, " range_bins"]:
        """[range_bins] range axis [m], rising from 0."""
        return self.range_step_m * np.arange(self.range_bins, dtype=np.float64)

    @property
    def velocities_mps(self) -> Float64[np.ndarray, " chirps"]:
        """[chirps] Doppler axis [m/s], rising; positive is receding; the lower edge is in, the upper is not."""
        return self.velocity_step_mps * (np.arange(self.chirps, dtype=np.float64) - self.chirps // 2)

    def doppler_cells(self, velocities_mps: Real[np.ndarray, "*any"]) -> Int64[np.ndarray, "*any"]:
        """The cells of the Doppler axis that velocities [m/s] fall into, folded at its ends."""
        cells = np.rint(np.asarray(velocities_mps) / self.velocity_step_mps).astype(np.int64)
        return (cells + self.chirps // 2) % self.chirps
