"""Which device a command takes: what was asked for, or what is there.

The device is chosen once, before anything is made, and is one of the arguments that determine the bytes. A run that is
resumed on another device is therefore refused, also where ``auto`` finds another one than before.
"""

from __future__ import annotations

from datafactory.defaults import AUTO_DEVICE, CPU, CUDA, INSTALL_TORCH
from datafactory.paths.backend import cuda_device
from datafactory.synthesis.cube import synthesis_problem
from shared.physics.errors import InputError


def device_of(asked: str, tracing: bool, synthesis: bool) -> str:
    """``"cpu"`` or ``"cuda"``.

    :param asked: one of :data:`datafactory.defaults.ASKED_DEVICES`; ``"auto"`` is CUDA where it can be used
    :param tracing: whether rays are to be traced on it, which needs OptiX
    :param synthesis: whether signals are to be made on it, which needs torch
    :raises InputError: CUDA was asked for and something that it needs is missing
    """
    if asked == CPU:
        return CPU
    found = _lacking(tracing, synthesis)
    if found is None:
        return CUDA
    if asked == AUTO_DEVICE:
        return CPU
    problem, remedy = found
    raise InputError("--device", f"{asked}: {problem}", remedy)


def _lacking(tracing: bool, synthesis: bool) -> tuple[str, str] | None:
    """What CUDA lacks, and what would be right."""
    device = cuda_device()
    if device.problem and (tracing or not device.name):
        return device.problem, device.remedy
    problem = synthesis_problem() if synthesis else None
    return None if problem is None else (problem, f"{INSTALL_TORCH}; or --device cpu")
