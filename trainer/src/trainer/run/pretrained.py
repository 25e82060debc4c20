"""Runs that come with the package, for those who have data and no training."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

from shared.physics.errors import InputError, meant
from trainer.run.folder import RUN_FILE

FOLDER = Path(str(files("trainer.run"))) / "pretrained"


def pretrained_names() -> tuple[str, ...]:
    """The arrays that there are trained networks for."""
    return tuple(sorted(path.name for path in FOLDER.iterdir() if (path / RUN_FILE).is_file()))


def pretrained_run(name: str) -> Path:
    """The run folder of a network that comes with the package; its model card stands beside it.

    :raises InputError: no such network
    """
    known = pretrained_names()
    if name not in known:
        raise InputError("--pretrained", repr(name), f"one of {', '.join(known)}{meant(name, known)}")
    return FOLDER / name
