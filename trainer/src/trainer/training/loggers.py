"""Where the curves of a run go, beside its own ``metrics.csv``: ``--logger``."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

from lightning.pytorch.loggers import Logger, MLFlowLogger, TensorBoardLogger, WandbLogger

from shared.physics.errors import InputError, meant

TENSORBOARD, NONE = "tensorboard", "none"
OTHERS = ("wandb", "mlflow")
"""Loggers whose packages, of the same names, are not installed with this one."""
LOGGERS = (TENSORBOARD, *OTHERS, NONE)
PROJECT = "sparseradar"


def check_logger(name: str) -> None:
    """:raises InputError: no such logger, or a package that is not installed, with the command that installs it"""
    if name not in LOGGERS:
        raise InputError("--logger", repr(name), f"one of {', '.join(LOGGERS)}{meant(name, LOGGERS)}")
    if name in OTHERS and find_spec(name) is None:
        raise InputError("--logger", f"the package {name} is not installed", f"pip install {name}")


def make_logger(name: str, out: Path) -> Logger | bool:
    """The logger of a run, as Lightning takes it; False for none.

    :param name: one that :func:`check_logger` lets pass
    :param out: the run folder, where it keeps its files
    """
    if name == "wandb":
        return WandbLogger(save_dir=out, name=out.resolve().name, project=PROJECT)
    if name == "mlflow":
        return MLFlowLogger(PROJECT, run_name=out.resolve().name, save_dir=str(out / name))
    return TensorBoardLogger(out, name="", version=TENSORBOARD) if name == TENSORBOARD else False
