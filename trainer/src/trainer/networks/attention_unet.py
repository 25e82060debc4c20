"""The paper's network: a U-Net (Ronneberger 2015) with attention gates (Oktay 2018) on its skip connections.

Four levels of ``width`` 1, 2, 4, 8; the paper's is 64, 128, 256, 512. All parameters exist from construction and all
are used: the published code creates its gates at the first forward pass, after the optimiser, so that they never train.
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import nn

from trainer.networks.light_unet import crop_like, pad_to_multiple

LEVELS = 4


def _convolution(inputs: int, outputs: int, size: int) -> list[nn.Module]:
    # The convolution needs no bias: the normalisation adds a shift of its own.
    return [nn.Conv2d(inputs, outputs, size, padding=size // 2, bias=False), nn.BatchNorm2d(outputs)]


def _double_convolution(inputs: int, outputs: int) -> nn.Sequential:
    first, second = _convolution(inputs, outputs, 3), _convolution(outputs, outputs, 3)
    return nn.Sequential(*first, nn.ReLU(inplace=True), *second, nn.ReLU(inplace=True))


class AttentionGate(nn.Module):
    """Additive attention: the coarser level decides which pixels of the skip connection pass (Oktay, eq. (1), (2)).

    :param channels: of the skip connection and of the gating signal, both at the skip's resolution
    """

    def __init__(self, channels: int) -> None:
        super().__init__()
        inner = max(1, channels // 2)
        self.gate = nn.Sequential(*_convolution(channels, inner, 1))
        self.skip = nn.Sequential(*_convolution(channels, inner, 1))
        self.score = nn.Sequential(nn.Conv2d(inner, 1, 1), nn.Sigmoid())

    def forward(
        self,
        gate: Float[torch.Tensor, "batch channels rows bins"],
        skip: Float[torch.Tensor, "batch channels rows bins"],
    ) -> Float[torch.Tensor, "batch channels rows bins"]:
        return skip * self.score(torch.relu(self.gate(gate) + self.skip(skip)))  # (B, C, R, U)


class AttentionUNet(nn.Module):
    """Attention U-Net, [B, inputs, R, U] to [B, outputs, R, U]; any R and U.

    :param inputs: feature channels
    :param outputs: 1 for regression, 2 for the two-class softmax (logits)
    :param width: channels of the first level, 64 in the paper
    """

    def __init__(self, inputs: int, outputs: int = 1, width: int = 64) -> None:
        super().__init__()
        self.inputs, self.outputs = inputs, outputs
        sizes = [width * 2**level for level in range(LEVELS)]
        self.encoder = nn.ModuleList(
            _double_convolution(before, after) for before, after in zip([inputs, *sizes[:-1]], sizes, strict=True)
        )
        self.pool = nn.MaxPool2d(2)
        finer = list(zip(sizes[:0:-1], sizes[-2::-1], strict=True))
        self.up = nn.ModuleList(
            nn.Sequential(nn.Upsample(scale_factor=2), *_convolution(coarse, fine, 3), nn.ReLU(inplace=True))
            for coarse, fine in finer
        )
        self.gates = nn.ModuleList(AttentionGate(fine) for _, fine in finer)
        self.decoder = nn.ModuleList(_double_convolution(2 * fine, fine) for _, fine in finer)
        self.head = nn.Conv2d(width, outputs, 1)

    def forward(
        self, features: Float[torch.Tensor, "batch {self.inputs} rows bins"]
    ) -> Float[torch.Tensor, "batch {self.outputs} rows bins"]:
        image = pad_to_multiple(features, 2 ** (LEVELS - 1))
        skips = []
        for level, encode in enumerate(self.encoder):
            image = encode(self.pool(image) if level else image)
            skips.append(image)
        skips.pop()
        for up, gate, decode in zip(self.up, self.gates, self.decoder, strict=True):
            image = up(image)
            image = decode(torch.cat([gate(image, skips.pop()), image], dim=1))
        return crop_like(self.head(image), features)
