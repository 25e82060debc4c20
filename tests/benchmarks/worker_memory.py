"""Peak memory of a process that makes frames, beside what :mod:`datafactory.run.memory` predicts, in Markdown.

``python tests/benchmarks/worker_memory.py`` renders one frame of each case, all effects on, in a process of its own;
``python tests/benchmarks/worker_memory.py tiny "points"`` those whose names begin so.
"""

import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).resolve().parents[1]))

from usd_files import mesh, stage

from datafactory.api.asking import order_of
from datafactory.api.options import OrderOptions
from datafactory.run.preparation import prepare
from datafactory.scenes.materials.table import load_materials

ROOT = Path(__file__).resolve().parents[2]
SMALL = "[waveform]\nchirps = 8\nsamples = 128\nrange_bins = 100\nbandwidth_hz = 400e6\n[grid]\nbins = 32\n"
BIG = "[waveform]\nchirps = 256\nsamples = 2048\nrange_bins = 1000\n"


INSTANCES = "instances"
"""5000 instances of 162 triangles, by a point instancer above a ground."""
PEAK = """
import os, sys
child = os.posix_spawn(sys.executable, [sys.executable, *sys.argv[1:]], os.environ)
_, status, usage = os.wait4(child, 0)
print(usage.ru_maxrss)
sys.exit(os.waitstatus_to_exitcode(status))
"""
"""Starts a command from a small process: Linux counts the size of the process that started it as the child's own."""


@dataclass(frozen=True)
class Case:
    """A run of one process.

    :param scene: None for close targets alone
    :param radar: a preset's name, or the text of a TOML file
    """

    name: str
    scene: str | None
    radar: str = SMALL
    rays: int = 20_000
    depth: int = 2
    frames: int = 1
    effects: str = "all"
    store: str = "range-channel"


AVR = "avr-qdm-110"
CASES = (
    Case("points, default radar", None, AVR),
    Case("points, default radar, 16 frames with their cubes", None, AVR, frames=16, store="cube"),
    Case("points, 256 chirps of 2048 samples", None, BIG),
    Case("tiny, small radar, 20 000 rays", "tiny.usda"),
    Case("tiny, default radar, 200 000 rays", "tiny.usda", AVR, 200_000),
    Case("street, default radar, 20 000 rays", "street.usda", AVR),
    Case("street, default radar, 200 000 rays", "street.usda", AVR, 200_000),
    Case("street, default radar, 200 000 rays, planned", "street.usda", AVR, 200_000, effects="auto"),
    Case("munich, small radar, 200 000 rays, one bounce", "sionna:munich", rays=200_000, depth=1),
    Case("munich, small radar, 200 000 rays, two bounces", "sionna:munich", rays=200_000),
    Case("munich, small radar, 200 000 rays, three bounces", "sionna:munich", rays=200_000, depth=3),
    Case("munich, default radar, 200 000 rays", "sionna:munich", AVR, 200_000),
    Case("munich, default radar, 200 000 rays, 4 frames, planned", "sionna:munich", AVR, 200_000, 2, 4, "auto"),
    Case("810 000 triangles, small radar, 20 000 rays", INSTANCES),
)


def instances() -> str:
    """The text of a USD stage: a wavy sheet of 9 x 9 quadrilaterals, 5000 times, 3 m apart."""
    count, side = 5000, 9
    x, y = np.meshgrid(np.arange(side + 1) / side, np.arange(side + 1) / side, indexing="ij")
    points = np.stack([x, y, 0.05 * np.sin(7 * x) * np.cos(9 * y)], -1).reshape(-1, 3)
    corner = np.arange(side * side) // side * (side + 1) + np.arange(side * side) % side
    quads = np.stack([corner, corner + side + 1, corner + side + 2, corner + 1], -1)
    ground = mesh("ground", [(-50, -50, -1), (400, -50, -1), (400, 400, -1), (-50, 400, -1)], [range(4)])
    places = [(i % 100 * 3, i // 100 * 3, 0) for i in range(count)]
    return stage(f"""{ground}
def PointInstancer "many" {{
  rel prototypes = </many/one>
  int[] protoIndices = {[0] * count}
  point3f[] positions = {places}
  {mesh("one", points, quads.tolist())}
}}""")


def measured(case: Case, folder: Path) -> tuple[float, float]:
    """Peak resident size of the process, and the prediction [bytes]; Linux."""
    radar = case.radar
    if "\n" in radar:
        radar = str(folder / "radar.toml")
        Path(radar).write_text(case.radar, encoding="utf-8")
    scene = case.scene if case.scene is None or ":" in case.scene else str(ROOT / "scenes" / case.scene)
    if case.scene == INSTANCES:
        scene = str(folder / "instances.usda")
        Path(scene).write_text(instances(), encoding="utf-8")
    order = order_of(OrderOptions(
        scene, radar=radar, frames=case.frames if scene else 0, points=0 if scene else case.frames, rays=case.rays,
        depth=case.depth, effects=case.effects, store=case.store,
    ))  # fmt: skip
    predicted = prepare(order, load_materials()).job.load.total_bytes(1)
    frames = ["--split", "1:0:0", "--workers", "1", "--store", case.store, "--radar", radar]
    frames += ["--frames", str(case.frames), "--out", str(folder / "data")]
    command = ["points", *frames]
    if scene:
        command = ["render", scene, *frames, "--rays", str(case.rays), "--depth", str(case.depth)]
        command += ["--effects", case.effects]
    done = subprocess.run(
        [sys.executable, "-c", PEAK, "-m", "datafactory", *command], capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise RuntimeError(done.stderr[-800:])
    return float(done.stdout.splitlines()[-1]) * 1024.0, predicted


def main(names: list[str]) -> None:
    print("| case | measured [MB] | predicted [MB] | share |\n|---|---|---|---|")
    for case in CASES:
        if names and not case.name.startswith(tuple(names)):
            continue
        with tempfile.TemporaryDirectory() as folder:
            peak, predicted = measured(case, Path(folder))
        print(f"| {case.name} | {peak / 1e6:.0f} | {predicted / 1e6:.0f} | {peak / predicted:.2f} |", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
