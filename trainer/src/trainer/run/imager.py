"""Range-channel matrices to images: channels, features, network, decoding, as one torch module; and what such a network
is asked for, the inverse of the decoding."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from shared.physics.errors import InputError
from shared.physics.units import db_to_amplitude
from shared.radar import Radar
from shared.signal.adaptive import AdaptiveTables, adaptive_tables
from shared.signal.features import (
    ADAPTIVE_CHANNELS,
    COMPRESSED,
    COVARIANCE_CHANNELS,
    PAPER_CHANNELS,
    ModelError,
    adaptive_features,
    covariance_channels,
    paper_features,
    snapshot_features,
)
from shared.signal.imaging import steering_weights
from shared.signal.model_error import NO_MODEL_ERROR_DB, model_error_ratio
from trainer.data.arrays import ArrayChoice
from trainer.networks.convolutional import LEAST_CHANNELS, AttentionUNet, DoaCnn, SpectralUNet
from trainer.networks.unrolled import UnrolledNetwork, laid_out
from trainer.run.configuration import FitConfig

AMPLITUDE = "sqrt(W)"
PROBABILITY = "probability of a target"
UNITS = {"row": AMPLITUDE, "paper": "relative to the image's peak", "class": PROBABILITY, "doa": PROBABILITY}
"""Unit of the decoded image, by target."""
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
            radar, channels, config.truth_window, config.exponent, (config.iterations, config.learned), config.width,
            detects=config.detection > 0, told=config.told > 0,
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


INSTRUCTIONS = ("avx512_bf16", "amx_bf16", "bf16", "sve_bf16")
"""As torch names them, of x86-64 and of ARM64."""
FLOAT32_INSTEAD = "bf16 networks computed in float32: this processor has no bfloat16 instructions"


def has_bfloat16() -> bool:
    """Whether the processor computes in bfloat16; one that only emulates it is slower so than in float32."""
    capabilities = torch.cpu.get_capabilities()
    return any(capabilities.get(name) for name in INSTRUCTIONS)


def in_bfloat16(config: FitConfig, device: str) -> bool:
    """Whether a run's network is computed in bfloat16 on a device of this type: where its configuration says so, and on
    a processor that has the instructions."""
    return config.precision == "bf16" and (device != "cpu" or has_bfloat16())


def best_device() -> str:
    """A GPU where there is one."""
    return "cuda" if torch.cuda.is_available() else "cpu"


def precision_remark(configs: Iterable[FitConfig]) -> str | None:
    """What a user should know if one of these networks is computed otherwise than its configuration says."""
    other = any(config.precision == "bf16" and not in_bfloat16(config, best_device()) for config in configs)
    return FLOAT32_INSTEAD if other else None


def encode(
    config: FitConfig, image: torch.Tensor, image_peak: torch.Tensor, row_scale: torch.Tensor | None
) -> torch.Tensor:
    """[B, R, U] what the network should answer.

    "paper": min-max normalised per image, times beta; amplitudes are lost. "class": one where the truth is above a
    stated level. "row": magnitude over the row's own RMS in the input, compressed; an echo falls with R^2, so that
    min-max leaves nothing of what is beyond ten metres, while here every range bin weighs alike, and the input's RMS
    turns the estimate back into sqrt(W).

    :param image: [B, R, U] truth relative to its peak
    :param image_peak: [B] [sqrt(W)]
    :param row_scale: [B, R] RMS that the features took out [sqrt(W)], for the "row" target
    """
    if config.target == "class":
        return (image > float(db_to_amplitude(-config.threshold_db))).to(image.dtype)
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


def lay_out(network: nn.Module, memory_format: torch.memory_format) -> None:
    """Store the weights in the memory format of the images: the same numbers, another speed."""
    network.to(memory_format=memory_format)  # type: ignore[call-overload]  # torch's declarations leave it out


class Imager(nn.Module):
    """A network with the features before it and the decoding behind it.

    :param array: the channels that the network sees

    ``gain`` multiplies the image of a target that has amplitudes: what the validation frames say a network over- or
    underestimates as a whole. 1 while it trains.
    """

    channels: torch.Tensor
    weights: torch.Tensor

    def __init__(self, config: FitConfig, radar: Radar, array: ArrayChoice) -> None:
        super().__init__()
        self.config = config
        channels = array.line(radar)
        # These buffers are neither trained nor stored: they follow from radar and array.
        self.register_buffer("channels", torch.from_numpy(channels), persistent=False)
        self.register_buffer("weights", torch.from_numpy(steering_weights(radar, channels)), persistent=False)
        if config.features == "adaptive":
            for name, table in adaptive_tables(radar, channels)._asdict().items():
                self.register_buffer(name, torch.from_numpy(table), persistent=False)
        self.network = build_network(config, radar, channels)
        self.gain = 1.0
        self._all_channels = radar.array.channels

    def features(
        self, range_channel: torch.Tensor, noise_power: torch.Tensor, model_error: ModelError = 0.0
    ) -> tuple[torch.Tensor, torch.Tensor | None]:
        """([B, F, R, U] float32 input of the network, [B, R] scale of the rows or None).

        Of the "doa-cnn" it is [B, 3, R, C * C] covariances, of the "unrolled" network [B, 2 C + 1, R, 1] snapshots.

        :param range_channel: [B, R, C] complex64, all channels of the radar [sqrt(W)]
        :param noise_power: [B] [W]
        :param model_error: see :data:`shared.signal.features.ModelError`; part of the noise wherever an input has it
        :raises InputError: another number of channels
        """
        if range_channel.ndim != 3 or range_channel.shape[-1] != self._all_channels:
            expected = f"[frames, range bins, {self._all_channels}], all channels of the radar"
            raise InputError("range_channel", f"shape {list(range_channel.shape)}", expected)
        with torch.no_grad(), torch.autocast(range_channel.device.type, enabled=False):
            chosen = range_channel[..., self.channels]
            if self.config.features == "snapshots":
                return snapshot_features(chosen, noise_power, model_error)
            if self.config.features == "paper":
                return paper_features(chosen, self.weights), None
            if self.config.features == "covariance":
                return covariance_channels(chosen), None
            tables = AdaptiveTables(*(self.get_buffer(name) for name in AdaptiveTables._fields))
            iterations, exponent = self.config.iterations, self.config.exponent
            return adaptive_features(chosen, self.weights, noise_power, tables, iterations, exponent, model_error)

    def das(self, range_channel: torch.Tensor) -> torch.Tensor:
        """[B, R, U] delay-and-sum magnitude of the same channels [sqrt(W)], the network's baseline."""
        return (range_channel[..., self.channels] @ self.weights).abs()

    def answer(
        self, features: torch.Tensor, prior: torch.Tensor | None = None, place: torch.Tensor | None = None
    ) -> torch.Tensor:
        """[B, 1 or 2, R, U] of the network, see :func:`in_bfloat16`.

        :param prior: [B, R, N] of an "unrolled" network
        :param place: see :meth:`detect`
        """
        device = features.device.type
        with torch.autocast(device, torch.bfloat16, enabled=in_bfloat16(self.config, device)):
            if isinstance(self.network, UnrolledNetwork):
                return self.network(features, prior, place)
            images = features if place is None else laid_out(features, place)
            return self.network(images.contiguous(memory_format=torch.channels_last))

    @property
    def detects(self) -> bool:
        """Whether the network says where targets are."""
        return self.config.model == "unrolled" and self.config.detection > 0

    def detect(
        self,
        range_channel: torch.Tensor,
        noise_power: torch.Tensor,
        model_error_db: float = NO_MODEL_ERROR_DB,
        prior: torch.Tensor | None = None,
        place: torch.Tensor | None = None,
    ) -> tuple[torch.Tensor, torch.Tensor | None]:
        """([B, R, U] image, see :data:`UNITS`; [B, R, U] probability of a target, or None).

        A network without a detection head has no such probability, but where its image is one. With ``place`` the
        images are those of :func:`trainer.networks.unrolled.laid_out`, and B is 1.

        :param model_error_db: what calibration leaves of a plane wave, see :mod:`shared.signal.model_error`
        :param prior: see :meth:`answer`
        :raises InputError: a model error above 0 dB
        """
        features, scale = self.features(range_channel, noise_power, model_error_ratio(model_error_db))
        answer = self.answer(features, prior, place)
        scale = scale if scale is None or place is None else scale[0][place]
        image = self.gain * decode(self.config, answer, scale)
        if self.detects:
            return image, answer[:, 1].float().sigmoid()
        return image, image if UNITS[self.config.target] == PROBABILITY else None

    def forward(
        self, range_channel: torch.Tensor, noise_power: torch.Tensor, model_error_db: float = NO_MODEL_ERROR_DB
    ) -> torch.Tensor:
        """[B, R, U] image of :meth:`detect`."""
        return self.detect(range_channel, noise_power, model_error_db)[0]
