"""Point targets simulated while training: any number of snapshots with a known truth.

A scene fills few of its range bins with echoes that can be told apart, and a dataset ends. Here every training frame is
accompanied by crops of random point targets, seen by the input array and by the virtual sensor at once. An echo of
amplitude a at range bin r (not a whole number) and u is, in row p and at a virtual element y,

    a H(r - p) exp(-j k u y),    H(d) = exp(j pi d) sinc(d) / (1 - d^2)

with H the spectrum of the Hann window over the range samples. Plane waves, one Doppler cell, no range walk: right for
the input array beyond some 5 m. The truth is the windowed matched filter of the virtual sensor's same sum, noise free,
and white noise of unit power in every channel is the scale of the amplitudes. Directions fill all of |u| <= 1, so that
what lies outside the image, and folds into it, is met in training too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from shared.radar import Radar
from shared.signal.imaging import steering_matrix
from shared.signal.windows import angle_window

TARGETS_PER_ROW = (0.05, 3.0)
"""Density of a crop's targets, drawn between these with a uniform logarithm."""
STRONGEST_DB = (-10.0, 65.0)
"""Level of a crop's strongest target over the noise, uniform; the datasets' specular flashes reach 68 dB."""
SPAN_DB = 25.0
"""Levels of a crop's targets below the strongest, uniform."""
NEIGHBOURS = range(-3, 5)
"""Rows that an echo is added to, from the row below it on; beyond them |H| is below -48 dB."""


@dataclass(frozen=True)
class PointCrops:
    """Crops of B places.

    :param range_channel: [B, R, C] complex64, noise power 1
    :param image: [B, R, U] truth relative to its peak
    :param image_peak: [B] float64, that peak; 1 where a crop is empty
    """

    range_channel: torch.Tensor
    image: torch.Tensor
    image_peak: torch.Tensor


class OnlinePoints:
    """Crops of point targets for one radar.

    :param truth_window: over the virtual sensor's elements, of :data:`shared.signal.windows.ANGLE_WINDOWS`
    """

    def __init__(self, radar: Radar, truth_window: str) -> None:
        sensor = radar.virtual_sensor
        wavenumber = 2.0 * np.pi / radar.waveform.wavelength_m
        self._phase = wavenumber * np.concatenate([radar.array.virtual[:, 1], sensor.virtual[:, 1]])
        self._channels = radar.array.channels
        weights = angle_window(truth_window, sensor.channels)[:, None] / sensor.channels
        self._matched = torch.from_numpy((weights * steering_matrix(radar, sensor)).astype(np.complex64))

    def __call__(self, seed: int, step: int, places: range, rows: int, device: torch.device) -> PointCrops:
        """The crops of these places of the batch of all processes: a function of seed, step and place alone."""
        drawn = [self._draw(np.random.default_rng([seed, step, 1, place]), rows) for place in places]
        row, u, amplitude, noise = zip(*drawn, strict=True)
        crop = np.repeat(np.arange(len(drawn)), [len(part) for part in row])
        return self._snapshots_and_truth(
            crop, np.concatenate(row), np.concatenate(u), np.concatenate(amplitude),
            torch.from_numpy(np.stack(noise)).to(device),
        )  # fmt: skip

    def _draw(
        self, generator: np.random.Generator, rows: int
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.complex128], NDArray[np.complex64]]:
        """([n] range bin, [n] u, [n] amplitude of the targets, [rows, C] noise) of one crop."""
        density = np.exp(generator.uniform(*np.log(TARGETS_PER_ROW)))
        count = generator.poisson(density * rows)
        level_db = generator.uniform(*STRONGEST_DB) - generator.uniform(0.0, SPAN_DB, count)
        amplitude = 10.0 ** (level_db / 20.0) * np.exp(2j * np.pi * generator.random(count))
        noise = generator.standard_normal((rows, self._channels, 2), dtype=np.float32) * np.float32(np.sqrt(0.5))
        # Targets start one row outside the crop: their echoes reach into it.
        row, u = generator.uniform(-1.0, rows, count), generator.uniform(-1.0, 1.0, count)
        return row, u, amplitude, noise.view(np.complex64)[..., 0]

    def _snapshots_and_truth(
        self,
        crop: NDArray[np.int_],
        row: NDArray[np.float64],
        u: NDArray[np.float64],
        amplitude: NDArray[np.complex128],
        noise: torch.Tensor,
    ) -> PointCrops:
        """Snapshots of the input array with ``noise`` [B, R, C], and the virtual sensor's image, of targets [n]."""
        crops, rows, channels = noise.shape
        device = noise.device
        # float32 keeps phases below a thousand radians to 1e-4.
        phase = torch.from_numpy(-u[:, None] * self._phase).float().to(device)
        echo = torch.polar(torch.ones_like(phase), phase)  # (n, C + V)
        seen = torch.zeros(crops * rows, echo.shape[1], dtype=torch.complex64, device=device)
        for offset in NEIGHBOURS:
            place = np.floor(row).astype(int) + offset
            inside = (place >= 0) & (place < rows)
            weight = (amplitude * hann_response(row - place))[inside].astype(np.complex64)
            target = torch.from_numpy((crop * rows + place)[inside]).to(device)
            seen.index_add_(0, target, torch.from_numpy(weight)[:, None].to(device) * echo[torch.from_numpy(inside)])
        seen = seen.reshape(crops, rows, -1)
        image = (seen[..., channels:] @ self._matched.to(device)).abs()
        peak = image.amax(dim=(-2, -1))
        peak = torch.where(peak > 0, peak, 1.0)
        return PointCrops(seen[..., :channels] + noise, image / peak[:, None, None], peak.double())


def hann_response(offset: NDArray[np.float64]) -> NDArray[np.complex128]:
    """Spectrum of the periodic Hann window over its sum, ``offset`` bins from the peak; many samples."""
    poles = np.isclose(np.abs(offset), 1.0, atol=1e-9)
    magnitude = np.where(poles, 0.5, np.sinc(offset) / np.where(poles, 1.0, 1.0 - offset**2))
    return magnitude * np.exp(1j * np.pi * offset)
