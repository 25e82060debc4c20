"""Whether the list of ``trainer predict --points`` has a target once that moves through range bins in the frame.

    python tests/benchmarks/migration.py [--echoes 12] [--seed 0]

Lone echoes by the sum of eq. (1), 40 bins apart, at drawn angles and places between bins and Doppler cells, coming or
going; the default radar, 6 receivers. The fit begins with the peaks of delay and sum. Printed by level and speed, of
three Doppler peaks and of every cell: lines listed within four bins of an echo and 0.03 in u; as many as echoes are
right. Beyond 12 m/s velocities are folded.
"""

from typing import Annotated

import numpy as np
import typer

from shared.radar import Radar
from shared.signal import if_signal
from shared.signal.spectrum import range_doppler, select_doppler
from shared.signal.windows import cell_noise_power
from trainer.data.arrays import choose_array
from trainer.data.cfar import cfar_cells
from trainer.data.measurements import Cells
from trainer.data.simulation import amplitude_of, in_plane
from trainer.estimators.array import line_array
from trainer.estimators.base import ESTIMATORS
from trainer.run.detections import Sought, find_detections

LEVELS_DB, SPEEDS_MPS = (20.0, 30.0, 40.0), (0.0, 4.0, 8.0, 11.0, 14.0, 20.0)
FIRST_BIN, BINS_APART = 60, 40
NEAR_BINS, NEAR_U = 4.0, 0.03


def main(echoes: Annotated[int, typer.Option()] = 12, seed: Annotated[int, typer.Option()] = 0) -> None:
    radar = Radar()
    waveform, power = radar.waveform, cell_noise_power(radar)
    channels = choose_array("sparse6", radar).channels(radar)
    array = line_array(radar, channels)
    for level_db in LEVELS_DB:
        for speed_mps in SPEEDS_MPS:
            draw = np.random.default_rng(seed)
            bins = FIRST_BIN + BINS_APART * np.arange(echoes) + draw.uniform(-0.5, 0.5, echoes)
            u = draw.uniform(-0.6, 0.6, echoes)
            place = in_plane(bins * waveform.range_step_m, u)
            rate = speed_mps * draw.choice([-1.0, 1.0], echoes)
            rate += draw.uniform(-0.5, 0.5, echoes) * waveform.velocity_step_mps
            velocity = place / np.linalg.norm(place, axis=1, keepdims=True) * rate[:, None]
            start = place - 0.5 * waveform.chirps * waveform.chirp_interval_s * velocity
            cube = if_signal(radar, start, velocity, np.full(echoes, amplitude_of(level_db, radar)))
            cube += draw.normal(0.0, np.sqrt(0.5 * radar.sample_noise_power_w), (*cube.shape, 2)) @ [1.0, 1.0j]
            spectra = range_doppler(cube.astype(np.complex64), radar)
            listed = []
            for chosen, centre in ((select_doppler(spectra, power), None), cfar_cells(spectra)):
                rows = chosen.range_channel[..., channels]
                image = np.stack([ESTIMATORS["das"]().image(peak, array, radar.grid.u, power) for peak in rows])
                seen = Cells(rows, chosen.velocities_mps(waveform).astype(np.float32), centre)
                found = find_detections(image, None, seen, radar, array, Sought(power))
                near = np.abs(found.range_m / waveform.range_step_m - bins[:, None]) < NEAR_BINS
                listed.append(np.count_nonzero(near & (np.abs(found.u - u[:, None]) < NEAR_U)))
            print(
                f"{level_db:.0f} dB, {speed_mps:.0f} m/s: {listed[0]} of peaks, {listed[1]} of all, {echoes} are right"
            )


if __name__ == "__main__":
    typer.run(main)
