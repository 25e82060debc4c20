# %% [markdown]
# # A tour: from a street to a list of points
#
# One frame, all the way: a scene, the paths of its echoes, the cube that a radar receives, images of it, and points.
# Run it in the root of the repository. It writes into `build/examples/tour`, in less than three minutes on two cores.

# %%
from __future__ import annotations

import os
import shutil
from collections import Counter
from pathlib import Path

import numpy as np
import torch
from matplotlib.figure import Figure
from numpy.typing import NDArray

from datafactory import Pose, load_radar, load_scene, read_paths, render, trace
from datafactory.api.viewing import view
from datafactory.run.preparation import prepared_scene
from datafactory.scenes.materials.table import load_materials
from datafactory.view.camera import above_picture, camera_picture, draw_camera
from datafactory.view.strongest import kinds_of
from datafactory.view.subject import Subject
from shared.dataset.folder import open_dataset
from shared.pictures import COLOUR_MAP, LEVEL_LABEL, draw_from_above, range_weighted_db, save_figure
from shared.signal.imaging import delay_and_sum
from shared.signal.spectrum import range_doppler
from trainer import RadarDataset, estimators, load_imager, pretrained_run
from trainer.data.measurements import Cells
from trainer.metrics.image import nmse_best_scaled
from trainer.run.detections import Sought, find_detections

OUT = Path(os.environ.get("EXAMPLES_OUT", "build/examples")) / "tour"
RAYS = int(os.environ.get("EXAMPLES_RAYS", "100000"))
AHEAD_M, ASIDE_M = 50.0, 15.0
"""What the images show."""
CLEAR_DB = 20.0
"""Points weaker than the strongest by more than this are not drawn."""
shutil.rmtree(OUT, ignore_errors=True)
OUT.mkdir(parents=True)

# %% [markdown]
# ## A scene
#
# The shipped street, with traffic put on its free ground. Any USD or Mitsuba scene will do in its place. The picture
# looks down on it from behind the place where the radar will stand. Colours are those of materials: metal is blue.

# %%
scene = load_scene("scenes/street.usda", populate="cars=8,pedestrians=8,cyclists=2", seed=1)
radar = load_radar("avr-qdm-110")
print(scene)

from_a_roof = Pose((-44.0, -3.0, 14.0), pitch_deg=22.0)
prepared = prepared_scene(scene, load_materials(), lambda line: None)
figure = Figure(figsize=(9.6, 4.2), layout="constrained")
draw_camera(figure.subplots(), camera_picture(Subject("street", prepared, from_a_roof, radar)))
save_figure(figure, OUT / "scene.png", dpi=100)

# %% [markdown]
# ## A frame
#
# A frame is one measurement: a radar, a place, a direction and a time. This radar has 3 transmitters and 16
# receivers, together 48 channels. It stands in the right lane, half a metre above the road, and looks along it.

# %%
print(radar)
pose = Pose((-26.0, -1.75, 0.5))

# %% [markdown]
# ## Its paths
#
# Sionna RT and this package's own searches find every way from the radar to things and back. One trace serves many
# radars. `view` writes the scene in three dimensions with the strongest paths as a page, to turn and zoom in a
# browser. With `png=True` it also writes two pictures: what a camera at the radar sees, and the scene from above.

# %%
trace(scene, OUT / "traced", poses=[pose], split="0:0:1", rays=RAYS, effects="all")
(shard,) = (OUT / "traced").rglob("*.parquet")
(traced,) = read_paths(shard)
print(f"{len(traced.table)} paths:", dict(Counter(kinds_of(traced.table).tolist())))
view(scene, OUT / "street.html", paths=OUT / "traced", png=True)

# %% [markdown]
# ## The cube
#
# What the converter gives: 1024 samples of each of 128 chirps and 48 channels, noise included. Two FFTs sort them by
# range and by velocity. What stands is at 0 m/s, what approaches on the left. Amplitudes are weighted by range, as in
# all pictures here.

# %%
render(None, OUT / "frames", radar=radar, paths=OUT / "traced", split="0:0:1", store="cube")
(frame,) = open_dataset(OUT / "frames").frames("test")
cube = frame.cube
assert cube is not None
print("cube [chirp, sample, channel]:", cube.shape, cube.dtype)

waveform = radar.waveform
rows = int((waveform.ranges_m < np.hypot(AHEAD_M, ASIDE_M)).sum())
power = np.square(np.abs(range_doppler(cube, radar)[:rows])).mean(axis=2)
figure = Figure(figsize=(6.0, 4.2), layout="constrained")
axis = figure.subplots()
levels = range_weighted_db(np.sqrt(power), span_db=60.0)
shown = axis.pcolormesh(waveform.velocities_mps, waveform.ranges_m[:rows], levels, cmap=COLOUR_MAP)
axis.set(xlabel="velocity [m/s], receding > 0", ylabel="range [m]")
figure.colorbar(shown, ax=axis, label=LEVEL_LABEL)
save_figure(figure, OUT / "cube.png", dpi=100)

