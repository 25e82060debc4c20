"""The detections of a network, or of an image in sqrt(W), in one frame: the verdict and the ablation score by them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
from numpy.typing import NDArray

from shared.radar import Radar
from trainer.estimators.array import line_array
from trainer.metrics.cells import CellScores, score_cells
from trainer.run.imager import Imager
from trainer.run.targets import AMPLITUDE, UNITS, level_image

Image = NDArray[np.float32]
FrameTensors = Mapping[str, torch.Tensor]
"""A frame of :class:`trainer.data.shards.ShardDataset`."""


def score_network(imager: Imager, radar: Radar, frame: FrameTensors) -> tuple[Image, CellScores]:
    """([R, U] image, relative to the truth's peak if it has amplitudes; what became of its detections)."""
    image, score = image_and_score(imager, frame["range_channel"][0], frame["noise_power"])
    unit, noise = UNITS[imager.config.target], float(frame["noise_power"])
    channels = imager.channels.cpu().numpy()
    snapshots = frame["range_channel"][0].numpy()[:, channels]
    level = level_image(image, unit, snapshots, line_array(radar, channels), radar.grid.u, noise)
    cells = score_cells(true_level(frame), level, noise, len(channels), radar.waveform.range_step_m, score)
    return (relative(image, frame) if unit == AMPLITUDE else image), cells


def score_level(level: NDArray[np.floating], imager: Imager, radar: Radar, frame: FrameTensors) -> CellScores:
    """What became of the detections in an image [R, U] [sqrt(W)] of the imager's channels."""
    noise, channels = float(frame["noise_power"]), len(imager.channels)
    return score_cells(true_level(frame), level, noise, channels, radar.waveform.range_step_m)


def image_and_score(imager: Imager, snapshot: torch.Tensor, noise_power: torch.Tensor) -> tuple[Image, Image]:
    """([R, U] image, [R, U] score), see :meth:`trainer.run.imager.Imager.image_and_score`.

    :param snapshot: [R, C] complex64, all channels of the radar [sqrt(W)]
    :param noise_power: [] [W]
    """
    device = imager.weights.device
    with torch.inference_mode():
        image, score = imager.image_and_score(snapshot[None].to(device), noise_power[None].to(device))
        return image[0].cpu().numpy(), score[0].cpu().numpy()


def true_level(frame: FrameTensors) -> NDArray[np.float64]:
    """[R, U] the truth's magnitude [sqrt(W)]."""
    return frame["image"].numpy().astype(np.float64) * float(frame["image_peak"])


def relative(image: Image, frame: FrameTensors) -> Image:
    """[R, U] an image [sqrt(W)] relative to the truth's peak; as it is where the truth is zero."""
    return image / np.float32(float(frame["image_peak"]) or 1.0)
