"""Measure ours against references, side by side in one run; print a table, write a file.

    python tests/benchmarks/bench.py [--quick] [--only NAME] [--out build/bench.json]

Everything runs on one thread unless its record says otherwise. References that would take hours run on a seeded sample,
and their records say so. The machine is described in a file beside the records.
"""

import json
import os
import platform
import sys
from collections.abc import Callable, Sequence
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any

import numba
import psutil
import scipy.fft
import typer
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_info, threadpool_limits

sys.path.append(str(Path(__file__).resolve().parents[1]))

import cubes
import images
import predicted
from record import NotInstalledError, Record
from workloads import FULL, QUICK, Size, Workload

PACKAGES = ("numpy", "scipy", "numba", "sionna-rt", "mitsuba", "drjit", "sparseradar-datafactory")
BENCHMARKS: dict[str, Callable[[Workload], Record]] = {
    "cube_moving_vs_direct": cubes.moving_vs_direct,
    "cube_vs_chirps_1e-6": partial(cubes.vs_chirps, tolerance="1e-6"),
    "cube_vs_chirps_1e-4": partial(cubes.vs_chirps, tolerance="1e-4"),
    "truth_vs_exact": images.truth_vs_exact,
    "cube_on_torch_vs_compiled": partial(cubes.cube_on, device="cpu"),
    "truth_on_torch_vs_compiled": partial(cubes.truth_on, device="cpu"),
    "cube_on_cuda_vs_compiled": partial(cubes.cube_on, device="cuda"),
    "truth_on_cuda_vs_compiled": partial(cubes.truth_on, device="cuda"),
    "images_of_a_frame_vs_omp_cfar": partial(predicted.one_frame, points=False),
    "images_and_points_of_a_frame_vs_omp_cfar": partial(predicted.one_frame, points=True),
}


def run(size: Size, names: Sequence[str], out: Path, console: Console) -> list[Record]:
    """Run the named benchmarks, print them, and write ``out`` and the machine's file beside it."""
    work = Workload(size)
    records: list[Record] = []
    skipped: dict[str, str] = {}
    before = machine()
    numba.config.NUMBA_NUM_THREADS = 1
    with threadpool_limits(limits=1), scipy.fft.set_workers(1):
        for name in names:
            console.print(f"{name} ...", style="dim")
            try:
                records.append(BENCHMARKS[name](work))
            except NotInstalledError as reason:
                skipped[name] = str(reason)
                console.print(f"{name} skipped: {reason}")
    console.print(_table(records))
    load = machine()["load_average_1_5_15_min"]
    beside = {**before, "load_average_after": load, "size": size.name, "repeats": size.repeats, "skipped": skipped}
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(json.dumps([record.to_json() for record in records], indent=2) + "\n")
    out.with_name(f"{out.stem}-machine.json").write_text(json.dumps(beside, indent=2) + "\n")
    return records


def machine() -> dict[str, Any]:
    """Hardware, versions and load, for the file beside the records."""
    information = Path("/proc/cpuinfo")
    lines = information.read_text().splitlines() if information.is_file() else []
    models = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return {
        "processor": models[0] if models else platform.processor() or "unknown",
        "cores": os.cpu_count(),
        "memory_gb": round(psutil.virtual_memory().total / 1e9, 1),
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "blas": sorted({f"{pool['internal_api']} {pool['version']}" for pool in threadpool_info() if pool["version"]}),
        "versions": {name: version(name) for name in PACKAGES},
        "load_average_1_5_15_min": [round(load, 2) for load in psutil.getloadavg()],
    }


def _table(records: Sequence[Record]) -> Table:
    table = Table(title="ratio = reference / ours: above 1 ours is faster")
    for header in ("name", "ours", "reference", "ratio", "of CPU time", "error"):
        table.add_column(header, justify="left" if header == "name" else "right", overflow="fold")
    for record in records:
        seconds = [f"{time.seconds:.4g} s" for time in (record.ours_time, record.reference_time)]
        ratios = f"{record.ratio:.3g}", f"{record.cpu_ratio:.3g}"
        table.add_row(record.name, *seconds, *ratios, f"{record.error:.3g} {record.error_unit}")
    return table


def main(
    quick: Annotated[bool, typer.Option("--quick", help="Fewer paths and repeats: under a minute.")] = False,
    only: Annotated[list[str] | None, typer.Option("--only", help="Run this benchmark alone; may be repeated.")] = None,
    out: Annotated[Path, typer.Option(help="File of the records.")] = Path("build/bench.json"),
) -> None:
    """Measure ours against references."""
    unknown = [name for name in only or () if name not in BENCHMARKS]
    if unknown:
        raise typer.BadParameter(f"{unknown[0]!r}; expected one of {', '.join(BENCHMARKS)}", param_hint="--only")
    run(QUICK if quick else FULL, only or list(BENCHMARKS), out, Console())


if __name__ == "__main__":
    typer.run(main)
