"""Networks from feature images [B, F, R, U] to estimates [B, 1 or 2, R, U]."""

from __future__ import annotations

from torch import nn

from shared.features import PAPER_CHANNELS, ROW_CHANNELS
from trainer.configuration import FitConfig
from trainer.networks.attention_unet import AttentionUNet
from trainer.networks.doa_cnn import DoaCnn
from trainer.networks.spectral_unet import SpectralUNet


def build_network(config: FitConfig, bins: int, channels: int) -> nn.Module:
    """The network of a configuration, for images of ``bins`` angle bins of an array of ``channels``."""
    if config.model == "doa-cnn":
        return DoaCnn(channels, bins, config.width)
    inputs = len(ROW_CHANNELS if config.features == "row" else PAPER_CHANNELS)
    outputs = 2 if config.target == "class" else 1
    if config.model == "attention-unet":
        return AttentionUNet(inputs, outputs, config.width)
    return SpectralUNet(inputs, outputs, bins, config.width, config.hidden)
