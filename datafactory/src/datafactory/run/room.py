"""Whether what was asked for fits on the disk, said before any work is done."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from shared.dataset import row_bytes
from shared.physics.errors import InputError

COMPRESSED = 0.005
"""Share of its arrays' bytes that a frame needs on the disk at the very least: empty frames without noise take 0.007.
A run that this refuses cannot fit."""
STREETS, CLOSE_TARGETS = 0.82, 0.19
"""The same of frames with noise, in streets and of close targets."""


def free_bytes(directory: Path) -> int:
    """Free on the disk of a folder, or of the nearest above it that exists."""
    return shutil.disk_usage(
        next(folder for folder in (directory, *directory.absolute().parents) if folder.is_dir())
    ).free


def require_room(directory: Path, frames: int, shapes: Mapping[str, Any]) -> None:
    """Refuse a run whose shards cannot fit.

    :param directory: an existing folder on the disk that is meant
    :param shapes: of the frames' arrays, by column
    :raises InputError: with both figures
    """
    least, free = COMPRESSED * row_bytes(shapes), free_bytes(directory)
    if frames * least > free:
        fault = f"{frames} frames need at least {frames * least / 1e6:.0f} MB; {directory} has {free / 1e6:.0f} MB free"
        raise InputError("number of frames", fault, f"at most {int(free / least)}, or another disk")
