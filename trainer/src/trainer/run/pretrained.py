"""Runs that come with the package, for those who have data and no training. Help names them: nothing here computes."""

from __future__ import annotations

from pathlib import Path

from shared.physics.errors import InputError, meant

FOLDER = Path(__file__).with_name("pretrained")


def pretrained_names() -> tuple[str, ...]:
    """The arrays that there are trained networks for."""
    return tuple(sorted(path.name for path in FOLDER.iterdir() if path.is_dir()))


def pretrained_run(name: str) -> Path:
    """The run folder of a network that comes with the package; its model card stands beside it.

    :raises InputError: no such network
    """
    known = pretrained_names()
    if name not in known:
        raise InputError("--pretrained", repr(name), f"one of {', '.join(known)}{meant(name, known)}")
    return FOLDER / name


def run_or_pretrained(path: Path) -> Path:
    """A run's folder, by its path or by the name of a network that comes with the package."""
    return pretrained_run(str(path)) if str(path) in pretrained_names() and not path.is_dir() else path


def require_run(path: Path) -> None:
    """Refuse the name of a network in place of a run's folder, unless there is a folder of that name.

    :raises InputError: with the option that takes the name
    """
    if str(path) in pretrained_names() and not path.is_dir():
        raise InputError(path, "no such folder", f"a run folder made by trainer fit, or --pretrained {path}")
