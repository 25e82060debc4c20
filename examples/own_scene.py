# %% [markdown]
# # A USD scene of your own, from an empty file to a dataset
#
# A yard with a wall, a parked van, a car that drives off, and a corner reflector. The file is plain text; any tool that
# writes USD will do. Run it in the root of the repository; it writes into `build/examples/own_scene`.

# %%
from __future__ import annotations

import os
import shutil
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from datafactory import Pose, load_scene, plan, render
from shared.pictures import LEVEL_LABEL, draw_levels, range_weighted_db
from shared.signal.imaging import delay_and_sum
from trainer import RadarDataset

OUT = Path(os.environ.get("EXAMPLES_OUT", "build/examples")) / "own_scene"
RAYS = int(os.environ.get("EXAMPLES_RAYS", "50000"))
shutil.rmtree(OUT, ignore_errors=True)
OUT.mkdir(parents=True)

# %% [markdown]
# ## The scene
#
# A box is a `Cube` of edge 1 that is scaled and moved. Metres, z up. Three attributes are the radar's own:
# `radar:material` names what a thing is made of, `radar:velocity` moves it [m/s], and `radar:target` stands for a
# target whose cross section has a formula, here a trihedral with edges of 15 cm.


# %%
def box(name: str, centre: tuple[float, ...], size: tuple[float, ...], material: str, velocity: str = "") -> str:
    """A box as USD text."""
    moves = f"custom double3 radar:velocity = {velocity}" if velocity else ""
    return f"""
    def Cube "{name}"
    {{
        custom string radar:material = "{material}"
        {moves}
        double size = 1
        double3 xformOp:translate = {centre}
        double3 xformOp:scale = {size}
        uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:scale"]
    }}"""


REFLECTOR = """
    def Xform "Reflector"
    {
        custom token radar:target = "trihedral"
        custom double radar:edge_m = 0.15
        double3 xformOp:translate = (12, 4, 0.5)
        float xformOp:rotateZ = 180
        uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateZ"]
    }"""

parts = [
    box("Ground", (20.0, 0.0, -0.1), (60.0, 40.0, 0.2), "asphalt"),
    box("Wall", (35.0, 0.0, 2.0), (0.3, 24.0, 4.0), "brick"),
    box("Van", (16.0, -4.0, 1.0), (5.0, 2.0, 2.0), "metal"),
    box("Car", (22.0, 3.0, 0.7), (4.3, 1.8, 1.4), "metal", velocity="(6, 0, 0)"),
    REFLECTOR,
]
header = '#usda 1.0\n(\n    metersPerUnit = 1\n    upAxis = "Z"\n    defaultPrim = "World"\n)\n\ndef Xform "World"\n{'
path = OUT / "yard.usda"
path.write_text(header + "\n".join(parts) + "\n}\n", encoding="utf-8")

scene = load_scene(path)
print(f"{len(scene.objects)} meshes, {scene.triangle_count} triangles, {len(scene.targets)} target")
for warning in scene.warnings:
    print("warning:", warning)

# %% [markdown]
# ## What the scene calls for
#
# Effects that change nothing above the error budget are left out. The plan says which, and why.

# %%
pose = Pose((0.0, 0.0, 0.5))
(planned,) = plan(scene, poses=[pose], rays=RAYS)
for effect in planned.to_json()["effects"]:
    print(f"{'on ' if effect['on'] else 'off'} {effect['effect']:20s} {effect['reason']}")

# %% [markdown]
# ## The dataset
#
# One frame a pose; the radar moves forward by half a metre from one to the next. All go to the test split here.

# %%
poses = [Pose((0.5 * step, 0.0, 0.5), time_s=0.2 * step) for step in range(3)]
report = render(scene, OUT / "frames", poses=poses, split="0:0:1", rays=RAYS)
print(f"{report.frames} frames in {report.seconds:.0f} s")

# %% [markdown]
# ## A look
#
# Left is what the sensor's 48 channels see, right what the virtual sensor of 256 elements sees of the same echoes.

# %%
frames = RadarDataset(OUT / "frames", "test")
example = frames[0]
measured = np.abs(delay_and_sum(example.input[0].numpy(), frames.radar))
truth = example.image.numpy() * example.metadata["image_peak"]
grid, step_m = frames.radar.grid, frames.radar.waveform.range_step_m
figure = Figure(figsize=(8.0, 4.5), layout="constrained")
for axis, image, title in zip(figure.subplots(1, 2), (measured, truth), ("48 channels", "256 elements"), strict=True):
    shown = draw_levels(axis, range_weighted_db(image, reference=truth)[:280], step_m, grid.u_start, grid.step)
    axis.set(title=title, xlabel="left  <-  u = sin(azimuth)  ->  right", ylabel="range [m]")
figure.colorbar(shown, ax=figure.axes, label=LEVEL_LABEL)
figure.savefig(OUT / "yard.png", dpi=110)
print(f"look at {OUT / 'yard.png'}")
