"""What a list of points finds of a drive, by cells, and whether its probabilities hold: docs/notes/points.md.

    python tests/benchmarks/driven_points.py PATHS CUBES [--model sparse6] [--false-alarms 1]

PATHS is a folder of ``datafactory trace``, CUBES what ``render --paths PATHS --store cube`` made of it. The truth is
the power that the frame's paths put into each cell of range, Doppler and u (a resolution cell of the full array): the
cells that are largest among their neighbours, and whose power the array sees at 13 dB over the noise, its channels
added. Printed for ``--cells peaks`` and ``all``: the share of these cells that a line stands in, or beside; lines a
frame with no path's power nearby; how many lines are true, by the probability that they were given; and the constants
of :mod:`trainer.run.certainty` that fit these lines best.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter
from scipy.optimize import minimize
from scipy.special import logit

from datafactory.paths.storage import TracedFrame, read_paths
from datafactory.paths.table import ScatteredPaths
from datafactory.synthesis.mid_frame import at_mid_frame
from shared.radar import Radar
from shared.signal.windows import cell_noise_power
from trainer.data.measurements import ALL, PEAKS, open_measurements
from trainer.run.answers import NetworkAnswer
from trainer.run.certainty import BY_HEAD, BY_LEVEL, HIGHEST_DB
from trainer.run.detections import FALSE_ALARMS, Detections
from trainer.run.predictor import PointsRequest, Predictor

TOLD_DB, THERE_DB = 13.0, 0.0
"""Over the noise of the array's channels added: cells that count, and cells whose power makes a line true."""
BANDS = ((0.0, 0.5), (0.5, 0.7), (0.7, 0.85), (0.85, 0.95), (0.95, 1.0))
AROUND = (3, 3, 3)


def main(
    paths: Path,
    cubes: Path,
    model: Annotated[str, typer.Option()] = "sparse6",
    false_alarms: Annotated[float, typer.Option()] = FALSE_ALARMS,
) -> None:
    for cells in (PEAKS, ALL):
        radar, measurements = open_measurements(cubes, None, "all", cells)
        predictor = Predictor.load(model, radar, PointsRequest(false_alarms, cells))
        noise = cell_noise_power(radar) / predictor.answer.line.channels
        traced = {f.frame_id: f for file in sorted(paths.glob("**/*.parquet")) for f in read_paths(file)}
        found, false, lines, told = [], [], [], []
        for measurement in measurements:
            power = path_power(traced[measurement.frame_id], radar)
            seen = predictor(measurement).points
            assert seen is not None
            place = cells_of(seen, radar)
            listed = np.zeros(power.shape, dtype=bool)
            listed[place] = True
            peaks = (power == maximum_filter(power, AROUND, mode="wrap")) & (power > noise * 10.0 ** (TOLD_DB / 10.0))
            found.append(maximum_filter(listed, AROUND, mode="wrap")[peaks])
            true = (maximum_filter(power, AROUND, mode="wrap") > noise * 10.0 ** (THERE_DB / 10.0))[place]
            false.append(np.count_nonzero(~true))
            lines.append(len(seen))
            told.append(np.stack([seen.probability, seen.snr_db, true]))
        share, count = np.concatenate(found).mean(), len(np.concatenate(found)) / len(found)
        print(
            f"{cells}: {share:.3f} of {count:.0f} cells a frame, {np.mean(lines):.0f} lines, {np.mean(false):.1f} false"
        )
        probability, snr_db, truth = np.concatenate(told, axis=1)
        for low, high in BANDS:
            inside = (probability >= low) & (probability < high)
            if inside.any():
                print(f"  said {low} to {high}: {truth[inside].mean():.2f} true of {np.count_nonzero(inside)}")
        print(
            "  best constants",
            fitted_constants(
                probability, snr_db, truth, BY_HEAD if isinstance(predictor.answer, NetworkAnswer) else BY_LEVEL
            ),
        )


def fitted_constants(
    probability: NDArray[np.float64],
    snr_db: NDArray[np.float64],
    true: NDArray[np.float64],
    used: tuple[float, float, float],
) -> NDArray[np.float64]:
    """(a, b, c) of :mod:`trainer.run.certainty` of most likelihood; what the head said follows from those used."""
    a, b, c = used
    level = np.minimum(snr_db, HIGHEST_DB)
    columns = np.stack([np.ones_like(level), level / 10.0], axis=1)
    if c:
        columns = np.column_stack([columns, (logit(probability) - a - b * level) / c])

    def surprise(weights: NDArray[np.float64]) -> float:
        return float(np.sum(np.logaddexp(0.0, columns @ weights) - true * (columns @ weights)))

    found = minimize(surprise, np.zeros(columns.shape[1])).x
    return np.round(found / np.array([1.0, 10.0, 1.0])[: len(found)], 3)


def path_power(traced: TracedFrame, radar: Radar) -> NDArray[np.float64]:
    """[R, chirps, U] power of a frame's paths in each cell [W], u in resolution cells of the full array."""
    table = traced.table.at_wavelength(traced.wavelength_m, radar.waveform.wavelength_m).within(radar)
    table = table.illuminated(radar.front_end)
    array, waveform = radar.virtual_sensor, radar.waveform
    both = ScatteredPaths.joined([table.scattered, table.specular.as_scattered(array.tx[0])])
    mid = at_mid_frame(both, radar, array.tx[0], array.rx.mean(axis=0), False)
    power = np.zeros((waveform.range_bins, waveform.chirps, u_cells(radar)))
    row = np.rint(mid.range_bins).astype(int)
    doppler = (np.rint(mid.doppler).astype(int) + waveform.chirps // 2) % waveform.chirps
    angle = u_cell(mid.rx_point[:, 1] / np.linalg.norm(mid.rx_point, axis=1), radar)
    inside = (row >= 0) & (row < len(power))
    np.add.at(power, (row[inside], doppler[inside], angle[inside]), np.abs(mid.amplitude[inside]) ** 2)
    return power


def cells_of(seen: Detections, radar: Radar) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]:
    """The cell of :func:`path_power` in which each line stands."""
    waveform = radar.waveform
    row = np.clip(np.rint(seen.range_m / waveform.range_step_m).astype(int), 0, waveform.range_bins - 1)
    doppler = np.rint(seen.velocity / waveform.velocity_step_mps).astype(int) + waveform.chirps // 2
    return row, doppler % waveform.chirps, u_cell(seen.u, radar)


def u_cells(radar: Radar) -> int:
    """From u = -1 to 1: of 2 / C, what C channels half a wavelength apart resolve."""
    return radar.array.channels


def u_cell(u: NDArray[np.floating], radar: Radar) -> NDArray[np.intp]:
    count = u_cells(radar)
    return np.clip(((np.asarray(u) + 1.0) * 0.5 * count).astype(int), 0, count - 1)


if __name__ == "__main__":
    typer.run(main)
