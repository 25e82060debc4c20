"""Dense mixing along angle, one range bin at a time, before a light U-Net.

The ambiguities of a thinned array are not local: an alias stands anywhere in the row, where no small convolution sees
it together with its source. A dense layer along angle sees the whole row at once, costs a matrix product, and is the
same for every range bin. The U-Net behind it uses what neighbouring range bins say. Where the input holds an estimate
already, an adaptive spectrum, both only correct it.
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import nn
from torch.nn import functional

from trainer.networks.light_unet import LightUNet

MIXED = 3
"""Images that the mixing hands to the U-Net; the first is an estimate that the U-Net corrects."""


class AngularMixing(nn.Module):
    """[B, F, R, U] to [B, outputs, R, U] by a dense network along angle, the same for every range bin."""

    def __init__(self, inputs: int, bins: int, hidden: int, outputs: int) -> None:
        super().__init__()
        self.inputs, self.bins, self.outputs = inputs, bins, outputs
        self.project = nn.Linear(inputs * bins, hidden)
        self.mix = nn.Linear(hidden, hidden)
        self.expand = nn.Linear(hidden, outputs * bins)

    def forward(
        self, features: Float[torch.Tensor, "batch {self.inputs} rows {self.bins}"]
    ) -> Float[torch.Tensor, "batch {self.outputs} rows {self.bins}"]:
        batch, channels, rows, bins = features.shape
        row = features.permute(0, 2, 1, 3).reshape(batch, rows, channels * bins)
        row = functional.gelu(self.project(row))
        row = row + functional.gelu(self.mix(row))  # (B, R, hidden)
        return self.expand(row).reshape(batch, rows, self.outputs, bins).permute(0, 2, 1, 3)


class SpectralUNet(nn.Module):
    """Angular mixing and a light U-Net, [B, inputs, R, U] to [B, outputs, R, U]; any R, a fixed U.

    :param inputs: feature channels
    :param outputs: 1 for regression, 2 for the two-class softmax (logits)
    :param bins: U, angle bins
    :param width: channels of the U-Net's first level, doubled at each of the two others
    :param hidden: units of the mixing
    :param start: the input channel that is an estimate already, to which the network's answer is added; None if none is
    """

    def __init__(
        self,
        inputs: int,
        outputs: int,
        bins: int,
        width: int,
        hidden: int,
        start: int | None = None,
    ) -> None:
        super().__init__()
        self.inputs, self.bins, self.outputs, self.start = inputs, bins, outputs, start
        self.mixing = AngularMixing(inputs, bins, hidden, max(MIXED, outputs))
        self.context = LightUNet(inputs + max(MIXED, outputs), outputs, width)

    def forward(
        self, features: Float[torch.Tensor, "batch {self.inputs} rows {self.bins}"]
    ) -> Float[torch.Tensor, "batch {self.outputs} rows {self.bins}"]:
        mixed = self.mixing(features)
        answer = mixed[:, : self.outputs] + self.context(torch.cat([features, mixed], dim=1))
        return answer if self.start is None else answer + features[:, self.start : self.start + 1]
