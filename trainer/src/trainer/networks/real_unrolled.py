"""The unrolled network in real arithmetic, for ONNX, which has neither complex numbers nor the inverse of a matrix.

The covariance A + j B becomes [[A, -B], [B, A]], symmetric and positive definite, and is inverted by Gauss-Jordan
sweeps without exchanging rows: of such a matrix every pivot is positive (Golub and Van Loan, Matrix Computations, 4.2).
The iterations are those of :mod:`shared.signal.adaptive`.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import nn

from shared.signal.adaptive import FLOOR, LEAST_POWER
from trainer.networks.unrolled import Iterate, UnrolledNetwork


class Parts(NamedTuple):
    """A complex tensor; its parts are named as a tensor's are."""

    real: torch.Tensor
    imag: torch.Tensor


class RealUnrolledNetwork(nn.Module):
    """The same answer as the network's whose weights and tables are used, to rounding."""

    def __init__(self, network: UnrolledNetwork) -> None:
        super().__init__()
        self.network = network
        for name in ("matched", "view"):
            table = network.get_buffer(name)
            self.register_buffer(f"{name}_real", table.real.contiguous(), persistent=False)
            self.register_buffer(f"{name}_imaginary", table.imag.contiguous(), persistent=False)

    def forward(
        self, snapshots: Float[torch.Tensor, "batch planes rows 1"]
    ) -> Float[torch.Tensor, "batch outputs rows bins"]:
        """See :class:`trainer.networks.unrolled.UnrolledNetwork`."""
        batch, planes, rows, _ = snapshots.shape
        channels = planes // 2
        row = snapshots[..., 0].transpose(1, 2).reshape(batch * rows, planes)
        snapshot, noise = Parts(row[:, :channels], row[:, channels : 2 * channels]), row[:, -1]
        parts = _times(snapshot, self._table("matched"))
        power = (parts.real.square() + parts.imag.square()) / channels**2
        for _ in range(self.network.plain):
            filtered, form = self._forms(power, snapshot, noise)
            power = (filtered.real.square() + filtered.imag.square()) / form.square()
        filtered, form = self._forms(power, snapshot, noise)
        seen = _times(Parts(power * filtered.real, power * filtered.imag), self._table("view"))
        magnitude = (seen.real.square() + seen.imag.square() + LEAST_POWER).sqrt() - LEAST_POWER**0.5
        found = Iterate(power, filtered, form, noise, (batch, rows, self.network.bins))
        for step in self.network.steps:
            power = self.network.stepped(found, step)
            filtered, form = self._forms(power, snapshot, noise)
            found = found._replace(power=power, filtered=filtered, form=form)
        return self.network.corrected(magnitude, found)

    def _forms(self, power: torch.Tensor, snapshot: Parts, noise: torch.Tensor) -> tuple[Parts, torch.Tensor]:
        """(q, s) [B, N], as :func:`shared.signal.adaptive.adaptive_forms` has them."""
        phases, pair = self.network.get_buffer("phases"), self.network.get_buffer("pair")
        cosine, sine = phases[0], phases[1]
        sign, sums = self.network.get_buffer("sign"), self.network.get_buffer("sums")
        channels = snapshot.real.shape[1]
        square = (-1, channels, channels)
        even = (power @ cosine.T)[:, pair].reshape(square)
        odd = -((power @ sine.T)[:, pair] * sign).reshape(square)
        total = power.sum(-1)
        white = torch.maximum(noise, FLOOR * total + FLOOR)
        both = torch.cat([torch.cat([even, -odd], dim=2), torch.cat([odd, even], dim=2)], dim=1)
        inverse = inverted(both + white[:, None, None] * torch.eye(2 * channels, dtype=both.dtype))
        weighted = (inverse @ torch.cat([snapshot.real, snapshot.imag], dim=1)[:, :, None])[:, :, 0]
        filtered = _times(Parts(weighted[:, :channels], weighted[:, channels:]), self._table("matched"))
        flat = inverse[:, :channels, :channels].reshape(-1, channels**2)
        odd_flat = inverse[:, channels:, :channels].reshape(-1, channels**2)
        form = (flat @ sums) @ cosine - ((odd_flat * sign) @ sums) @ sine
        return filtered, torch.maximum(form, (1.0 / (total + white))[:, None])

    def _table(self, name: str) -> Parts:
        return Parts(self.get_buffer(f"{name}_real"), self.get_buffer(f"{name}_imaginary"))


def inverted(matrix: Float[torch.Tensor, "batch n n"]) -> Float[torch.Tensor, "batch n n"]:
    """The inverses of symmetric positive definite matrices by Gauss-Jordan sweeps.

    A sweep k with pivot d = M_kk makes M_ij - M_ik M_kj / d off row and column k, M_kj / d in the row, -M_ik / d in the
    column and 1 / d at their crossing: M with column k replaced by that of the identity, less the product of column k
    and row k / d with their entries k replaced by d - 1 and 1 / d.
    """
    identity = torch.eye(matrix.shape[-1], dtype=matrix.dtype)
    for k in range(matrix.shape[-1]):
        unit = identity[k]
        column, row = matrix[:, :, k : k + 1], matrix[:, k : k + 1, :]
        pivot = matrix[:, k : k + 1, k : k + 1]
        row = (row * (1.0 - unit) + unit) / pivot
        matrix = matrix * (1.0 - unit) + unit[:, None] * unit - (column - unit[:, None]) * row
    return matrix


def _times(left: Parts, right: Parts) -> Parts:
    """A complex matrix product."""
    return Parts(
        left.real @ right.real - left.imag @ right.imag,
        left.real @ right.imag + left.imag @ right.real,
    )