# %% [markdown]
# ## Delay and sum
#
# The plainest image: the channels are added with the delay that an echo from each direction would have. All 16
# receivers blur in angle. Six of them, the array `sparse6`, also put false echoes beside every strong one. A dataset
# holds, for each range, the channels at the strongest velocities. The image is the maximum over these.

# %%
example = RadarDataset(OUT / "frames", "test")[0]
run, imager = load_imager(pretrained_run("sparse6"))
sparse = run.array.channels(radar)


def draw_images(name: str, images: dict[str, NDArray[np.floating]]) -> None:
    """Images [R, U] side by side, from above, each relative to its own brightest cell."""
    figure = Figure(figsize=(3.2 * len(images) + 1.0, 4.6), layout="constrained")
    axes = figure.subplots(1, len(images), sharey=True, squeeze=False)[0]
    for axis, (title, image) in zip(axes, images.items(), strict=True):
        shown = draw_from_above(axis, range_weighted_db(image[:rows]), waveform.range_step_m, radar.grid.u)
        axis.set(xlim=(ASIDE_M, -ASIDE_M), ylim=(0.0, AHEAD_M), title=title)
        axis.set_xlabel("left  <-  y [m]  ->  right")
    axes[0].set_ylabel("x, ahead of the radar [m]")
    figure.colorbar(shown, ax=axes, label=LEVEL_LABEL)
    save_figure(figure, OUT / f"{name}.png", dpi=100)


measured = example.input.numpy()
full = np.abs(delay_and_sum(measured, radar)).max(axis=0)
thinned = np.abs(delay_and_sum(measured, radar, sparse)).max(axis=0)
draw_images("delay-and-sum", {"all 16 receivers": full, "6 receivers": thinned})

# %% [markdown]
# ## The network
#
# The network for `sparse6` comes with the package. It was trained on frames of seven scenes, of which this street is
# one. `docs/notes/weights.md` says how it does in cities that it never saw.

# %%
noise = torch.full((len(measured),), example.metadata["noise_power"])  # [W], of each Doppler peak
with torch.inference_mode():
    images, probability = imager.detect(example.input, noise)
assert probability is not None
network = images.amax(dim=0).numpy()
draw_images("network", {"6 receivers, delay and sum": thinned, "6 receivers, network": network})

# %% [markdown]
# ## The truth
#
# The same echoes, received by a virtual sensor of 256 antennas without noise. The error is the squared difference over
# the energy of the truth (NMSE), each image at its best scale.

# %%
truth = example.image.numpy() * example.metadata["image_peak"]
draw_images("truth", {"6 receivers, delay and sum": thinned, "6 receivers, network": network, "truth": truth})
for name, image in {"16 receivers": full, "6 receivers": thinned, "network, 6 receivers": network}.items():
    print(f"{name}: error {nmse_best_scaled(image, truth):.2f}")

# %% [markdown]
# ## Points
#
# Targets at continuous angles are fitted to the channels at every range and velocity; the network says where to begin.
# The picture shows those within 20 dB of the strongest, over the scene from above. An echo of several bounces stands
# where its way was long enough, which may be behind a wall.

# %%
found = find_detections(
    images.numpy(), probability.numpy(), Cells(measured[..., sparse], example.metadata["velocity"].numpy()), radar,
    estimators.line_array(radar, sparse), Sought(example.metadata["noise_power"]),
)  # fmt: skip
print(f"{len(found)} points; the strongest that move:")
x, y = found.range_m * np.sqrt(1.0 - found.u**2), found.range_m * found.u
for index in np.flatnonzero(np.abs(found.velocity) > 0.5)[:5]:
    print(f"  x {x[index]:5.1f} m, y {y[index]:5.1f} m, {found.velocity[index]:+5.1f} m/s")

level = found.amplitude_db + 20.0 * np.log10(np.maximum(found.range_m, waveform.range_step_m))
clear = level > level.max() - CLEAR_DB
figure = Figure(figsize=(5.6, 6.4), layout="constrained")
axis = figure.subplots()
above = above_picture(Subject("street", prepared, pose, radar), area=(0.0, AHEAD_M, ASIDE_M))
axis.imshow(above, extent=(ASIDE_M, -ASIDE_M, 0.0, AHEAD_M))
points = axis.scatter(
    y[clear], x[clear], c=found.velocity[clear], cmap="coolwarm", vmin=-10.0, vmax=10.0, s=16, edgecolors="black"
)
axis.set(xlabel="y [m], left > 0", ylabel="x [m], ahead", xlim=(ASIDE_M, -ASIDE_M), ylim=(0.0, AHEAD_M))
figure.colorbar(points, ax=axis, label="velocity [m/s], receding > 0")
save_figure(figure, OUT / "points.png", dpi=100)
print(f"look at {OUT}")
