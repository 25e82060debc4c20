"""What the list of ``trainer predict --points`` is worth on close pairs, and on noise alone.

    python tests/benchmarks/points.py [--frames 160] [--seed 35] [--noise] [--false-alarms 1] [--cells peaks|all]

Each frame has eight equal pairs at rest, half a resolution cell of the full array apart, 19.5 dB in a channel, at 8 to
40 m, between range bins, random phases; the Doppler cells are chosen as in a dataset. The fit begins with the peaks of
delay and sum. Printed for each array: pairs of which both are listed within half their separation, lines more
than half a metre from every target (all, of noise alone), seconds of processor time a frame.
"""

import time
from typing import Annotated

import numpy as np
import typer
from numpy.typing import NDArray

from shared.radar import Radar
from shared.signal import if_signal
from shared.signal.spectrum import range_doppler, select_doppler
from shared.signal.windows import cell_noise_power
from trainer.data.arrays import choose_array
from trainer.data.cfar import cfar_cells
from trainer.data.measurements import ALL, PEAKS, Cells
from trainer.data.simulation import amplitude_of, in_plane
from trainer.estimators.array import line_array
from trainer.estimators.base import ESTIMATORS
from trainer.run.detections import FALSE_ALARMS, Sought, find_detections

ARRAYS = ("sparse6", "sparse4", "full")
PAIRS, SNR_DB, FALSE_M = 8, 19.5, 0.5
BINS = np.arange(54, 266, 8)


def main(
    frames: Annotated[int, typer.Option()] = 160,
    seed: Annotated[int, typer.Option()] = 35,
    noise: Annotated[bool, typer.Option("--noise")] = False,
    false_alarms: Annotated[float, typer.Option()] = FALSE_ALARMS,
    cells: Annotated[str, typer.Option()] = PEAKS,
) -> None:
    radar, draw = Radar(), np.random.default_rng(seed)
    channels = {name: choose_array(name, radar).channels(radar) for name in ARRAYS}
    cell, step = line_array(radar).resolution_cell, radar.waveform.range_step_m
    listed: dict[str, list[bool]] = {name: [] for name in channels}
    false: dict[str, list[int]] = {name: [] for name in channels}
    seconds: dict[str, list[float]] = {name: [] for name in channels}
    for _ in range(frames):
        range_m = step * (draw.choice(BINS, PAIRS, replace=False) + draw.uniform(-0.5, 0.5, PAIRS))
        u = draw.uniform(-0.6, 0.6, PAIRS)[:, None] + 0.25 * cell * np.array([-1.0, 1.0])
        place = in_plane(np.repeat(range_m, 2), u.ravel())
        amplitude = 0.0 if noise else amplitude_of(SNR_DB, radar)
        cube = drawn_cube(radar, place, amplitude * np.exp(2j * np.pi * draw.random(2 * PAIRS)), draw)
        power = cell_noise_power(radar)
        spectra = range_doppler(cube, radar)
        chosen, centre = cfar_cells(spectra) if cells == ALL else (select_doppler(spectra, power), None)
        for name, used in channels.items():
            array, rows = line_array(radar, used), chosen.range_channel[..., used]
            image = np.stack([ESTIMATORS["das"]().image(peak, array, radar.grid.u, power) for peak in rows])
            sought = Sought(power, false_alarms=false_alarms)
            began = time.process_time()
            seen = Cells(rows, chosen.velocities_mps(radar.waveform).astype(np.float32), centre)
            found = find_detections(image, None, seen, radar, array, sought)
            seconds[name].append(time.process_time() - began)
            at = in_plane(found.range_m, found.u)
            off = np.linalg.norm(at[:, None] - place, axis=2).min(axis=1, initial=np.inf)
            false[name].append(len(found) if noise else int(np.count_nonzero(off > FALSE_M)))
            near = np.abs(found.range_m - range_m[:, None]) < step
            hit = near[:, None] & (np.abs(found.u - u[..., None]) < 0.25 * cell)
            listed[name] += np.all(np.any(hit, axis=2), axis=1).tolist()
    for name in channels:
        pairs = f"{np.mean(listed[name]):.3f} of {len(listed[name])}"
        lines, cost = f"{np.mean(false[name]):.2f} a frame", f"{np.median(seconds[name]):.3f} s a frame"
        print(f"{name}: pairs {pairs}, false lines {lines}, {cost}")


def drawn_cube(
    radar: Radar, place: NDArray[np.float64], amplitude: NDArray[np.complex128], draw: np.random.Generator
) -> NDArray[np.complex64]:
    """[chirps, samples, C] of resting targets, every chirp alike but for its noise."""
    waveform = radar.waveform
    single = radar.model_copy(update={"waveform": waveform.model_copy(update={"chirps": 1})})
    shape = (waveform.chirps, waveform.samples, radar.array.channels, 2)
    cube = draw.standard_normal(shape, dtype=np.float32).view(np.complex64)[..., 0]
    cube *= np.float32(np.sqrt(0.5 * radar.sample_noise_power_w))
    cube += if_signal(single, place, np.zeros_like(place), amplitude).astype(np.complex64)
    return cube


if __name__ == "__main__":
    typer.run(main)
