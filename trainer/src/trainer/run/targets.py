"""What a network is asked for, and how its answer becomes an image again.

Three targets of the truth image. "paper": min-max normalised per image, times beta; amplitudes are lost. "class": one
where the truth is above a stated level. "row": magnitude over the row's own RMS in the input, compressed; an echo falls
with R^2, so that min-max leaves nothing of what is beyond ten metres, while here every range bin weighs alike, and the
input's RMS turns the estimate back into sqrt(W).
"""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray

from shared.physics.units import db_to_power
from trainer.estimators.array import LineArray
from trainer.estimators.das import DelayAndSum
from trainer.run.configuration import FitConfig

AMPLITUDE = "sqrt(W)"
PROBABILITY = "probability of a target"
UNITS = {"row": AMPLITUDE, "paper": "relative to the image's peak", "class": PROBABILITY, "doa": PROBABILITY}
"""Unit of the decoded image, by target."""


def encode(
    config: FitConfig, image: torch.Tensor, image_peak: torch.Tensor, row_scale: torch.Tensor | None
) -> torch.Tensor:
    """[B, R, U] what the network should answer.

    :param image: [B, R, U] truth relative to its peak
    :param image_peak: [B] [sqrt(W)]
    :param row_scale: [B, R] RMS that the features took out [sqrt(W)], for the "row" target
    """
    if config.target == "class":
        return (image > float(db_to_power(-config.threshold_db / 2.0))).to(image.dtype)
    if config.target == "paper":
        lowest = image.amin(dim=(-2, -1), keepdim=True)
        span = image.amax(dim=(-2, -1), keepdim=True) - lowest
        return config.beta * (image - lowest) / torch.where(span > 0, span, 1.0)
    # The quotient comes first: two small numbers of one size neither under- nor overflow.
    assert row_scale is not None
    quotient = image_peak.to(image.dtype)[:, None] / torch.where(row_scale > 0, row_scale, torch.inf)
    return (image * quotient[..., None]).pow(config.exponent)


def decode(config: FitConfig, answer: torch.Tensor, row_scale: torch.Tensor | None) -> torch.Tensor:
    """[B, R, U] image of a network's answer [B, 1 or 2, R, U]; not negative; in :data:`UNITS`."""
    answer = answer.float()
    if config.target == "class":
        return answer.softmax(dim=1)[:, 1]
    if config.target == "doa":
        return answer[:, 0].sigmoid()
    positive = answer[:, 0].clamp_min(0.0)
    if config.target == "paper":
        return positive / config.beta
    assert row_scale is not None
    return positive.pow(1.0 / config.exponent) * row_scale[..., None]


def level_image(
    image: NDArray[np.floating],
    unit: str,
    snapshots: NDArray[np.complexfloating],
    array: LineArray,
    u: NDArray[np.floating],
    noise_power: float,
) -> NDArray[np.floating]:
    """[R, U] magnitude that a method reads [sqrt(W)].

    An image without absolute unit says where something is. The data say how strong it is, by delay and sum there.

    :param image: [R, U] in ``unit``, of :data:`UNITS`
    :param snapshots: [R, C] that it was made from, the channels of ``array`` [sqrt(W)]
    :param u: [U] angles of the image
    :param noise_power: of one channel [W]
    """
    return image if unit == AMPLITUDE else DelayAndSum().image(snapshots, array, u, noise_power)
