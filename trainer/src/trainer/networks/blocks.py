"""What the levels of the light U-Net are made of: residual blocks that keep channels and shape, [B, C, R, U]."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import nn
from torch.nn import functional

BRANCH_GAIN = 0.3
"""Initial scale of residual branches: without normalisation over pixels, which would tie a pixel to the whole image
(and a crop's result to where it was cut), the sum of branches must start near its skip."""
EXPANSION = 4
"""Channels within a ConvNeXt block over those outside."""


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


class ConvNextBlock(nn.Module):
    """A 7 x 7 convolution of each channel alone, then a dense layer pixel by pixel (Liu et al., "A ConvNet for the
    2020s", CVPR 2022): a wide view for few multiplications. The normalisation is over a pixel's channels."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.spread = nn.Conv2d(channels, channels, 7, padding=3, groups=channels)
        self.norm = nn.LayerNorm(channels)
        self.expand = nn.Conv2d(channels, EXPANSION * channels, 1)
        self.reduce = nn.Conv2d(EXPANSION * channels, channels, 1)
        with torch.no_grad():
            self.reduce.weight.mul_(BRANCH_GAIN)

    def forward(
        self, image: Float[torch.Tensor, "batch channels rows bins"]
    ) -> Float[torch.Tensor, "batch channels rows bins"]:
        seen = self.norm(self.spread(image).permute(0, 2, 3, 1)).permute(0, 3, 1, 2)
        return image + self.reduce(functional.gelu(self.expand(seen)))


BLOCKS: dict[str, type[nn.Module]] = {"convolution": ResidualBlock, "convnext": ConvNextBlock}
