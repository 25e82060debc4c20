"""New frames from old ones by what an array's far field allows: a shift and a mirror image in u = sin(azimuth).

An echo at u has the phase -k u y over the virtual elements y. Multiplied by exp(-j k d y) it is an echo at u + d, and
conjugated one at -u: for any array, thinned or not, exactly in the far field (from about 5 m for the input array). The
truth is shifted or mirrored with it; what a shift brings in from outside the image is unknown and does not count.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from shared.radar import Radar

LARGEST_SHIFT = 0.25
"""Largest shift in u; a wider one leaves too little of the image known."""


@dataclass(frozen=True)
class Draw:
    """The random part of one training batch, the same on every device and however the batch is dealt out.

    :param shift: [B] angle bins
    :param mirror: [B] bool, before the shift
    :param crop: the first range bin of the crop, as a fraction of what is possible
    :param told: [B] uniform from 0 to 1: below the share that is told the sensor's motion, the frame is
    """

    shift: torch.Tensor
    mirror: torch.Tensor
    crop: float
    told: NDArray[np.float64]


def draw(seed: int, step: int, batch: int, first: int, count: int, largest: int) -> Draw:
    """What happens to frames ``first`` to ``first + count`` of a batch of ``batch`` frames at a step of a run.

    :param largest: largest shift [bins]; 0 leaves the frames as they are, but for the crop
    """
    generator = np.random.default_rng([seed, step])
    shift = torch.from_numpy(generator.integers(-largest, largest + 1, batch))
    mirror = torch.from_numpy(generator.random(batch) < (0.5 if largest else 0.0))
    part = slice(first, first + count)
    return Draw(shift[part], mirror[part], float(generator.random()), generator.random(batch)[part])


class AngularAugmentation:
    """Shifts and mirrors for one radar."""

    def __init__(self, radar: Radar) -> None:
        grid = radar.grid
        wavenumber = 2.0 * np.pi / radar.waveform.wavelength_m
        self.bins, self._step = grid.bins, grid.step
        self.largest_shift = int(LARGEST_SHIFT / grid.step)
        # Phase [rad] of one bin's shift, for each channel.
        self._phase = torch.from_numpy(wavenumber * grid.step * radar.array.virtual[:, 1])
        self._mirror = grid.mirror

    def __call__(
        self, range_channel: torch.Tensor, truths: Sequence[torch.Tensor], drawn: Draw
    ) -> tuple[torch.Tensor, list[torch.Tensor], torch.Tensor]:
        """([B, R, C] snapshots, the truths [B, R, U], [B, 1, U] 1 where they are known)."""
        device = range_channel.device
        shift = drawn.shift.to(device)[:, None, None]
        mirror = drawn.mirror.to(device)[:, None, None]
        if self._mirror is None:
            mirror = torch.zeros_like(mirror)
        phasor = torch.polar(torch.ones_like(self._phase), -self._phase)
        powers = phasor.to(device)[None, None, :] ** shift
        moved = torch.where(mirror, range_channel.conj(), range_channel) * powers.to(range_channel.dtype)
        source = torch.arange(self.bins, device=device)[None, None, :] - shift
        source = torch.where(mirror, (self._mirror or 0) - source, source)  # (B, 1, U)
        known = (source >= 0) & (source < self.bins)
        source = source.clamp(0, self.bins - 1)
        gathered = [torch.take_along_dim(truth, source, dim=-1) * known for truth in truths]
        return moved, gathered, known.to(torch.float32)

    def origins(self, u: NDArray[np.float64], drawn: Draw) -> NDArray[np.float64]:
        """[B, N] where in the frames stood what now is at angles u; beyond 1 it folds, as of half a wavelength."""
        origin = u - self._step * drawn.shift.numpy()[:, None]
        if self._mirror is not None:
            origin = np.where(drawn.mirror.numpy()[:, None], -origin, origin)
        return (origin + 1.0) % 2.0 - 1.0
