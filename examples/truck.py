"""A truck approaches a standing radar (paper, section IV-D and Fig. 12): scene, cubes, images over time, velocities.

    .venv/bin/python examples/truck.py --out build/truck

1. ``datafactory render`` traces truck.usda as the truck comes nearer, a frame every 0.7 s, and keeps the cubes.
2. ``trainer predict`` images the cubes, as it would those of a board: six of sixteen RX, up to three Doppler peaks of
   every range bin; its list of targets and its animation are written too.
3. The strongest detection on the truck is held against the truth: the range rate of the place where it stands.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
from matplotlib.figure import Figure

from shared.dataset.folder import open_dataset
from shared.dataset.reading import radar_of

SCENE = Path(__file__).with_name("truck.usda")
TRUCK_FRONT_M, TRUCK_SPEED_MPS = 52.0, 8.0
"""Along x, at time 0 and towards the radar; as the scene has them."""
TRUCK_M = (9.5, (0.9, 3.5))
"""Its length, and y of its right and left side; with half a metre around it a detection is the truck's."""
AROUND_M = 0.5
SECONDS_A_FRAME = 0.7


def main() -> None:
    options = argparse.ArgumentParser(description="A truck approaches: cubes, images over time, velocities.")
    options.add_argument("--out", type=Path, required=True, help="a new folder")
    options.add_argument("--frames", type=int, default=6)
    options.add_argument("--rays", type=int, default=100_000)
    chosen = options.parse_args()
    times = SECONDS_A_FRAME * np.arange(1, chosen.frames + 1)
    render(chosen.out, times, chosen.rays)
    image(chosen.out)
    compare(chosen.out, times)


def render(out: Path, times: np.ndarray, rays: int) -> None:
    """``out/frames``: a dataset with the cubes; ``out/cubes.npz``: the cubes alone, as a board would deliver them."""
    out.mkdir(parents=True)
    poses = [{"position": [0.0, 0.0, 0.6], "time": float(time)} for time in times]
    (out / "poses.json").write_text(json.dumps(poses), encoding="utf-8")
    command(
        "datafactory", "render", "--scene", SCENE, "--poses", out / "poses.json", "--split", "0:0:1",
        "--effects", "all", "--rays", rays, "--workers", 1, "--store", "cube", "--out", out / "frames",
    )  # fmt: skip
    dataset = open_dataset(out / "frames")
    cubes = [frame.cube for frame in dataset.frames("test", ("cube",))]
    np.savez(out / "cubes.npz", cube=np.array(cubes), radar=radar_of(dataset.description()).model_dump_json())


def image(out: Path) -> None:
    """``out/images``: images.parquet with the detections, and animation.gif."""
    command(
        "trainer", "predict", out / "cubes.npz", "--pretrained", "sparse6", "--points", "--animation", "--no-pictures",
        "--out", out / "images",
    )  # fmt: skip


def compare(out: Path, times: np.ndarray) -> None:
    """``out/velocity.png``, and the figures in one line."""
    detections = pq.read_table(out / "images/images.parquet", columns=["detections"])["detections"].to_pylist()
    first_peak = [frame.velocity[0] for frame in open_dataset(out / "frames").frames("test", ("velocity",))]
    step_m = radar_of(open_dataset(out / "frames").description()).waveform.range_step_m
    found, on_it, weaker = [], 0, 0
    for time, listed, strongest in zip(times, detections, first_peak, strict=True):
        truck = [target for target in listed if on_truck(target, float(time))]
        on_it += len(truck)
        weaker += sum(abs(strongest[round(target["range"] / step_m)] - target["velocity"]) > 1.0 for target in truck)
        if truck:
            best = max(truck, key=lambda target: target["amplitude_db"])
            x = best["range"] * np.sqrt(1.0 - best["u"] ** 2)
            found.append((float(time), best["range"], best["velocity"], -TRUCK_SPEED_MPS * x / best["range"]))
    if not found:
        raise SystemExit("the truck was not detected in any frame")
    time, range_m, velocity, truth = np.array(found).T
    error = float(np.sqrt(np.mean((velocity - truth) ** 2)))
    print(
        f"truck detected in {len(found)} of {len(times)} frames, velocity off by {error:.2f} m/s rms; {weaker} of "
        f"{on_it} detections on it stand behind a stronger echo of their range bin"
    )
    figure = Figure(figsize=(7.0, 3.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    left.plot(times, TRUCK_FRONT_M - TRUCK_SPEED_MPS * times, label="truck's front")
    left.plot(time, range_m, "o", label="detection")
    left.set(xlabel="time [s]", ylabel="range [m]")
    left.legend()
    right.plot(time, truth, label="truth")
    right.plot(time, velocity, "o", label="detection")
    right.set(xlabel="time [s]", ylabel="velocity [m/s]", ylim=(-TRUCK_SPEED_MPS - 1.0, -TRUCK_SPEED_MPS + 1.0))
    right.legend()
    figure.savefig(out / "velocity.png", dpi=100, metadata={"Software": None})


def on_truck(target: dict[str, float], time: float) -> bool:
    """Is a detection within the truck's outline at this time, and does it move?"""
    x, y = target["range"] * np.sqrt(1.0 - target["u"] ** 2), target["range"] * target["u"]
    front = TRUCK_FRONT_M - TRUCK_SPEED_MPS * time
    length, (right, left) = TRUCK_M
    along = front - AROUND_M <= x <= front + length + AROUND_M
    return bool(along and right - AROUND_M <= y <= left + AROUND_M and target["velocity"] < -1.0)


def command(program: str, *arguments: object) -> None:
    """Run a command of this environment."""
    subprocess.run([str(Path(sys.executable).with_name(program)), *map(str, arguments)], check=True)


if __name__ == "__main__":
    main()
