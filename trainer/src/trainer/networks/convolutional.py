"""Convolutional networks: U-Nets of images, [B, inputs, R, U] to [B, outputs, R, U], any R; and the paper's network of
one range bin.

A light U-Net says what neighbouring range bins know of each other. The spectral one has dense mixing along angle in
front of it, one range bin at a time: the ambiguities of a thinned array are not local, an alias stands anywhere in the
row, where no small convolution sees it together with its source. A dense layer along angle sees the whole row at once,
costs a matrix product, and is the same for every range bin. Where the input holds an estimate already, an adaptive
spectrum, both only correct it.

The attention U-Net is the paper's: Ronneberger 2015 with the gates of Oktay 2018 on its skip connections, four levels
of ``width`` 1, 2, 4, 8 (64, 128, 256, 512 in the paper). All parameters exist from construction and all are used: the
published code creates its gates at the first forward pass, after the optimiser, so that they never train.

The direction-of-arrival network that the paper compares with (Papageorgiou, Sellathurai, Eldar: Deep networks for
direction-of-arrival estimation in low SNR, IEEE TSP 2021) has four convolutions of 256 filters over the covariance
matrix, the first with stride 2, then dense layers of 4096, 2048 and 1024 units with dropout, and one output for every
angle of the grid. One range bin at a time, nothing beside it.
"""

from __future__ import annotations

from itertools import pairwise

import torch
from jaxtyping import Float
from torch import nn
from torch.nn import functional

Image = Float[torch.Tensor, "batch channels rows bins"]
LEVELS = 3
BRANCH_GAIN = 0.3
"""Initial scale of residual branches: without normalisation over pixels, which would tie a pixel to the whole image
(and a crop's result to where it was cut), the sum of branches must start near its skip."""
MIXED = 3
"""Images that the mixing hands to the U-Net; the first is an estimate that the U-Net corrects."""
ATTENTION_LEVELS = 4


