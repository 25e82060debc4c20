"""The devices that torch's kernels are tested on: the processor always, a GPU where there is one."""

from __future__ import annotations

import pytest

EVERY_DEVICE = ("cpu", pytest.param("cuda", marks=pytest.mark.gpu))
"""For ``pytest.mark.parametrize("device", ...)``, with :func:`required` at the start of the test."""


def required(device: str) -> str:
    """The device, or a skip that says why it is not there."""
    if device == "cuda":
        from datafactory.synthesis.cube import synthesis_problem

        if (problem := synthesis_problem()) is not None:
            pytest.skip(f"no CUDA device: {problem}")
    return device
