"""The network of a configuration: what it is given, and how large it is."""

from __future__ import annotations

import torch
from torch import nn

from shared.signal.features import ADAPTIVE_CHANNELS, COMPRESSED, COVARIANCE_CHANNELS, PAPER_CHANNELS, ROW_CHANNELS
from trainer.networks.attention_unet import AttentionUNet
from trainer.networks.doa_cnn import DoaCnn
from trainer.networks.spectral_unet import SpectralUNet
from trainer.run.configuration import FitConfig

CHANNELS = {
    "adaptive": ADAPTIVE_CHANNELS,
    "row": ROW_CHANNELS,
    "paper": PAPER_CHANNELS,
    "covariance": COVARIANCE_CHANNELS,
}
"""What each kind of features consists of."""


def build_network(config: FitConfig, bins: int, channels: int) -> nn.Module:
    """The network of a configuration, for images of ``bins`` angle bins of an array of ``channels``."""
    if config.model == "doa-cnn":
        return DoaCnn(channels, bins, config.width)
    inputs = len(CHANNELS[config.features])
    outputs = 2 if config.target == "class" else 1
    if config.model == "attention-unet":
        return AttentionUNet(inputs, outputs, config.width)
    # The adaptive spectrum is an answer of the "row" target's kind: a magnitude over its row's, compressed alike.
    start = ADAPTIVE_CHANNELS.index(COMPRESSED) if (config.features, config.target) == ("adaptive", "row") else None
    return SpectralUNet(inputs, outputs, bins, config.width, config.hidden, config.blocks, start)


def lay_out(network: nn.Module, memory_format: torch.memory_format) -> None:
    """Store the weights in the memory format of the images: the same numbers, another speed."""
    network.to(memory_format=memory_format)  # type: ignore[call-overload]  # torch's declarations leave it out
