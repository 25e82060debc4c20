"""Targets that move in themselves as a picture: a walker and a car with turning wheels, Doppler over time.

``python examples/micro_doppler.py [FILE.png]`` draws docs/micro_doppler.png. Every column is a frame of the default
radar's 128 chirps, summed over range.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from datafactory.paths.echo_points import Seen, all_echo_points
from datafactory.paths.table import PathTable, ScatteredPaths
from datafactory.scenes.scene import PointTarget
from datafactory.scenes.targets.models import Car, Pedestrian
from datafactory.synthesis.cube import cube_of_paths
from shared.physics.units import power_to_db
from shared.radar import Radar
from shared.radar.arrays import AntennaArray
from shared.signal.spectrum import range_doppler

TOWARDS = ((-1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, 1.0))
WALKER = PointTarget("walker", (14.0, 0.5, -0.8), -1.37, (-1.4, 0.0, 0.0), Pedestrian(1.75, 0.0), TOWARDS)
CAR = PointTarget("car", (16.0, -3.0, -0.5), 11.25, (-5.0, 0.0, 0.0), Car(0.32), TOWARDS)
SPAN_DB = 50.0


def one_channel() -> Radar:
    """The default radar with one TX and one RX at its origin, and 150 range bins."""
    full = Radar()
    waveform = full.waveform.model_copy(update={"samples": 150, "range_bins": 150})
    array = AntennaArray(tx_m=((0.0, 0.0, 0.0),), rx_m=((0.0, 0.0, 0.0),))
    return full.model_copy(update={"waveform": waveform, "array": array})


def spectrum(target: PointTarget, time_s: float, radar: Radar) -> NDArray[np.float64]:
    """Power over Doppler of a frame that begins at a time [W]."""
    wavelength = radar.waveform.wavelength_m
    x, y, z = np.array(target.position) + time_s * np.array(target.velocity)
    target = replace(target, position=(float(x), float(y), float(z)))
    points = all_echo_points([target], (0.0, 0.0, 0.0), Seen(wavelength, time_s)).heard()
    range_m = np.linalg.norm(points.position, axis=1)
    amplitude = wavelength * np.sqrt(points.rcs_m2) / (4.0 * np.pi) ** 1.5 / range_m**2
    table = PathTable(ScatteredPaths.of_points(points.position, points.velocity, amplitude))
    cube = cube_of_paths(table.illuminated(radar.front_end), radar, 1e-4).astype(np.complex64)
    power: NDArray[np.float64] = (np.abs(range_doppler(cube, radar)) ** 2).sum(axis=(0, 2))
    return power


def main() -> None:
    """Draw both, each with and without its option."""
    radar = one_channel()
    velocity = radar.waveform.velocities_mps
    rigid = {"walker": replace(WALKER, model=Pedestrian()), "car": replace(CAR, model=Car())}
    figure = Figure(figsize=(10.0, 7.0), layout="constrained")
    axes = figure.subplots(2, 2, width_ratios=(4, 1))
    for row, (target, times, limits) in zip(
        axes,
        ((WALKER, np.arange(0.0, 2.4, 0.012), (-6.0, 2.0)), (CAR, np.arange(0.0, 0.9, 0.005), (-12.0, 2.0))),
        strict=True,
    ):
        columns = np.array([spectrum(target, float(time), radar) for time in times]).T
        level = power_to_db(columns / columns.max())
        row[0].imshow(
            level, aspect="auto", origin="lower", vmin=-SPAN_DB, vmax=0.0, cmap="viridis", interpolation="nearest",
            extent=(float(times[0]), float(times[-1]), float(velocity[0]), float(velocity[-1])),
        )  # fmt: skip
        speed = -target.velocity[0]
        what = "stature_m = 1.75" if target is WALKER else "wheel_radius_m = 0.32"
        row[0].set(title=f"{target.name}, {what}, {speed:g} m/s towards the radar", ylim=limits)
        row[0].set(xlabel="time [s]", ylabel="range rate [m/s]")
        still = np.mean([spectrum(rigid[target.name], float(time), radar) for time in times[::10]], axis=0)
        row[1].plot(power_to_db(columns.mean(axis=1) / columns.mean(axis=1).max()), velocity, label="option on")
        row[1].plot(power_to_db(still / still.max()), velocity, label="off", linestyle=":")
        row[1].set(xlim=(-SPAN_DB, 3.0), ylim=limits, xlabel="mean over time [dB]")
        row[1].legend(fontsize=7)
    figure.savefig(Path(sys.argv[1] if len(sys.argv) > 1 else "docs/micro_doppler.png"), dpi=90)


if __name__ == "__main__":
    main()
