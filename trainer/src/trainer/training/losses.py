"""Losses of Table 2 of the paper, weighted against the empty background, and what a detection head is trained on.

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
from torch.nn import functional

from shared.radar import Radar
from trainer.metrics.cells import truth_cells
from trainer.run.configuration import FitConfig

SIGMA_ROWS, SIGMA_BINS = 0.5, 0.8
REACH_ROWS, REACH_BINS = 1, 3
"""Beyond them a spot is below 0.14 and 0.001."""


def spot_image(rows: int, bins: int, row: NDArray[np.floating], place: NDArray[np.floating]) -> NDArray[np.float32]:
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
        made.append(spot_image(len(truth), radar.grid.bins, row, place))
    return torch.from_numpy(np.stack(made)).to(image.device)


def frame_losses(
    config: FitConfig,
    answer: torch.Tensor,
    target: torch.Tensor,
    known: torch.Tensor,
    spots: torch.Tensor | None,
) -> torch.Tensor:
    """[B] loss of each frame, a mean over its known pixels.

    Regression: w (x - y)^2 + alpha |x|. Classification: w times the cross entropy -log p(class) of the two-class
    softmax (the paper's table prints it without the minus). w = 1 + foreground min(y, 1), scaled for the paper's beta.
    A detection head adds ``config.detection`` times the binary cross entropy of its logit.

    :param answer: [B, 1 or 2, R, U]
    :param target: [B, R, U]
    :param spots: [B, R, U] where targets are, for a network that detects (:mod:`trainer.training.losses`)
    :param known: [B, 1, U] 1 where the truth is known, 0 where an augmented frame has none
    """
    answer = answer.float()
    full = config.beta if config.target == "paper" else 1.0
    weight = 1.0 + config.foreground * (target / full).clamp(max=1.0)
    if config.target == "class":
        loss = weight * functional.cross_entropy(answer, target.long(), reduction="none")
    else:
        loss = weight * (answer[:, 0] - target).square() + config.alpha * answer[:, 0].abs()
    if spots is not None:
        loss = loss + config.detection * functional.binary_cross_entropy_with_logits(
            answer[:, 1], spots, reduction="none"
        )
    return (loss * known).sum(dim=(-2, -1)) / (known.sum(dim=(-2, -1)) * loss.shape[-2])
