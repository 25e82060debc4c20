"""The machine that a benchmark ran on: what it is, and the rates that nothing on it can exceed."""

from __future__ import annotations

import os
import platform
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
import psutil
from record import timed
from threadpoolctl import threadpool_info

PACKAGES = ("numpy", "scipy", "numba", "finufft", "sionna-rt", "mitsuba", "drjit", "sparseradar-datafactory")


@cache
def gemm_flops_per_second(size: int) -> float:
    """Rate of a square complex64 matrix product, 8 operations a multiply-add, by processor time [1/s]."""
    generator = np.random.default_rng(0)
    left, right = (
        generator.standard_normal((size, size, 2), dtype=np.float32).view(np.complex64)[..., 0] for _ in "lr"
    )
    out = np.empty((size, size), dtype=np.complex64)
    np.matmul(left, right, out=out)
    elapsed, _ = timed(lambda: np.matmul(left, right, out=out), 3)
    return 8.0 * size**3 / elapsed.cpu_seconds


@cache
def copy_bytes_per_second(megabytes: int) -> float:
    """Rate of a copy of a block much larger than the caches, bytes read plus bytes written, by processor time [1/s]."""
    source = np.ones(megabytes * 1_000_000 // 8)
    target = np.empty_like(source)
    np.copyto(target, source)
    elapsed, _ = timed(lambda: np.copyto(target, source), 5)
    return 2.0 * source.nbytes / elapsed.cpu_seconds


def description() -> dict[str, Any]:
    """Hardware, versions and load, for the file beside the records."""
    return {
        "processor": _processor(),
        "cores": os.cpu_count(),
        "memory_gb": round(psutil.virtual_memory().total / 1e9, 1),
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "blas": sorted({f"{pool['internal_api']} {pool['version']}" for pool in threadpool_info() if pool["version"]}),
        "versions": {name: _version(name) for name in PACKAGES},
        "load_average_1_5_15_min": [round(load, 2) for load in psutil.getloadavg()],
    }


def _processor() -> str:
    information = Path("/proc/cpuinfo")
    if information.is_file():
        for line in information.read_text().splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or "unknown"


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"
