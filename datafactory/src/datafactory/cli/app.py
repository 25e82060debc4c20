"""``datafactory``: the command line. Thin: parse, call the library, print.

The modules of this room import nothing that computes until a command runs: each command imports what it calls at its
own top. Everything else would make ``--help`` wait for the ray tracer.
"""

from __future__ import annotations

from datafactory.cli.costs import accuracy, plan
from datafactory.cli.inspection import check, doctor, inspect, scenes, view
from datafactory.cli.making import city, convert, merge, points, render, trace
from shared.cli.application import application
from shared.cli.ending import Ending, run_app

EXAMPLES = {
    "render": (
        "datafactory render shipped:street --frames 16 --out build/mine",
        "datafactory render sionna:munich --populate cars=4/100m,parked=0.6 --frames 64 --points 16 --out build/munich",
    ),
    "points": (
        "datafactory points --frames 64 --out build/points",
        "datafactory points --frames 64 --no-noise --seed 1 --out build/clean",
    ),
    "plan": ("datafactory plan shipped:street", "datafactory plan sionna:munich --frames 8 --no-times --json"),
    "accuracy": (
        "datafactory accuracy shipped:street --out build/accuracy",
        "datafactory accuracy sionna:munich --quick --out build/accuracy-munich",
    ),
    "trace": (
        "datafactory trace shipped:street --frames 16 --out build/paths",
        "datafactory trace sionna:munich --rays 500000 --frames 64 --out build/paths-munich",
    ),
    "merge": (
        "datafactory merge build/jobs --out build/whole",
        "datafactory merge build/jobs/job-0-of-2 build/jobs/job-1-of-2 --out build/both",
    ),
    "view": (
        "datafactory view shipped:street --out build/street.html",
        "datafactory view sionna:munich --frames 8 --frame 3 --rays 20000 --out build/munich.html",
    ),
    "scenes": ("datafactory scenes", "datafactory check shipped:tiny"),
    "check": ("datafactory check shipped:street", "datafactory check sionna:munich --json"),
    "city": (
        "datafactory city --out build/city.usda",
        "datafactory city --seed 7 --blocks 3 --out build/city-7.usda",
    ),
    "inspect": ("datafactory inspect build/mine", "datafactory inspect build/mine --verify --frames 0"),
    "convert": (
        "datafactory convert build/mine --to mcap --out build/mcap",
        "datafactory convert build/munich --to mcap --out build/mcap-munich",
    ),
    "doctor": ("datafactory doctor", "datafactory doctor --json"),
}
"""Two of every command: its help ends with them, and ``tests/documentation/test_help.py`` runs them."""
STOPPED = "interrupted; what was finished is kept: the same command with --resume goes on"


app = application(
    "datafactory",
    "Scenes to multipath to 77 GHz FMCW radar data in Parquet shards.",
    (render, points, plan, accuracy, trace, merge, view, scenes, check, city, inspect, convert, doctor),
    EXAMPLES,
)


def main() -> None:
    """Entry point."""
    run_app("datafactory", app, STOPPED, _ending_of)


def _ending_of(error: Exception) -> Ending | None:
    from datafactory.run.portions import RunFailed

    if isinstance(error, RunFailed):
        return str(error), 1
    if isinstance(error, MemoryError):
        return f"out of memory ({error}); expected fewer samples, chirps, channels, rays or workers", 1
    return None
