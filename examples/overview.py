"""The picture of the README: a street from above, what a thinned radar shows of it, what the network shows, the truth.

    .venv/bin/python examples/overview.py --out docs/overview.png

All panels have the same axes, so that a thing is at the same place in each. Levels are weighted by range, for
amplitudes fall with its square.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection, QuadMesh
from matplotlib.figure import Figure
from numpy.typing import NDArray

from datafactory import Pose, Scene, load_scene, render
from shared.pictures import LEVEL_LABEL, draw_from_above, range_weighted_db
from shared.signal.imaging import delay_and_sum
from trainer import RadarDataset, load_imager, pretrained_run

SCENE = Path(__file__).resolve().parents[1] / "scenes" / "street.usda"
POSE = Pose((-40.0, -1.75, 0.5))
"""In the right lane, along the street."""
AHEAD_M, ASIDE_M = 46.0, 15.0
COLOURS = {
    "asphalt": "#5b5b60", "concrete": "#b9b4aa", "brick": "#a8573f", "glass": "#8fb7c9", "metal": "#33506e",
    "vegetation": "#6f9a55", "wood": "#7a5b3a", "marble": "#d8d4cc", "rubber": "#222222",
}  # fmt: skip
TREES_M = 3.0
"""What is higher of trees is left out of the view from above: their tops hide the street."""


def main() -> None:
    options = argparse.ArgumentParser(description="The picture of the README.")
    options.add_argument("--out", type=Path, required=True, help="the PNG to write")
    options.add_argument("--rays", type=int, default=400_000)
    chosen = options.parse_args()
    scene = load_scene(SCENE)
    with tempfile.TemporaryDirectory() as folder:
        render(scene, Path(folder) / "frames", poses=[POSE], split="0:0:1", rays=chosen.rays, effects="all")
        frames = RadarDataset(Path(folder) / "frames", "test")
        example = frames[0]
    run, imager = load_imager(pretrained_run("sparse6"))
    noise = torch.full((len(example.input),), example.metadata["noise_power"])
    with torch.inference_mode():
        network = imager(example.input, noise).amax(dim=0).numpy()
    thinned = np.abs(delay_and_sum(example.input.numpy(), frames.radar, run.array.channels(frames.radar))).max(axis=0)
    truth = example.image.numpy() * example.metadata["image_peak"]
    figure = Figure(figsize=(12.0, 4.5), layout="constrained")
    axes = figure.subplots(1, 4, sharex=True, sharey=True)
    draw_scene(axes[0], scene)
    images = {
        "input: 6 of 16 receivers": thinned,
        "output of the network": network,
        "truth: 256 antennas": truth,
    }
    for axis, (title, image) in zip(axes[1:], images.items(), strict=True):
        shown = draw_image(axis, image, frames)
        axis.set_title(title)
    for axis in axes:
        axis.plot(0.0, 0.0, marker="^", markersize=9, color="#00c0a0", markeredgecolor="black", clip_on=False)
        axis.set(xlim=(ASIDE_M, -ASIDE_M), ylim=(0.0, AHEAD_M), xlabel="left  <-  y [m]  ->  right", aspect="equal")
    axes[0].set_ylabel("x, ahead of the radar [m]")
    figure.colorbar(shown, ax=axes, label=LEVEL_LABEL, pad=0.01, shrink=0.85)
    figure.savefig(chosen.out, dpi=100, metadata={"Software": None})


def draw_scene(axis: Axes, scene: Scene) -> None:
    """Triangles from above, the lowest first, coloured by material; moving things are outlined."""
    corners, colours, heights, targets = [], [], [], []
    for item in scene.objects:
        place = item.vertices - np.array(POSE.position)
        for triangle in item.triangles:
            height = float(place[triangle, 2].mean()) + POSE.position[2]
            if item.material.rpartition("/")[2] != "vegetation" or height < TREES_M:
                corners.append(place[triangle][:, 1::-1])
                colours.append(COLOURS.get(item.material.rpartition("/")[2], "#999999"))
                heights.append(height)
    for target in scene.targets:
        targets.append(np.array(target.position) - np.array(POSE.position))
    order = np.argsort(heights, kind="stable")
    axis.add_collection(
        PolyCollection(
            [corners[index] for index in order],
            facecolors=[colours[index] for index in order],
            edgecolors="face",
            lw=0.4,
        )
    )
    if targets:
        y, x = np.array(targets)[:, 1::-1].T
        axis.scatter(y, x, s=12, color="#e0a000", edgecolors="black", lw=0.5, zorder=3)
    axis.set(title="scene, from above", facecolor="#e8e6e0")


def draw_image(axis: Axes, image: NDArray[np.floating], frames: RadarDataset) -> QuadMesh:
    """Levels in the plane, dB below the brightest cell of the view."""
    rows = int((frames.range_m < np.hypot(AHEAD_M, ASIDE_M)).sum())
    return draw_from_above(axis, range_weighted_db(image[:rows]), frames.radar.waveform.range_step_m, frames.u)


if __name__ == "__main__":
    main()
