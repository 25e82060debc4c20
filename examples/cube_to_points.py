# %% [markdown]
# # From the samples of the converter to a point cloud
#
# A cube of samples [chirp, sample, channel] becomes range-Doppler spectra, then the channels at the Doppler peaks, then
# an image, then a list of targets. Each step is a line or two of NumPy; the library's function stands beside it.

# %%
from __future__ import annotations

import os
import shutil
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from datafactory import load_radar, read_targets, render
from shared.dataset.folder import open_dataset
from shared.pictures import COLOUR_MAP, draw_levels, level_db
from shared.signal.imaging import delay_and_sum
from shared.signal.spectrum import range_doppler, select_doppler
from trainer import estimators
from trainer.data.measurements import Cells
from trainer.run.detections import Sought, find_detections

CLEAR_DB = 20.0
"""Over the noise, from which on a target is drawn: weaker ones beside a strong one are what its wave front leaves."""
OUT = Path(os.environ.get("EXAMPLES_OUT", "build/examples")) / "cube_to_points"
shutil.rmtree(OUT, ignore_errors=True)
OUT.mkdir(parents=True)

# %% [markdown]
# ## A cube
#
# Five targets: two stand two degrees apart, one comes, one goes, one crosses behind. A cube of a board comes the
# same way from `trainer import`, in `cube.npz`.

# %%
(OUT / "targets.json").write_text(
    """[[
  {"x": 20.0, "y": 0.4, "z": 0.0, "rcs_dbsm": 5.0},
  {"x": 20.0, "y": -0.4, "z": 0.0, "rcs_dbsm": 5.0, "phase": 1.0},
  {"x": 12.0, "y": 4.0, "z": 0.0, "vx": -6.0, "rcs_dbsm": 0.0},
  {"x": 30.0, "y": -9.0, "z": 0.0, "vx": 4.0, "rcs_dbsm": 10.0},
  {"x": 45.0, "y": 10.0, "z": 0.0, "vx": 1.0, "vy": -8.0, "rcs_dbsm": 15.0}
]]""",
    encoding="utf-8",
)
radar = load_radar("avr-qdm-110")
render(
    None, OUT / "frames", radar=radar, frames=0, targets=read_targets(OUT / "targets.json"), split="0:0:1", store="cube"
)
(frame,) = open_dataset(OUT / "frames").frames("test")
cube = frame.cube
assert cube is not None
print("cube [chirp, sample, channel]:", cube.shape, cube.dtype)

# %% [markdown]
# ## Range, then Doppler
#
# An FFT over the samples of a chirp sorts echoes by range, an FFT over the chirps by velocity. Hann windows keep the
# sidelobes down. Each FFT is divided by its window's sum, so that a target reads its amplitude.

# %%
waveform = radar.waveform
fast = np.hanning(waveform.samples + 1)[:-1]
slow = np.hanning(waveform.chirps + 1)[:-1]
spectra = np.fft.fft(cube * (fast / fast.sum())[:, None], axis=1)[:, : waveform.range_bins]
spectra = np.fft.fftshift(np.fft.fft(spectra * (slow / slow.sum())[:, None, None], axis=0), axes=0)
spectra = spectra.transpose(1, 0, 2)  # [range, Doppler, channel]
library = range_doppler(cube, radar)
difference = np.abs(spectra - library).max() / np.abs(library).max()
print(f"range-Doppler: {spectra.shape}, {difference:.1e} from shared.signal.spectrum.range_doppler")

# %% [markdown]
# ## Doppler choice
#
# Of each range bin the strongest peaks over Doppler are kept: what stands and what moves are imaged apart.

# %%
selection = select_doppler(library, frame.noise_power)
velocity = selection.velocities_mps(waveform).astype(np.float32)
print("channels at the peaks [peak, range, channel]:", selection.range_channel.shape)

# %% [markdown]
# ## Image and list
#
# Delay-and-sum images the strongest peak. The list of targets is a fit of lines at continuous angles to every range bin
# and peak, that begins with the peaks of a sharper spectrum (LIKES), and is told no number of targets.

# %%
image = np.abs(delay_and_sum(selection.range_channel[0], radar))
line = estimators.line_array(radar, radar.array.azimuth_channels)
estimator = estimators.ESTIMATORS["likes"]()
sharp = np.stack([estimator.image(rows, line, radar.grid.u, frame.noise_power) for rows in selection.range_channel])
cells = Cells(selection.range_channel, velocity)
found = find_detections(sharp, None, cells, radar, line, Sought(frame.noise_power))
print(f"{len(found)} targets; the strongest:")
for index in range(min(len(found), 8)):
    x = found.range_m[index] * np.sqrt(1.0 - found.u[index] ** 2)
    y = found.range_m[index] * found.u[index]
    print(f"  x {x:6.2f} m, y {y:6.2f} m, {found.velocity[index]:+5.2f} m/s, {found.amplitude_db[index]:6.1f} dB")

# %%
figure = Figure(figsize=(11.0, 4.0), layout="constrained")
left, middle, right = figure.subplots(1, 3)
magnitude = 20.0 * np.log10(np.maximum(selection.magnitude[:340], 1e-30))
top = magnitude.max()
left.pcolormesh(waveform.velocities_mps, waveform.ranges_m[:340], magnitude, vmin=top - 60, vmax=top, cmap=COLOUR_MAP)
left.set(title="range-Doppler", xlabel="velocity [m/s]", ylabel="range [m]")
levels = level_db(image[:340], float(image.max()))
draw_levels(middle, levels, waveform.range_step_m, radar.grid.u_start, radar.grid.step)
middle.set(title="delay-and-sum", xlabel="left  <-  u = sin(azimuth)  ->  right")
clear = found.amplitude_db > 10.0 * np.log10(frame.noise_power) + CLEAR_DB
x, y = (found.range_m * np.sqrt(1.0 - found.u**2))[clear], (found.range_m * found.u)[clear]
points = right.scatter(y, x, c=found.velocity[clear], cmap="coolwarm", vmin=-8.0, vmax=8.0, s=40, edgecolors="black")
right.set(title="point cloud", xlabel="y [m], left > 0", xlim=(16, -16), ylim=(0, 50))
figure.colorbar(points, ax=right, label="velocity [m/s]")
figure.savefig(OUT / "points.png", dpi=110)
print(f"look at {OUT / 'points.png'}")
