"""Range-channel matrices to images: channels, features, network, decoding, as one torch module."""

from __future__ import annotations

import torch
from torch import nn

from shared.radar import Radar
from shared.signal.adaptive import AdaptiveTables, adaptive_tables
from shared.signal.features import (
    ModelError,
    adaptive_features,
    covariance_channels,
    paper_features,
    snapshot_features,
    steering_weights,
)
from shared.signal.model_error import NO_MODEL_ERROR_DB, model_error_ratio
from trainer.data.arrays import ArrayChoice
from trainer.run.building import build_network
from trainer.run.configuration import FitConfig
from trainer.run.targets import PROBABILITY, UNITS, decode


class Imager(nn.Module):
    """A network with the features before it and the decoding behind it.

    :param config: of the run
    :param radar: of the data
    :param array: the channels that the network sees

    ``gain`` multiplies the image of a target that has amplitudes: what the validation frames say a network over- or
    underestimates as a whole. 1 while it trains.
    """

    channels: torch.Tensor
    weights: torch.Tensor

    def __init__(self, config: FitConfig, radar: Radar, array: ArrayChoice) -> None:
        super().__init__()
        self.config = config
        channels = array.channels(radar)
        # These buffers are neither trained nor stored: they follow from radar and array.
        self.register_buffer("channels", torch.from_numpy(channels), persistent=False)
        self.register_buffer("weights", torch.from_numpy(steering_weights(radar, channels)), persistent=False)
        if config.features == "adaptive":
            for name, table in adaptive_tables(radar, channels)._asdict().items():
                self.register_buffer(name, torch.from_numpy(table), persistent=False)
        self.network = build_network(config, radar, channels)
        self.gain = 1.0

    def features(
        self, range_channel: torch.Tensor, noise_power: torch.Tensor, model_error: ModelError = 0.0
    ) -> tuple[torch.Tensor, torch.Tensor | None]:
        """([B, F, R, U] float32 input of the network, [B, R] scale of the rows or None).

        Of the "doa-cnn" it is [B, 3, R, C * C] covariances, of the "unrolled" network [B, 2 C + 1, R, 1] snapshots.

        :param range_channel: [B, R, C] complex64, all channels of the radar [sqrt(W)]
        :param noise_power: [B] [W]
        :param model_error: see :data:`shared.signal.features.ModelError`; part of the noise wherever an input has it
        """
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

    def answer(self, features: torch.Tensor) -> torch.Tensor:
        """[B, 1 or 2, R, U] of the network, in the configuration's precision."""
        with torch.autocast(features.device.type, torch.bfloat16, enabled=self.config.precision == "bf16"):
            return self.network(features.contiguous(memory_format=torch.channels_last))

    @property
    def detects(self) -> bool:
        """Whether the network says where targets are."""
        return self.config.model == "unrolled" and self.config.detection > 0

    def detect(
        self, range_channel: torch.Tensor, noise_power: torch.Tensor, model_error_db: float = NO_MODEL_ERROR_DB
    ) -> tuple[torch.Tensor, torch.Tensor | None]:
        """([B, R, U] image, see :data:`trainer.run.targets.UNITS`; [B, R, U] probability of a target, or None).

        A network without a detection head has no such probability, but where its image is one.

        :param model_error_db: what calibration leaves of a plane wave, see :mod:`shared.signal.model_error`
        :raises InputError: a model error above 0 dB
        """
        features, scale = self.features(range_channel, noise_power, model_error_ratio(model_error_db))
        answer = self.answer(features)
        image = self.gain * decode(self.config, answer, scale)
        if self.detects:
            return image, answer[:, 1].float().sigmoid()
        return image, image if UNITS[self.config.target] == PROBABILITY else None

    def forward(
        self, range_channel: torch.Tensor, noise_power: torch.Tensor, model_error_db: float = NO_MODEL_ERROR_DB
    ) -> torch.Tensor:
        """[B, R, U] image of :meth:`detect`."""
        return self.detect(range_channel, noise_power, model_error_db)[0]
