"""What made a dataset: the part of the manifest that may differ between equal runs."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from datetime import UTC, datetime
from importlib.metadata import version
from typing import Any

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


def provenance(engine: str, workers: int, seconds: float, step_seconds: Mapping[str, float]) -> dict[str, Any]:
    """The manifest's ``made``.

    :param engine: that made the shards, see :mod:`datafactory.run.engines`
    :param workers: its processes; 0 on a cluster for all that its nodes had
    :param seconds: wall-clock seconds of the run
    :param step_seconds: seconds of each step of the chain, added over the workers
    """
    return {
        "finished": datetime.now(UTC).isoformat(timespec="seconds"),
        "host": platform.node(),
        "machine": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "versions": {name: version(name) for name in PACKAGES},
        "engine": engine,
        "workers": workers,
        "seconds": round(seconds, 1),
        "step_seconds": {name: round(value, 1) for name, value in sorted(step_seconds.items())},
    }
