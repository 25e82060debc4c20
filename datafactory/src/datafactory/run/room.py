"""Whether what was asked for fits on the disk, said before any work is done."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from shared.dataset import row_bytes
from shared.physics.errors import InputError

COMPRESSED = 0.25
"""Share of a frame's bytes that its shard needs at least. Street frames need 0.82 (``shards.py``), empty ones less; a
run that this refuses cannot fit by a wide margin."""


def require_room(directory: Path, frames: int, shapes: Mapping[str, Any]) -> None:
    """Refuse a run whose shards cannot fit.

    :param directory: an existing folder on the disk that is meant
    :param shapes: of the frames' arrays, by column
    :raises InputError: with both figures
    """
    least = COMPRESSED * row_bytes(shapes)
    free = shutil.disk_usage(directory).free
    if frames * least > free:
        fault = f"{frames} frames need at least {frames * least / 1e9:.0f} GB; {directory} has {free / 1e9:.0f} GB free"
        raise InputError("number of frames", fault, f"at most {int(free / least)}, or another disk")
