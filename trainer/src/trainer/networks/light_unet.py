"""A light U-Net over range and angle: what neighbouring range bins say of each other."""

from __future__ import annotations

from itertools import pairwise

import torch
from jaxtyping import Float
from torch import nn
from torch.nn import functional

LEVELS = 3
BRANCH_GAIN = 0.3
"""Initial scale of residual branches: without normalisation over pixels, which would tie a pixel to the whole image
(and a crop's result to where it was cut), the sum of branches must start near its skip."""


class ResidualBlock(nn.Module):
    """Two 3 x 3 convolutions beside the identity."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.first = nn.Conv2d(channels, channels, 3, padding=1)
        self.second = nn.Conv2d(channels, channels, 3, padding=1)
        with torch.no_grad():
            self.second.weight.mul_(BRANCH_GAIN)

    def forward(
        self, image: Float[torch.Tensor, "batch channels rows bins"]
    ) -> Float[torch.Tensor, "batch channels rows bins"]:
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
    image: Float[torch.Tensor, "batch channels rows bins"], rows: int, bins: int | None = None
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
