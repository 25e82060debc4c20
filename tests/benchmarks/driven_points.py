"""What a list of points finds of a drive, by cells, and whether its probabilities hold: docs/notes/points.md.

    python tests/benchmarks/driven_points.py PATHS CUBES [--model sparse6] [--false-alarms 1]...

PATHS is a folder of ``datafactory trace``, CUBES what ``render --paths PATHS --store cube`` made of it. The truth is
the power that the frame's paths put into each cell of range, Doppler and u (a resolution cell of the full array): the
cells that are largest among their neighbours, and whose power the array sees at 13 dB over the noise, its channels
added; and of each thing (car, walker, pole) that is so strong the cell that its own paths put most into. Both count
within the image's field of view: what stands beyond is not listed. Printed for
``--cells peaks`` and ``all``: the shares of these cells and of these things that a line stands in, or beside; lines a
frame with no path's power nearby; how many lines are true, by the probability that they were given; how many are of
things that move, by the ``moving`` that they were given; and the constants of
:func:`trainer.run.detections.line_probability` that fit these lines best.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
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
from shared.signal.ego_motion import EgoMotion
from shared.signal.windows import cell_noise_power
from trainer.data.measurements import ALL, PEAKS, open_measurements
from trainer.run.answers import NetworkAnswer
from trainer.run.detections import BY_HEAD, BY_LEVEL, FALSE_ALARMS, HIGHEST_DB, Detections
from trainer.run.options import PointsRequest
from trainer.run.predict import Predictor

TOLD_DB, THERE_DB = 13.0, 0.0
"""Over the noise of the array's channels added: cells that count, and cells whose power makes a line true."""
BANDS = ((0.0, 0.5), (0.5, 0.7), (0.7, 0.85), (0.85, 0.95), (0.95, 1.0))
MOVING_BANDS = ((0.0, 0.05), (0.05, 0.2), (0.2, 0.5), (0.5, 0.8), (0.8, 1.0))
MOVES_MPS = 0.2
AROUND = (3, 3, 3)


def main(
    paths: Path,
    cubes: Path,
    model: Annotated[str, typer.Option()] = "sparse6",
    false_alarms: Annotated[list[float], typer.Option()] = [FALSE_ALARMS],  # noqa: B006
) -> None:
    for cells, allowed in product((PEAKS, ALL), false_alarms):
        radar, measurements = open_measurements(cubes, None, "all", cells)
        predictor = Predictor.load(model, radar, PointsRequest(false_alarms=allowed, cells=cells))
        noise = cell_noise_power(radar) / predictor.answer.line.channels
        traced = {f.frame_id: f for file in sorted(paths.glob("**/*.parquet")) for f in read_paths(file)}
        visible = in_view(radar)
        found, things, false, lines, told = [], [], [], [], []
        for measurement in measurements:
            paths_of = EchoCells.of(traced[measurement.frame_id], radar)
            power = paths_of.power()
            seen = predictor(measurement).points
            assert seen is not None
            place = cells_of(seen, radar)
            listed = np.zeros(power.shape, dtype=bool)
            listed[place] = True
            peaks = (power == maximum_filter(power, AROUND, mode="wrap")) & (power > noise * 10.0 ** (TOLD_DB / 10.0))
            beside = maximum_filter(listed, AROUND, mode="wrap")
            found.append(beside[peaks & visible])
            for thing in traced[measurement.frame_id].things:
                own = paths_of.power(thing.indices)
                strongest = np.unravel_index(own.argmax(), own.shape)
                if visible[strongest[-1]] and own[strongest] > noise * 10.0 ** (TOLD_DB / 10.0):
                    things.append(beside[strongest])
            true = (maximum_filter(power, AROUND, mode="wrap") > noise * 10.0 ** (THERE_DB / 10.0))[place]
            false.append(np.count_nonzero(~true))
            lines.append(len(seen))
            of_movers = paths_of.power(movers(traced[measurement.frame_id], measurement.motion))
            moves = (maximum_filter(of_movers, AROUND, mode="wrap") > 0.5 * maximum_filter(power, AROUND, mode="wrap"))[
                place
            ]
            told.append(np.stack([seen.probability, seen.snr_db, seen.unlike_ways_db, true, seen.moving, moves]))
        share, count = np.concatenate(found).mean(), len(np.concatenate(found)) / len(found)
        print(
            f"{cells}, {allowed:g} asked for: {share:.3f} of {count:.0f} cells a frame, {np.sum(things)} of "
            f"{len(things)} things, {np.mean(lines):.0f} lines, {np.mean(false):.1f} false"
        )
        probability, snr_db, unlike_db, truth, moving, moves = np.concatenate(told, axis=1)
        print_bands("said", probability, truth, "true", BANDS)
        print_bands("said to move", moving, moves, f"moves, of all {moves.mean():.3f},", MOVING_BANDS)
        used = BY_HEAD if isinstance(predictor.answer, NetworkAnswer) else BY_LEVEL
        print("  best constants", fitted_constants(probability, snr_db, unlike_db, truth, used))


