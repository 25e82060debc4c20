# %% [markdown]
# # Accuracy against time, on one frame
#
# Rays are the knob that costs most. More rays change the speckle, the grain that many echoes of a rough surface make;
# no two realisations agree in it, and the strongest cells are seldom more than one grain. What can be compared is the
# power of cells of many grains, most of which agree. `datafactory accuracy` does this for every knob, over
# realisations; here it is one knob and one frame, and half of the cells lie within the error that is shown.

# %%
from __future__ import annotations

import os
import shutil
import time
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from datafactory import Pose, load_scene, render
from trainer import RadarDataset

OUT = Path(os.environ.get("EXAMPLES_OUT", "build/examples")) / "accuracy_and_time"
RAYS = [int(rays) for rays in os.environ.get("EXAMPLES_RAYS", "6250,25000,100000,400000").split(",")]
shutil.rmtree(OUT, ignore_errors=True)
OUT.mkdir(parents=True)

scene = load_scene("scenes/street.usda")
pose = Pose((-75.0, -1.75, 0.5))  # down the whole street

# %% [markdown]
# ## The same frame with more and more rays
#
# Processor seconds, not those of the clock: other programs do not disturb them. The first frame compiles; it
# is made once before and thrown away.


# %%
def power(rays: int, name: str) -> tuple[float, NDArray[np.float64]]:
    """(processor seconds, [cells] power of the truth image in cells of 2.25 m by 10 bins of u [W])."""
    began = time.process_time()
    render(scene, OUT / name, poses=[pose], split="0:0:1", rays=rays, effects="all")
    seconds = time.process_time() - began
    (example,) = RadarDataset(OUT / name, "test")
    image = example.image.numpy().astype(np.float64) * example.metadata["image_peak"]
    blocks = (image**2).reshape(image.shape[0] // 15, 15, image.shape[1] // 10, 10)
    return seconds, blocks.sum(axis=(1, 3)).ravel()


power(RAYS[0], "compiled")
made = {rays: power(rays, f"rays-{rays}") for rays in RAYS}

# %% [markdown]
# ## Against the frame with most rays

# %%
reference = made[RAYS[-1]][1]
heard = reference > 1e-6 * reference.max()  # within 60 dB of the strongest cell
rows = []
for rays, (seconds, found) in made.items():
    change_db = 10.0 * np.log10(np.maximum(found[heard] / reference[heard], 1e-12))
    error_db, lost = float(np.median(np.abs(change_db))), int((change_db < -10.0).sum())
    rows.append((rays, seconds, error_db))
    print(f"{rays:7d} rays: {seconds:5.1f} s, median error {error_db:.2f} dB, {lost} of {heard.sum()} cells lost")

# %%
figure = Figure(figsize=(5.0, 3.5), layout="constrained")
axis = figure.subplots()
axis.loglog([seconds for _, seconds, _ in rows[:-1]], [error_db for _, _, error_db in rows[:-1]], "o-")
for rays, seconds, error_db in rows[:-1]:
    axis.annotate(f"{rays} rays", (seconds, error_db), (4, 6), textcoords="offset points")
axis.set(xlabel="processor seconds of a frame", ylabel="median error of the power in a cell [dB]")
axis.grid(alpha=0.3, which="both")
figure.savefig(OUT / "accuracy.png", dpi=110)
print(f"look at {OUT / 'accuracy.png'}")
