"""How long the command lines take to begin, beside a fresh interpreter that imports NumPy, in turn.

Times are those of child processes; a start is mostly imports, so that the ratio says how many of NumPy's it is.
"""

from __future__ import annotations

import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from record import Record, Timing
from workloads import Workload

TINY_SCENE = Path(__file__).resolve().parents[2] / "scenes" / "tiny.usda"
NUMPY = ("import numpy",)
EXIT_STATUS = "exit status"


def help_of(work: Workload, program: str) -> Record:
    """``datafactory --help`` or ``trainer --help``."""
    return _beside_numpy(work, f"{program}_help_vs_numpy", f"{program} --help", program_of(program, "--help"))


def first_frame(work: Workload) -> Record:
    """One frame of the tiny scene; kernels were compiled by the run before."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out"
        options = ("--scene", str(TINY_SCENE), "--frames", "1", "--rays", str(work.size.rays), "--out", str(out))
        clear = f"import shutil; shutil.rmtree({str(out)!r}, ignore_errors=True)"
        render = program_of("datafactory", "render", *options)
        program = (f"{clear}; {render[0]}", *render[1:])
        timed_run(program)
        return _beside_numpy(work, "first_frame_vs_numpy", "datafactory render, one frame of tiny.usda", program)


def two_workers(work: Workload) -> Record:
    """Close targets by two workers, and by one: whole commands, starts included."""
    with tempfile.TemporaryDirectory() as folder:

        def run(workers: int) -> Timing:
            shutil.rmtree(Path(folder) / str(workers), ignore_errors=True)
            options = ("--frames", str(work.size.worker_frames), "--workers", str(workers))
            return timed_run(program_of("datafactory", "points", *options, "--out", str(Path(folder) / str(workers))))

        ours, reference = zip(*((run(2), run(1)) for _ in range(work.size.repeats)), strict=True)
        shards = [[path.read_bytes() for path in sorted(Path(folder, name).glob("*/*.parquet"))] for name in "12"]
    frames, time_of = work.size.worker_frames, median_time(ours)
    return Record(
        name="two_workers_vs_one",
        ours_time=time_of,
        reference="the same, 1 worker",
        reference_time=median_time(reference),
        error=float(shards[0] != shards[1]),
        error_unit="shards differ",
        ours=f"datafactory points --frames {frames}, 2 workers",
        details={"frames_per_second": frames / time_of.seconds},
    )


def program_of(name: str, *arguments: str) -> tuple[str, ...]:
    """What ``python -c`` is given to be this command."""
    return (f"import sys; sys.argv[0] = {name!r}; from {name}.cli.entry import main; main()", *arguments)


def _beside_numpy(work: Workload, name: str, what: str, program: tuple[str, ...]) -> Record:
    """Medians over repeats, ours and the reference in turn."""
    ours, reference = zip(*((timed_run(program), timed_run(NUMPY)) for _ in range(work.size.repeats)), strict=True)
    return Record(
        name=name,
        ours_time=median_time(ours),
        reference='python -c "import numpy"',
        reference_time=median_time(reference),
        error=0.0,  # of another status nothing is recorded
        error_unit=EXIT_STATUS,
        ours=what,
    )


def timed_run(program: tuple[str, ...]) -> Timing:
    """Times of one child that ends with status 0."""
    start, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([sys.executable, "-c", *program], check=True, stdout=subprocess.DEVNULL)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    used = after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime
    return Timing(time.perf_counter() - start, used)


def median_time(times: tuple[Timing, ...]) -> Timing:
    return Timing(
        statistics.median(each.seconds for each in times), statistics.median(each.cpu_seconds for each in times)
    )