def print_bands(
    what: str,
    said: NDArray[np.float64],
    so: NDArray[np.float64],
    how: str,
    bands: tuple[tuple[float, float], ...],
) -> None:
    for low, high in bands:
        inside = (said >= low) & (said < high)
        if inside.any():
            print(f"  {what} {low} to {high}: {so[inside].mean():.2f} {how} of {np.count_nonzero(inside)}")


def movers(traced: TracedFrame, own: EgoMotion | None) -> tuple[int, ...]:
    """The objects of things that move over the ground."""
    assert own is not None
    ahead = np.array([own.forward_mps, own.left_mps, 0.0])
    return tuple(
        index
        for thing in traced.things
        if np.linalg.norm(np.array(thing.velocity) + ahead) > MOVES_MPS
        for index in thing.indices
    )


def fitted_constants(
    probability: NDArray[np.float64],
    snr_db: NDArray[np.float64],
    unlike_db: NDArray[np.float64],
    true: NDArray[np.float64],
    used: tuple[float, float, float, float],
) -> NDArray[np.float64]:
    """(a, b, d, c) of :func:`line_probability` of most likelihood; what the head said follows from those used."""
    a, b, c, d = used
    level = np.minimum(snr_db, HIGHEST_DB)
    columns = np.stack([np.ones_like(level), level / 10.0, -unlike_db], axis=1)
    if c:
        columns = np.column_stack([columns, (logit(probability) - a - b * level + d * unlike_db) / c])

    def surprise(weights: NDArray[np.float64]) -> float:
        return float(np.sum(np.logaddexp(0.0, columns @ weights) - true * (columns @ weights)))

    found = minimize(surprise, np.zeros(columns.shape[1])).x
    return np.round(found / np.array([1.0, 10.0, 1.0, 1.0])[: len(found)], 3)


@dataclass(frozen=True)
class EchoCells:
    """The cells in which a frame's paths stand.

    :param place: [3, K] of range, Doppler and u, in resolution cells of the full array; :param watts: [K]
    :param thing: [K] index of the object, negative for none; :param shape: how many cells there are
    """

    place: NDArray[np.intp]
    watts: NDArray[np.float64]
    thing: NDArray[np.int32]
    shape: tuple[int, int, int]

    @classmethod
    def of(cls, traced: TracedFrame, radar: Radar) -> EchoCells:
        """Those within the radar's ranges."""
        table = traced.table.at_wavelength(traced.wavelength_m, radar.waveform.wavelength_m).within(radar)
        table = table.illuminated(radar.front_end)
        array, waveform = radar.virtual_sensor, radar.waveform
        both = ScatteredPaths.joined([table.scattered, table.specular.as_scattered(array.tx[0])])
        mid = at_mid_frame(both, radar, array.tx[0], array.rx.mean(axis=0), False)
        row = np.rint(mid.range_bins).astype(int)
        doppler = (np.rint(mid.doppler).astype(int) + waveform.chirps // 2) % waveform.chirps
        angle = u_cell(mid.rx_point[:, 1] / np.linalg.norm(mid.rx_point, axis=1), radar)
        inside = (row >= 0) & (row < waveform.range_bins)
        shape = (waveform.range_bins, waveform.chirps, u_cells(radar))
        place, watts = np.stack([row, doppler, angle])[:, inside], np.abs(mid.amplitude[inside]) ** 2
        return cls(place, watts, both.object_index[inside], shape)

    def power(self, things: tuple[int, ...] | None = None) -> NDArray[np.float64]:
        """[R, chirps, U] power of the paths in each cell [W]; of those of some things alone, or of all."""
        power, chosen = np.zeros(self.shape), slice(None) if things is None else np.isin(self.thing, things)
        np.add.at(power, tuple(self.place[:, chosen]), self.watts[chosen])
        return power


def cells_of(seen: Detections, radar: Radar) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]:
    """The cell in which each line stands."""
    waveform = radar.waveform
    row = np.clip(np.rint(seen.range_m / waveform.range_step_m).astype(int), 0, waveform.range_bins - 1)
    doppler = np.rint(seen.velocity / waveform.velocity_step_mps).astype(int) + waveform.chirps // 2
    return row, doppler % waveform.chirps, u_cell(seen.u, radar)


def u_cells(radar: Radar) -> int:
    """From u = -1 to 1: of 2 / C, what C channels half a wavelength apart resolve."""
    return radar.array.channels


def in_view(radar: Radar) -> NDArray[np.bool_]:
    """[U] whether a cell's middle lies in the image."""
    count = u_cells(radar)
    middle = (np.arange(count) + 0.5) / count * 2.0 - 1.0
    return (middle >= radar.grid.u[0]) & (middle <= radar.grid.u[-1])


def u_cell(u: NDArray[np.floating], radar: Radar) -> NDArray[np.intp]:
    count = u_cells(radar)
    return np.clip(((np.asarray(u) + 1.0) * 0.5 * count).astype(int), 0, count - 1)


if __name__ == "__main__":
    typer.run(main)
