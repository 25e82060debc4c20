"""The network of a configuration: what it is given, and how large it is."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from shared.physics.errors import InputError
from shared.radar import Radar
from shared.signal.features import ADAPTIVE_CHANNELS, COMPRESSED, COVARIANCE_CHANNELS, PAPER_CHANNELS
from trainer.networks.attention_unet import AttentionUNet
from trainer.networks.doa_cnn import LEAST_CHANNELS, DoaCnn
from trainer.networks.spectral_unet import SpectralUNet
from trainer.networks.unrolled import UnrolledNetwork
from trainer.run.configuration import FitConfig

CHANNELS = {
    "adaptive": ADAPTIVE_CHANNELS,
    "paper": PAPER_CHANNELS,
    "covariance": COVARIANCE_CHANNELS,
}
"""What each kind of features consists of, where that is images; snapshots are no image."""


LEAST_BINS = 3
"""Of the "doa-cnn": as many targets as a sample has stand in bins of their own."""
MOST_PARAMETERS = 2**28
"""Weights of a network. In training each takes 16 bytes: itself, its gradient and two moments."""


def build_network(config: FitConfig, radar: Radar, channels: NDArray[np.intp]) -> nn.Module:
    """The network of a configuration, for the radar's images and these of its channels.

    :raises InputError: more than :data:`MOST_PARAMETERS`, or fewer channels than the "doa-cnn" needs
    """
    bins = radar.grid.bins
    if config.model == "doa-cnn" and len(channels) < LEAST_CHANNELS:
        raise InputError("--array", f"{len(channels)} channels", f"at least {LEAST_CHANNELS} with model 'doa-cnn'")
    if config.model == "doa-cnn" and bins < LEAST_BINS:
        raise InputError("radar", f"grid.bins = {bins}", f"at least {LEAST_BINS} with model 'doa-cnn'")
    with torch.device("meta"):  # counted before they take memory
        parameters = sum(parameter.numel() for parameter in _network(config, radar, channels).parameters())
    if parameters > MOST_PARAMETERS:
        size = f"{parameters:.3g} weights, {16e-9 * parameters:.3g} GB in training"
        asked = f"width = {config.width}, hidden = {config.hidden}, bins = {bins}, {len(channels)} channels"
        raise InputError("network", f"{asked} make {size}", f"at most {MOST_PARAMETERS:.3g} weights")
    return _network(config, radar, channels)


def _network(config: FitConfig, radar: Radar, channels: NDArray[np.intp]) -> nn.Module:
    bins = radar.grid.bins
    if config.model == "unrolled":
        return UnrolledNetwork(
            radar, channels, config.truth_window, config.exponent, config.iterations, config.learned, config.width,
            detects=config.detection > 0,
        )  # fmt: skip
    if config.model == "doa-cnn":
        return DoaCnn(len(channels), bins, config.width)
    inputs = len(CHANNELS[config.features])
    outputs = 2 if config.target == "class" else 1
    if config.model == "attention-unet":
        return AttentionUNet(inputs, outputs, config.width)
    # The adaptive spectrum is an answer of the "row" target's kind: a magnitude over its row's, compressed alike.
    start = ADAPTIVE_CHANNELS.index(COMPRESSED) if (config.features, config.target) == ("adaptive", "row") else None
    return SpectralUNet(inputs, outputs, bins, config.width, config.hidden, start)


def lay_out(network: nn.Module, memory_format: torch.memory_format) -> None:
    """Store the weights in the memory format of the images: the same numbers, another speed."""
    network.to(memory_format=memory_format)  # type: ignore[call-overload]  # torch's declarations leave it out
