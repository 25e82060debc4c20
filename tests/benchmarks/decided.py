"""Frames as they decide, and with every effect: whole commands in turn, one worker, processor time.

    python tests/benchmarks/decided.py [SCENE ...] [--frames 20] [--pairs 3]

Prints of each scene the medians, and the median, least and largest of the pairs' ratios. SCENE is one of ``WRITTEN``,
which are written here, or whatever ``datafactory render`` takes; without, all of ``SCENES``.
"""

import argparse
import resource
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from statistics import median

sys.path.append(str(Path(__file__).resolve().parents[1]))

from usd_files import mesh, stage

from datafactory.scenes.city.city import write_city
from datafactory.scenes.city.rules import Style

HUT = (
    (88, 88, 0), (94, 88, 0), (94, 93, 0), (88, 93, 0), (88, 88, 3), (94, 88, 3), (94, 93, 3), (88, 93, 3),
)  # fmt: skip
FIELD = stage(
    mesh("Ground", [(-100, -100, 0), (100, -100, 0), (100, 100, 0), (-100, 100, 0)], [range(4)], "asphalt")
    + mesh("Hut", HUT, [(4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)], "brick")
    + mesh("Window", [(-92, -90, 0), (-90, -92, 0), (-90, -92, 2), (-92, -90, 2)], [range(4)], "glass")
)
"""An open field of 200 m with a hut and a window in two corners."""

WRITTEN: dict[str, Callable[[Path], object]] = {
    "field": lambda path: path.write_text(FIELD, encoding="utf-8"),
    "motorway": lambda path: write_city(path, style=Style.MOTORWAY),
    "car-park": lambda path: write_city(path, style=Style.CAR_PARK),
}
SHIPPED = Path(__file__).resolve().parents[2] / "scenes"
SCENES = (
    *WRITTEN,
    str(SHIPPED / "tiny.usda"),
    str(SHIPPED / "street.usda"),
    "sionna:munich",
    "sionna:florence",
    "sionna:simple_street_canyon_with_cars",
)


def pairs(scene: str, frames: int, repeats: int) -> tuple[list[float], list[float]]:
    """Processor seconds of both, pair by pair; which of a pair is first alternates. One run before compiles kernels."""
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder) / f"{scene}.usda"
        if scene in WRITTEN:
            WRITTEN[scene](place)

        def timed(effects: str, count: int = frames) -> float:
            out = Path(folder) / effects
            shutil.rmtree(out, ignore_errors=True)
            options = ("--frames", str(count), "--workers", "1", "--effects", effects, "--out", str(out))
            return rendered_in(str(place) if scene in WRITTEN else scene, *options)

        timed("all", 1)
        both: list[dict[str, float]] = []
        for number in range(repeats):
            order = ("auto", "all") if number % 2 == 0 else ("all", "auto")
            both.append({effects: timed(effects) for effects in order})
    return [pair["auto"] for pair in both], [pair["all"] for pair in both]


def rendered_in(*arguments: str) -> float:
    """Processor seconds of a render that ends with status 0."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [sys.executable, "-m", "datafactory", "render", *arguments]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime


def main() -> None:
    """One line a scene."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", default=SCENES)
    parser.add_argument("--frames", type=int, default=20)
    parser.add_argument("--pairs", type=int, default=3)
    asked = parser.parse_args()
    for scene in asked.scenes:
        auto, every = pairs(scene, asked.frames, asked.pairs)
        ratios = sorted(other / own for own, other in zip(auto, every, strict=True))
        print(
            f"{scene}: auto {median(auto):.1f} s, all {median(every):.1f} s, "
            f"{median(ratios):.3f} ({ratios[0]:.3f} to {ratios[-1]:.3f})",
            flush=True,
        )


if __name__ == "__main__":
    main()
