"""Measure ours against references, side by side in one run; print a table, write a file.

    python tests/benchmarks/bench.py [--quick] [--only NAME] [--out build/bench.json]

Everything runs on one thread unless its record says otherwise. References that would take hours run on a seeded sample,
and their records say so. The machine is described in a file beside the records.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated

import cubes
import decided
import devices
import images
import line_fits
import machine
import numba
import scipy.fft
import starts
import typer
from record import NotInstalledError, Record
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits
from workloads import FULL, QUICK, Size, Workload

from shared.physics.errors import InputError

BENCHMARKS: dict[str, Callable[[Workload], Record]] = {
    "cube_moving_vs_direct": cubes.moving_vs_direct,
    "cube_two_threads_vs_one": cubes.two_threads_vs_one,
    "cube_tolerance_1e-3_vs_1e-6": cubes.tolerance_1e_3,
    "cube_tolerance_1e-9_vs_1e-6": cubes.tolerance_1e_9,
    "cube_vs_chirps_1e-6": cubes.vs_chirps_1e_6,
    "cube_vs_chirps_1e-4": cubes.vs_chirps_1e_4,
    "truth_vs_exact": images.truth_vs_exact,
    "truth_synthesis_vs_cube": images.truth_synthesis_vs_cube,
    "cube_on_torch_vs_compiled": devices.cube_on_torch,
    "truth_on_torch_vs_compiled": devices.truth_on_torch,
    "cube_on_cuda_vs_compiled": devices.cube_on_cuda,
    "truth_on_cuda_vs_compiled": devices.truth_on_cuda,
    "lines_of_a_dense_frame_vs_omp_cfar": line_fits.dense_frame,
    "lines_of_192_channels_vs_omp_cfar": line_fits.wide_board,
    "datafactory_help_vs_numpy": starts.help_of_datafactory,
    "trainer_help_vs_numpy": starts.help_of_trainer,
    "first_frame_vs_numpy": starts.first_frame,
    "effects_auto_vs_all": decided.decided_frames,
    "two_workers_vs_one": starts.two_workers,
}


def run(size: Size, names: Sequence[str], out: Path, console: Console) -> list[Record]:
    """Run the named benchmarks, print them, and write ``out`` and the machine's file beside it.

    :raises InputError: an unknown name, or a file that cannot be written
    """
    unknown = [name for name in names if name not in BENCHMARKS]
    if unknown:
        raise InputError("--only", repr(unknown[0]), f"one of {', '.join(BENCHMARKS)}")
    work = Workload(size)
    records: list[Record] = []
    skipped: dict[str, str] = {}
    before = machine.description()
    numba.set_num_threads(1)
    with threadpool_limits(limits=1), scipy.fft.set_workers(1):
        for name in names:
            console.print(f"{name} ...", style="dim")
            try:
                records.append(BENCHMARKS[name](work))
            except NotInstalledError as reason:
                skipped[name] = str(reason)
                console.print(f"{name} skipped: {reason}")
    console.print(_table(records))
    load = machine.description()["load_average_1_5_15_min"]
    beside = {**before, "load_average_after": load, "size": size.name, "repeats": size.repeats, "skipped": skipped}
    _write(out, [record.to_json() for record in records])
    _write(out.with_name(f"{out.stem}-machine.json"), beside)
    return records


def _table(records: Sequence[Record]) -> Table:
    table = Table(title="ratio = reference / ours: above 1 ours is faster")
    for header in ("name", "ours", "reference", "ratio", "of CPU time", "error"):
        table.add_column(header, justify="left" if header == "name" else "right", overflow="fold")
    for record in records:
        seconds = [f"{time.seconds:.4g} s" for time in (record.ours_time, record.reference_time)]
        ratios = f"{record.ratio:.3g}", f"{record.cpu_ratio:.3g}"
        table.add_row(record.name, *seconds, *ratios, f"{record.error:.3g} {record.error_unit}")
    return table


def _write(path: Path, content: object) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(content, indent=2) + "\n")
    except OSError as error:
        raise InputError(
            "--out", f"{path} cannot be written ({error.strerror})", "a file in a writable folder"
        ) from None


def main(
    quick: Annotated[bool, typer.Option("--quick", help="Fewer paths and repeats: under a minute.")] = False,
    only: Annotated[list[str] | None, typer.Option("--only", help="Run this benchmark alone; may be repeated.")] = None,
    out: Annotated[Path, typer.Option(help="File of the records.")] = Path("build/bench.json"),
) -> None:
    """Measure ours against references."""
    try:
        run(QUICK if quick else FULL, only or list(BENCHMARKS), out, Console())
    except InputError as error:
        print(f"bench: {error}", file=sys.stderr)
        raise typer.Exit(2) from None


if __name__ == "__main__":
    typer.run(main)
