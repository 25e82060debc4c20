"""Where targets are: what a detection head is trained on.

A truth image is blurred by the virtual sensor's aperture and window; of two targets a quarter of a resolution cell
apart it often has one maximum, where the input array still tells two. Where the targets themselves are known they are
the truth; in scenes the truth image's maxima are (:func:`trainer.metrics.cells.truth_cells`). Each is a spot,

    exp(-(dr / sigma_r)^2 / 2 - (db / sigma_b)^2 / 2)

with dr and db the distance in range and in angle bins, narrow enough that two spots three angle bins apart stay two.
"""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray

from shared.radar import Radar
from trainer.metrics.cells import truth_cells

SIGMA_ROWS, SIGMA_BINS = 0.5, 0.8
REACH_ROWS, REACH_BINS = 1, 3
"""Beyond them a spot is below 0.14 and 0.001."""


def spots(rows: int, bins: int, row: NDArray[np.floating], place: NDArray[np.floating]) -> NDArray[np.float32]:
    """[rows, bins] the largest spot at each pixel, of targets at (range bin, angle bin) [n] each, whole or not."""
    image = np.zeros((rows, bins), dtype=np.float32)
    nearest_row, nearest_bin = np.rint(row).astype(np.intp), np.rint(place).astype(np.intp)
    for dr in range(-REACH_ROWS, REACH_ROWS + 1):
        for db in range(-REACH_BINS, REACH_BINS + 1):
            r, b = nearest_row + dr, nearest_bin + db
            inside = (r >= 0) & (r < rows) & (b >= 0) & (b < bins)
            value = np.exp(-0.5 * ((r - row) / SIGMA_ROWS) ** 2 - 0.5 * ((b - place) / SIGMA_BINS) ** 2)
            np.maximum.at(image, (r[inside], b[inside]), value[inside].astype(np.float32))
    return image


def scene_spots(
    image: torch.Tensor, image_peak: torch.Tensor, noise_power: torch.Tensor, channels: int, radar: Radar
) -> torch.Tensor:
    """[B, R, U] spots of whole truths [B, R, U] relative to their peaks, of what ``channels`` can see."""
    made = []
    for truth, peak, noise in zip(image.cpu().numpy(), image_peak.tolist(), noise_power.tolist(), strict=True):
        row, place = truth_cells(truth * peak, noise, channels, radar.waveform.range_step_m).T.astype(np.float64)
        made.append(spots(len(truth), radar.grid.bins, row, place))
    return torch.from_numpy(np.stack(made)).to(image.device)
