"""A dataset in another layout: the formats by name, and what a conversion says that it did."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeAlias

from shared.dataset.folder import Dataset
from shared.dataset.writing import atomic_folder
from shared.physics.errors import InputError, meant

Progress: TypeAlias = Callable[[int, int], None]
"""Takes frames done and frames in all."""
FORMATS = ("mcap",)


@dataclass(frozen=True)
class Converted:
    """What was written.

    :param frames: frames in the new layout
    :param notes: what has no place in it, with counts, and what was assumed
    """

    directory: Path
    frames: int
    notes: tuple[str, ...] = field(default=())


def convert(dataset: Dataset, to: str, out: Path, progress: Progress) -> Converted:
    """Write a dataset in another layout; the new folder is there once it is whole.

    :param to: one of :data:`FORMATS`
    :raises InputError: an unknown format, a folder that is there already, a package that is not installed
    """
    if to not in FORMATS:
        raise InputError("--to", f"{to!r}", f"one of {', '.join(FORMATS)}{meant(to, FORMATS)}")
    if out.exists():
        raise InputError("--out", f"{out} is there already", "a folder that does not exist yet")
    dataset.description()  # refuses a folder of traced paths
    try:
        import foxglove  # noqa: F401
    except ImportError as error:
        expected = "it: pip install 'sparseradar-datafactory[convert]'"
        raise InputError("--to mcap", "needs the package foxglove-sdk, which is not installed", expected) from error
    from datafactory.conversion.mcap import write_mcap

    with atomic_folder(out) as partial:
        frames, notes = write_mcap(dataset, partial, progress)
    return Converted(out, frames, notes)
