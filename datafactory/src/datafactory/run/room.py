"""Whether what was asked for fits on the disk, said before any work is done."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from datafactory.run.shards import FRAMES_PER_SHARD
from shared.dataset import row_bytes
from shared.dataset.locations import Location, RemotePath
from shared.physics.errors import InputError

COMPRESSED = 0.005
"""Share of its arrays' bytes that a frame needs on the disk at the very least: empty frames without noise take 0.007.
A run that this refuses cannot fit."""
STREETS, CLOSE_TARGETS = 0.82, 0.19
"""The same of frames with noise, in streets and of close targets."""


def free_bytes(directory: Location) -> int:
    """Free on the disk of a folder, or of the nearest above it that exists; for a remote one, where shards are made
    before they are sent."""
    if isinstance(directory, RemotePath):
        return shutil.disk_usage(tempfile.gettempdir()).free
    return shutil.disk_usage(
        next(folder for folder in (directory, *directory.absolute().parents) if folder.is_dir())
    ).free


def require_room(directory: Location, frames: int, shapes: Mapping[str, Any]) -> None:
    """Refuse a run whose shards cannot fit.

    :param directory: an existing folder on the disk that is meant, or a remote one, of which one shard stands here
    :param shapes: of the frames' arrays, by column
    :raises InputError: with both figures
    """
    least, free, disk = COMPRESSED * row_bytes(shapes), free_bytes(directory), directory
    if isinstance(directory, RemotePath):
        frames, disk = min(frames, FRAMES_PER_SHARD), Path(tempfile.gettempdir())
    if frames * least > free:
        fault = f"{frames} frames need at least {frames * least / 1e6:.0f} MB; {disk} has {free / 1e6:.0f} MB free"
        raise InputError("number of frames", fault, f"at most {int(free / least)}, or another disk")
