"""What made a dataset: the part of the manifest that may differ between equal runs."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from datetime import UTC, datetime
from importlib.metadata import version
from importlib.util import find_spec
from typing import Any

from datafactory.defaults import CPU
from datafactory.paths.backend import cuda_device

PACKAGES = (
    "sparseradar-shared",
    "sparseradar-datafactory",
    "sionna-rt",
    "mitsuba",
    "drjit",
    "numpy",
    "numba",
    "pyarrow",
)


def provenance(
    engine: str, workers: int, seconds: float, step_seconds: Mapping[str, float], device: str = CPU
) -> dict[str, Any]:
    """The manifest's ``made``.

    :param engine: that made the shards, see :mod:`datafactory.run.engines`
    :param workers: its processes; 0 on a cluster for all that its nodes had
    :param seconds: wall-clock seconds of the run
    :param step_seconds: seconds of each step of the chain, added over the workers
    :param device: of the run; a GPU is named
    """
    packages: tuple[str, ...] = PACKAGES
    gpu = dict[str, str]()
    if device != CPU:
        gpu = {"gpu": cuda_device().name}
        packages += ("torch",) if find_spec("torch") else ()
    return {
        **gpu,
        "finished": datetime.now(UTC).isoformat(timespec="seconds"),
        "host": platform.node(),
        "machine": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "versions": {name: version(name) for name in packages},
        "engine": engine,
        "workers": workers,
        "seconds": round(seconds, 1),
        "step_seconds": {name: round(value, 1) for name, value in sorted(step_seconds.items())},
    }