class ResidualBlock(nn.Module):
    """Two 3 x 3 convolutions beside the identity."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.first = nn.Conv2d(channels, channels, 3, padding=1)
        self.second = nn.Conv2d(channels, channels, 3, padding=1)
        with torch.no_grad():
            self.second.weight.mul_(BRANCH_GAIN)

    def forward(self, image: Image) -> Image:
        return image + self.second(functional.gelu(self.first(image)))


class LightUNet(nn.Module):
    """[B, inputs, R, U] to [B, outputs, R, U], any R and U.

    :param width: channels of the first level, doubled at each of the two others
    :param stride: angle bins of the input to one of the first level; the last layer answers for each of them
    """

    def __init__(self, inputs: int, outputs: int, width: int, stride: int = 1) -> None:
        super().__init__()
        self.inputs, self.outputs, self.stride = inputs, outputs, stride
        sizes = [width * 2**level for level in range(LEVELS)]
        self.stem = nn.Conv2d(inputs, width, (3, stride + 2), stride=(1, stride), padding=1)
        self.encoder = nn.ModuleList(ResidualBlock(size) for size in sizes)
        # 2 x 2, not 1 x 1: the backward of a strided 1 x 1 convolution corrupts the heap (torch 2.13, channels_last).
        self.down = nn.ModuleList(nn.Conv2d(fine, coarse, 2, stride=2) for fine, coarse in pairwise(sizes))
        self.up = nn.ModuleList(
            nn.ConvTranspose2d(coarse, fine, 2, stride=2)
            for fine, coarse in zip(sizes[-2::-1], sizes[:0:-1], strict=True)
        )
        self.decoder = nn.ModuleList(ResidualBlock(size) for size in sizes[-2::-1])
        self.head = nn.Conv2d(width, stride * outputs, 1)

    def forward(
        self, features: Float[torch.Tensor, "batch {self.inputs} rows bins"]
    ) -> Float[torch.Tensor, "batch {self.outputs} rows bins"]:
        coarsest = 2 ** (LEVELS - 1)
        image = self.stem(pad_to_multiple(features, coarsest, self.stride * coarsest))
        skips: list[torch.Tensor] = []
        for level, encode in enumerate(self.encoder):
            image = encode(self.down[level - 1](skips[-1]) if level else image)
            skips.append(image)
        skips.pop()
        for up, decode in zip(self.up, self.decoder, strict=True):
            image = decode(up(image) + skips.pop())
        answer = self.head(image)  # (B, stride * outputs, R, U / stride)
        if self.stride > 1:
            batch, _, rows, bins = answer.shape
            answer = answer.reshape(batch, self.outputs, self.stride, rows, bins).permute(0, 1, 3, 4, 2).flatten(3)
        return crop_like(answer, features)


def pad_to_multiple(
    image: Image, rows: int, bins: int | None = None
) -> Float[torch.Tensor, "batch channels padded_rows padded_bins"]:
    """Zero-padded at the end of range and angle to multiples, the same for both by default; pixel (0, 0) stays."""
    height, width = image.shape[-2:]
    return functional.pad(image, (0, -width % (bins or rows), 0, -height % rows))


def crop_like(
    image: Float[torch.Tensor, "batch channels padded_rows padded_bins"],
    reference: Float[torch.Tensor, "batch features rows bins"],
) -> Float[torch.Tensor, "batch channels rows bins"]:
    """The part of ``image`` that :func:`pad_to_multiple` did not add to ``reference``."""
    return image[..., : reference.shape[-2], : reference.shape[-1]]


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

    :param outputs: 1 for regression, 2 for the two-class softmax (logits)
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

    def forward(self, gate: Image, skip: Image) -> Image:
        return skip * self.score(torch.relu(self.gate(gate) + self.skip(skip)))  # (B, C, R, U)


class AttentionUNet(nn.Module):
    """Attention U-Net, [B, inputs, R, U] to [B, outputs, R, U]; any R and U.

    :param outputs: 1 for regression, 2 for the two-class softmax (logits)
    :param width: channels of the first level, 64 in the paper
    """

    def __init__(self, inputs: int, outputs: int, width: int) -> None:
        super().__init__()
        self.inputs, self.outputs = inputs, outputs
        sizes = [width * 2**level for level in range(ATTENTION_LEVELS)]
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
        image = pad_to_multiple(features, 2 ** (ATTENTION_LEVELS - 1))
        skips = []
        for level, encode in enumerate(self.encoder):
            image = encode(self.pool(image) if level else image)
            skips.append(image)
        skips.pop()
        for up, gate, decode in zip(self.up, self.gates, self.decoder, strict=True):
            image = up(image)
            image = decode(torch.cat([gate(image, skips.pop()), image], dim=1))
        return crop_like(self.head(image), features)


DENSE = (16, 8, 4)
"""Units of the dense layers in multiples of the filters."""
DROPOUT = 0.3
LEAST_CHANNELS = 9
"""What four convolutions leave a value of."""


class DoaCnn(nn.Module):
    """[B, 3, R, C * C] covariances (:func:`shared.signal.features.covariance_channels`) to [B, 1, R, U] logits.

    :param channels: C of the array, at least :data:`LEAST_CHANNELS`
    :param width: filters of each convolution, 256 in the paper; the dense layers scale with it
    """

    def __init__(self, channels: int, bins: int, width: int) -> None:
        super().__init__()
        self.channels, self.bins = channels, bins
        layers: list[nn.Module] = []
        for inputs, size, stride in ((3, 3, 2), (width, 2, 1), (width, 2, 1), (width, 2, 1)):
            layers += [nn.Conv2d(inputs, width, size, stride), nn.BatchNorm2d(width), nn.ReLU()]
        self.convolutions = nn.Sequential(*layers)
        side = (channels - 3) // 2 + 1 - 3
        units = [max(side, 1) ** 2 * width, *(width * multiple for multiple in DENSE)]
        dense: list[nn.Module] = []
        for before, after in pairwise(units):
            dense += [nn.Linear(before, after), nn.ReLU(), nn.Dropout(DROPOUT)]
        self.dense = nn.Sequential(*dense, nn.Linear(units[-1], bins))

    def forward(
        self, features: Float[torch.Tensor, "batch 3 rows {self.channels**2}"]
    ) -> Float[torch.Tensor, "batch 1 rows {self.bins}"]:
        batch, planes, rows, _ = features.shape
        matrix = features.permute(0, 2, 1, 3).reshape(batch * rows, planes, self.channels, self.channels)
        answer = self.dense(self.convolutions(matrix).flatten(1))  # (B R, U)
        return answer.reshape(batch, 1, rows, -1)
