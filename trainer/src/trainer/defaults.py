"""What options may be, and what they are by default: names alone, so that ``--help`` imports nothing that computes.

``tests/trainer/test_names.py`` holds registries to them.
"""

from __future__ import annotations

from typing import Literal

ESTIMATOR_NAMES = (
    "das", "das-hamming", "das-hann", "music", "iaa", "iaa-view", "likes-view", "likes-view-ego", "omp", "omp-cfar",
    "spice", "likes", "ml",
)  # fmt: skip
"""Of :data:`trainer.estimators.base.ESTIMATORS`."""
OF_MEASURED_ROWS = ("music-fbss", "line-fit")
"""Beside them, of :data:`trainer.evaluation.experiments.measured.METHODS`."""
NETWORKS = ("cnn", "unet")
"""Names in ``--methods`` that stand for the runs: direction-of-arrival networks, and networks of whole images."""
DEFAULT_METHODS = ("das", "music", "iaa", "omp")
"""Beside the networks of all runs."""
DEFAULT_ARRAYS = ("sparse6", "sparse4", "full")
EXPERIMENT_NAMES = (
    "point-spread", "street", "two-reflectors", "detection", "doppler", "resolution", "robustness", "generalisation",
    "noise-only", "tradeoff", "measured",
)  # fmt: skip
"""Of :data:`trainer.evaluation.evaluate.NAMES`."""

PEAKS, ALL = "peaks", "all"
CELLS = (PEAKS, ALL)
"""Of a frame: its three strongest Doppler peaks of every range bin, or what passes :mod:`trainer.data.cfar`."""
FALSE_ALARMS = 1.0
"""Expected lines of a frame of noise alone, by :mod:`trainer.run.false_alarms`."""
LEAST_FALSE_ALARMS = 1e-250
"""Of so few the level stays below what can be computed there, of any radar."""
FORMATS = ("parquet", "csv", "pcd")
"""Of lists of targets."""

Model = Literal["unrolled", "spectral-unet", "attention-unet", "doa-cnn"]
Features = Literal["snapshots", "adaptive", "paper", "covariance"]
Target = Literal["row", "paper", "class", "doa"]
Precision = Literal["32", "bf16"]

TENSORBOARD, NONE = "tensorboard", "none"
OTHERS = ("wandb", "mlflow")
"""Loggers whose packages, of the same names, are not installed with this one."""
LOGGERS = (TENSORBOARD, *OTHERS, NONE)
