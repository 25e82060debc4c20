"""What every kernel on the device starts from: arrays moved there, phasors, sums whose order is fixed, and
the lengths of paths' legs in float64, which eq. (2) needs at any time.

This package is the only one of ours that imports torch, which is an extra of its own. Nothing imports it before a
device was asked for (:mod:`datafactory.synthesis.cube`). All of it runs on torch's ``"cpu"`` as well, which is how
the tests hold it to the same bounds as the compiled kernels where there is no GPU.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Complex, Complex128, Float64, Shaped
from numpy.typing import NDArray
from torch import Tensor

from datafactory.paths.table import ScatteredPaths

VALUES_AT_ONCE = {"cpu": 2**17, "cuda": 2**25}
"""Complex numbers that a step holds at a time: on the processor what its cache has room for, on a GPU enough to fill
it (0.25 GB in complex64). Sums are taken in this order, so that it is a part of the bytes."""
CUBLAS_VARIABLE, CUBLAS_WORKSPACE = "CUBLAS_WORKSPACE_CONFIG", ":4096:8"
"""Without a fixed workspace cuBLAS chooses among sums of different order, and torch refuses to call it repeatable."""


@contextmanager
def repeatable() -> Iterator[None]:
    """The same bytes from the same arrays, run after run, on a GPU too; float32 products in float32.

    ``index_add_`` on CUDA adds with atomics, in whichever order threads arrive. torch's deterministic mode sorts the
    targets first, and adds what falls to one of them in its order.
    """
    os.environ.setdefault(CUBLAS_VARIABLE, CUBLAS_WORKSPACE)
    before, warned = torch.are_deterministic_algorithms_enabled(), torch.is_deterministic_algorithms_warn_only_enabled()
    mode: Any = torch.utils.deterministic
    filled, precision = mode.fill_uninitialized_memory, torch.get_float32_matmul_precision()
    torch.use_deterministic_algorithms(True)
    mode.fill_uninitialized_memory = False  # nothing here reads what it has not written
    torch.set_float32_matmul_precision("highest")
    try:
        with torch.inference_mode():
            yield
    finally:
        torch.set_float32_matmul_precision(precision)
        mode.fill_uninitialized_memory = filled
        torch.use_deterministic_algorithms(before, warn_only=warned)


def moved(array: Shaped[np.ndarray, "*shape"], device: str) -> Shaped[Tensor, "*shape"]:
    """A NumPy array on the device, of the same type."""
    return torch.tensor(np.ascontiguousarray(array), device=device)


def back(values: Shaped[Tensor, "*shape"]) -> NDArray:
    """The same as a NumPy array."""
    return values.cpu().numpy()


def real_of(dtype: torch.dtype) -> torch.dtype:
    """The real type of a complex one."""
    return torch.float32 if dtype == torch.complex64 else torch.float64


def phasors(cycles: Float64[Tensor, "*shape"], dtype: torch.dtype) -> Complex[Tensor, "*shape"]:
    """exp(j 2 pi ``cycles``), reduced modulo one cycle in float64 before it is rounded (:mod:`shared.physics.cycles`).

    :param dtype: torch.complex64 or torch.complex128
    """
    angle = (2.0 * torch.pi * (cycles - torch.floor(cycles + 0.5))).to(real_of(dtype))
    return torch.polar(torch.ones_like(angle), angle)


def batches(count: int, values_each: int, device: str) -> Iterator[slice]:
    """Slices of ``count`` items, each of so many complex numbers, that a step may hold at a time."""
    size = max(VALUES_AT_ONCE[torch.device(device).type] // max(values_each, 1), 1)
    for first in range(0, count, size):
        yield slice(first, min(first + size, count))


def cuda_problem() -> str | None:
    """Why torch cannot use a CUDA device, in words; None if it can."""
    if torch.version.cuda is None:
        return f"torch {torch.__version__} is built without CUDA"
    if not torch.cuda.is_available():
        return f"torch {torch.__version__} for CUDA {torch.version.cuda} finds no usable device"
    return None


@dataclass(frozen=True)
class Echoes:
    """Scattered paths on the device; fields as those of :class:`datafactory.paths.table.ScatteredPaths`."""

    tx_point: Float64[Tensor, "paths 3"]
    rx_point: Float64[Tensor, "paths 3"]
    tx_velocity: Float64[Tensor, "paths 3"]
    rx_velocity: Float64[Tensor, "paths 3"]
    between_m: Float64[Tensor, " paths"]
    between_rate_mps: Float64[Tensor, " paths"]
    amplitude: Complex128[Tensor, " paths"]

    @staticmethod
    def of(paths: ScatteredPaths, device: str) -> Echoes:
        """The paths of a table on the device."""
        return Echoes(**{name: moved(getattr(paths, name), device) for name in Echoes.__dataclass_fields__})

    def __len__(self) -> int:
        return len(self.amplitude)

    def take(self, some: slice) -> Echoes:
        """Some of the paths."""
        return Echoes(**{name: getattr(self, name)[some] for name in self.__dataclass_fields__})

    def at(
        self, times: Float64[Tensor, " times"]
    ) -> tuple[Float64[Tensor, "paths times 3"], Float64[Tensor, "paths times 3"], Float64[Tensor, "paths times"]]:
        """The points as TX and RX see them at these times [s], and the length between [m]."""
        apart = times[:, None]
        return (
            self.tx_point[:, None] + self.tx_velocity[:, None] * apart,
            self.rx_point[:, None] + self.rx_velocity[:, None] * apart,
            self.between_m[:, None] + self.between_rate_mps[:, None] * times,
        )


def distances(
    points: Float64[Tensor, "paths times 3"], elements: Float64[np.ndarray, "elements 3"]
) -> Float64[Tensor, "paths times elements"]:
    """Lengths of the legs between points and elements [m]."""
    place = moved(elements, str(points.device))
    squares = (points[..., 0, None] - place[:, 0]) ** 2
    for axis in (1, 2):
        squares += (points[..., axis, None] - place[:, axis]) ** 2
    return squares.sqrt_()
