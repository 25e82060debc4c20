"""The checkpoint of a run that is taken up, looked at before anything depends on it."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch

from shared.physics.errors import InputError

ENTRIES: dict[str, type] = {
    "state_dict": dict, "optimizer_states": list, "lr_schedulers": list, "loops": dict, "callbacks": dict,
    "epoch": int, "global_step": int, "batches_seen": int, "pytorch-lightning_version": str,
}  # fmt: skip
"""What Lightning and the task restore, by name."""
WANTED = "the last checkpoint of this run; without it the run begins anew in another folder"


def require_checkpoint(path: Path, state: Mapping[str, torch.Tensor]) -> None:
    """Refuse a checkpoint that is damaged or of something else.

    :param state: of the task that is to be restored
    :raises InputError: naming the file
    """
    try:
        with zipfile.ZipFile(path) as archive:  # torch does not look at the checksums that it writes
            if (piece := archive.testzip()) is not None:
                raise ValueError(f"{piece} is damaged")
        content: Any = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # torch raises whatever its zip reader and its unpickler come across
        raise not_restored(path, error) from error
    for name, kind in ENTRIES.items():
        if not isinstance(content, dict) or not isinstance(content.get(name), kind):
            raise InputError(path, f"has no {name}", WANTED)
    found = content["state_dict"]
    for name in sorted(state.keys() | found.keys(), key=str):
        shapes = [list(one[name].shape) if name in one else None for one in (_tensors(found), state)]
        if shapes[0] != shapes[1]:
            raise InputError(path, f"{name} has shape {shapes[0]}, the network has {shapes[1]}", WANTED)


def not_restored(path: Path, error: BaseException) -> InputError:
    """A checkpoint that cannot be read or restored, in one line."""
    lines = str(error).strip().splitlines()
    return InputError(path, f"not readable: {lines[0] if lines else type(error).__name__}", WANTED)


def _tensors(state: Mapping[Any, Any]) -> dict[Any, torch.Tensor]:
    return {name: value for name, value in state.items() if isinstance(value, torch.Tensor)}
