"""Whether an exported network answers as in double precision, or as near to it as torch in single precision.

Strong echoes leave a covariance that is nearly singular: of the "unrolled" networks of the package torch and
onnxruntime both err by up to 1 % of the answer's maximum at 40 dB, at other angles each, and by 1e-5 on noise. No fixed
bound is right for both, and rows of noise alone would show no fault of the graph that only echoes meet.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from shared.radar import Radar

NOISE, SNR_DB, MOST_TARGETS = "noise", (20.0, 40.0), 4
"""Rows that are compared: without a target, and with 1 to 4 of these SNR in each channel."""
TOLERANCE, ROUNDINGS = 1e-4, 5.0
"""An error may be that much of the maximum and so many times torch's. On 16 images of targets the largest errors of
onnxruntime were 0.3 to 2.5 times torch's; on noise both stay below 1e-5 (``trainer export sparse6 --out sparse6.onnx``
states those of its rows; the 16 by a trial script, 2026-11-28)."""


@dataclass(frozen=True)
class Errors:
    """The largest differences from the network in double precision, relative to its largest value.

    :param rows: which were compared
    """

    rows: str
    onnx: float
    torch: float

    @property
    def agree(self) -> bool:
        """False for numbers that are not finite, too."""
        return self.onnx <= ROUNDINGS * self.torch + TOLERANCE

    def __str__(self) -> str:
        return f"on {self.rows} onnxruntime errs by {self.onnx:.1e} of the maximum, torch by {self.torch:.1e}"


def checked_rows(radar: Radar) -> dict[str, NDArray[np.complex64]]:
    """[1, R, C] range-channel matrices in noise of power 1, by what they hold; always the same."""
    generator, bins = np.random.default_rng(0), radar.waveform.range_bins
    grid, places = radar.grid, radar.array.virtual[:, 1] / radar.waveform.wavelength_m
    made = {}
    for snr_db in (None, *SNR_DB):
        rows = generator.standard_normal((1, bins, len(places), 2)) @ [np.sqrt(0.5), 1j * np.sqrt(0.5)]
        for target in range(0 if snr_db is None else MOST_TARGETS):
            u, turn = generator.uniform(grid.u_start, grid.u_stop, bins), generator.random(bins)
            amplitude = 10.0 ** ((snr_db or 0.0) / 20.0) * (np.arange(bins) % MOST_TARGETS >= target)
            rows += amplitude[:, None] * np.exp(2j * np.pi * (turn[:, None] - np.outer(u, places)))
        made[NOISE if snr_db is None else f"targets at {snr_db:g} dB"] = rows.astype(np.complex64)
    return made


def in_double(network: nn.Module) -> nn.Module:
    """A copy in double precision, of the same weights and tables."""
    copied = copy.deepcopy(network).double()  # which leaves complex tables as they are
    for name, table in list(copied.named_buffers()):
        if table.is_complex():
            owner, _, leaf = name.rpartition(".")
            copied.get_submodule(owner).register_buffer(leaf, table.to(torch.complex128), persistent=False)
    return copied


def errors_of(
    rows: str, features: torch.Tensor, network: nn.Module, onnx: Callable[[torch.Tensor], NDArray[np.float32]]
) -> Errors:
    """How far both are from double precision.

    :param rows: what is compared
    :param onnx: the exported network
    """
    with torch.inference_mode():
        exact = in_double(network)(features.double()).numpy()
        single = network(features).numpy()
    most = max(float(np.abs(exact).max()), 1e-30)
    return Errors(rows, *(float(np.abs(found - exact).max()) / most for found in (onnx(features), single)))
