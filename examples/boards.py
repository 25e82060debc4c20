"""The boards as a picture: where elements stand, how channels are counted, and to which side angles are positive.

``python examples/boards.py [FILE.png]`` draws docs/boards.png. The images below are delay-and-sum of a target that
:func:`shared.signal.signal.if_signal` puts 20 degrees to the left, 8 m away.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from shared.radar import Radar, load_radar
from shared.signal.signal import if_signal, manifold

BOARDS = ("iwr1843", "awr2944", "mmwcas")
ANGLE_DEG, RANGE_M = 20.0, 8.0


def draw_elements(axis: Axes, radar: Radar, name: str) -> None:
    """TX and RX with their numbers as one who stands behind the board sees them: left is left."""
    for label, positions, colour in (("TX", radar.array.tx, "tab:red"), ("RX", radar.array.rx, "tab:blue")):
        height = positions[:, 2] * 1e3 + (12.0 if label == "TX" else 0.0)
        axis.scatter(positions[:, 1] * 1e3, height, color=colour, marker="s", s=14)
        for number, (y, z) in enumerate(zip(positions[:, 1] * 1e3, height, strict=True), 1):
            many = len(positions) > 4
            axis.annotate(
                str(number), (y, z), (0, 4 + 7 * (many and number % 2)), textcoords="offset points",
                ha="center", fontsize=6 if many else 8, color=colour,
            )  # fmt: skip
        axis.text(0.99, 0.9 if label == "TX" else 0.03, label, color=colour, ha="right", transform=axis.transAxes)
    axis.set(title=f"{name}: {len(radar.array.tx_m)} TX, {len(radar.array.rx_m)} RX, seen from behind", yticks=[])
    axis.set(ylim=(-5.0, 18.0 + positions_above(radar)))


def positions_above(radar: Radar) -> float:
    """Height of the highest TX [mm]."""
    return float(radar.array.tx[:, 2].max() * 1e3)


def draw_channels(axis: Axes, radar: Radar) -> None:
    """Channel over the place of its virtual element."""
    places, line = radar.array.virtual, radar.array.azimuth_channels
    apart = np.setdiff1d(np.arange(radar.array.channels), line)
    axis.scatter(places[line, 1] * 1e3, line, s=5, color="black", label="azimuth line")
    if len(apart):
        axis.scatter(places[apart, 1] * 1e3, apart, s=5, color="tab:orange", label="elevated TX")
    axis.set(ylabel="channel = TX count * rx + tx")
    axis.legend(fontsize=7, loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, frameon=False)


def draw_image(axis: Axes, radar: Radar) -> None:
    """Delay-and-sum of the azimuth line over u."""
    angle = np.deg2rad(ANGLE_DEG)
    place = RANGE_M * np.array([[np.cos(angle), np.sin(angle), 0.0]])
    one_chirp = radar.of_one_chirp
    chirp = if_signal(one_chirp, place, np.zeros((1, 3)), np.ones(1))[0]
    middle = radar.waveform.samples // 2
    tone = np.exp(-4j * np.pi * radar.waveform.slope_hz_per_s * RANGE_M / 299_792_458.0
                  * radar.waveform.chirp_duration_s * (np.arange(radar.waveform.samples) - middle)
                  / radar.waveform.samples)  # fmt: skip
    line = radar.array.azimuth_channels
    snapshot = (tone[:, None] * chirp).mean(axis=0)[line]
    u = np.linspace(-1.0, 1.0, 2001)
    image = np.abs(manifold(radar.array.virtual[line, 1], radar.waveform.wavelength_m, u).conj().T @ snapshot)
    axis.plot(u, 20.0 * np.log10(np.maximum(image / image.max(), 1e-3)), color="black", lw=1.0)
    axis.axvline(np.sin(angle), color="tab:green", lw=1.0, ls="--")
    axis.set_title(
        f"target {ANGLE_DEG:g} deg to the left: peak at u = {u[image.argmax()]:.2f}", color="tab:green", size=10
    )
    axis.set(xlim=(1.0, -1.0), ylim=(-40.0, 2.0), ylabel="delay-and-sum [dB]", xlabel="left  <-  u = y / r  ->  right")
    axis.grid(alpha=0.25)


def draw() -> Figure:
    """A column for each board."""
    figure = Figure(figsize=(15.0, 8.5), layout="constrained")
    axes = figure.subplots(3, len(BOARDS), height_ratios=(1.0, 1.2, 1.2))
    for column, name in zip(axes.T, BOARDS, strict=True):
        radar = load_radar(name)
        draw_elements(column[0], radar, name)
        draw_channels(column[1], radar)
        draw_image(column[2], radar)
        for axis, what in ((column[0], "y of the element [mm]"), (column[1], "y_tx + y_rx [mm]")):
            axis.invert_xaxis()
            axis.set(xlabel=f"left  <-  {what}  ->  right")
    return figure


if __name__ == "__main__":
    draw().savefig(Path(sys.argv[1] if len(sys.argv) > 1 else "docs/boards.png"), dpi=90)
