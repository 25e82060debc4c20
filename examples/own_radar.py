# %% [markdown]
# # A radar of your own: a board whose transmitters send in turns
#
# The AWR1843BOOST has three transmitters (TX) and four receivers (RX). Its TX send one after the other (time-division
# multiplexing, TDM). Two of them stand on the line of the receivers, and make eight channels at half a wavelength.

# %%
from __future__ import annotations

import os
import shutil
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from datafactory import load_radar, read_targets, render
from shared.pictures import draw_levels, level_db
from trainer import RadarDataset, estimators

OUT = Path(os.environ.get("EXAMPLES_OUT", "build/examples")) / "own_radar"
shutil.rmtree(OUT, ignore_errors=True)
OUT.mkdir(parents=True)

# %% [markdown]
# ## The radar's file
#
# It states the board and what its chirps are, as mmWave Studio does. `tx = [1, 3]` leaves the elevated TX out.

# %%
(OUT / "awr1843.toml").write_text(
    """
board = "iwr1843"          # the same antennas as the AWR1843BOOST

[capture]
start_frequency_hz = 77e9
slope_hz_per_s = 30e12
idle_time_s = 7e-6
adc_start_time_s = 6e-6
ramp_end_time_s = 57e-6
samples = 256
sample_rate_hz = 6.25e6
chirps = 64                # of each TX in a frame
tx = [1, 3]

[front_end]
converter = { bits = 12, full_scale_dbm = -20 }
""",
    encoding="utf-8",
)
radar = load_radar(str(OUT / "awr1843.toml"))
waveform, array = radar.waveform, radar.array
print(f"{len(array.tx_m)} TX x {len(array.rx_m)} RX, {waveform.multiplexing}")
print(f"range bins of {100 * waveform.range_step_m:.1f} cm to {waveform.ranges_m[-1]:.1f} m")
print(f"velocities from {waveform.velocities_mps[0]:.2f} to {waveform.velocities_mps[-1]:.2f} m/s")

# %% [markdown]
# ## Three targets
#
# One stands, one comes, one goes. While the TX take turns the movers get on; the processing turns that phase back.
# Without it a mover would stand at a wrong angle.

# %%
(OUT / "targets.json").write_text(
    """[[
  {"x": 6.0, "y": 0.0, "z": 0.0, "rcs_dbsm": 0.0},
  {"x": 9.0, "y": 3.0, "z": 0.0, "vx": -4.0, "rcs_dbsm": 5.0},
  {"x": 12.0, "y": -5.0, "z": 0.0, "vx": 3.0, "rcs_dbsm": 8.0}
]]""",
    encoding="utf-8",
)
render(None, OUT / "frames", radar=radar, frames=0, targets=read_targets(OUT / "targets.json"), split="0:0:1")

# %% [markdown]
# ## Where are they?
#
# An estimator of angle needs no training. It takes the channels of the strongest Doppler peak of each range bin.

# %%
frames = RadarDataset(OUT / "frames", "test")
example = frames[0]
snapshots, noise = example.input[0].numpy(), example.metadata["noise_power"]
velocity = example.metadata["velocity"][0].numpy()
line = estimators.line_array(radar, radar.array.azimuth_channels)
image = estimators.ESTIMATORS["likes"]().image(snapshots, line, frames.u, noise)
for x, y, rate in ((6.0, 0.0, 0.0), (9.0, 3.0, -4.0), (12.0, -5.0, 3.0)):
    row = round(np.hypot(x, y) / waveform.range_step_m)
    strongest = row - 2 + int(image[row - 2 : row + 3].max(axis=1).argmax())
    found = frames.u[image[strongest].argmax()]
    print(
        f"at {frames.range_m[strongest]:.2f} m: u = {found:+.3f} (stated {y / np.hypot(x, y):+.3f}), "
        f"{velocity[strongest]:+.2f} m/s (stated {rate * x / np.hypot(x, y):+.2f})"
    )

# %%
figure = Figure(figsize=(8.0, 4.5), layout="constrained")
methods = {"delay-and-sum": "das", "LIKES": "likes"}
for axis, (title, name) in zip(figure.subplots(1, 2), methods.items(), strict=True):
    shown = estimators.ESTIMATORS[name]().image(snapshots, line, frames.u, noise)
    levels = level_db(shown, float(shown.max()))[:150]
    mesh = draw_levels(axis, levels, frames.radar.waveform.range_step_m, frames.u[0], frames.u[1] - frames.u[0])
    axis.set(title=title, xlabel="left  <-  u = sin(azimuth)  ->  right", ylabel="range [m]")
figure.colorbar(mesh, ax=figure.axes, label="level [dB]")
figure.savefig(OUT / "targets.png", dpi=110)
print(f"look at {OUT / 'targets.png'}")
