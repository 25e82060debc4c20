"""The direction-of-arrival network that the paper compares with.

Papageorgiou, Sellathurai, Eldar: Deep networks for direction-of-arrival estimation in low SNR, IEEE TSP 2021. Four
convolutions of 256 filters over the covariance matrix, the first with stride 2, then dense layers of 4096, 2048 and
1024 units with dropout, and one output for every angle of the grid. One range bin at a time, nothing beside it.
"""

from __future__ import annotations

from itertools import pairwise

import torch
from jaxtyping import Float
from torch import nn

FILTERS = 256
DENSE = (16, 8, 4)
"""Units of the dense layers in multiples of the filters."""
DROPOUT = 0.3
LEAST_CHANNELS = 9
"""What four convolutions leave a value of."""


class DoaCnn(nn.Module):
    """[B, 3, R, C * C] covariances (:func:`shared.signal.features.covariance_channels`) to [B, 1, R, U] logits.

    :param channels: C of the array, at least :data:`LEAST_CHANNELS`
    :param bins: U, angles of the grid
    :param width: filters of each convolution, 256 in the paper; the dense layers scale with it
    """

    def __init__(self, channels: int, bins: int, width: int = FILTERS) -> None:
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
