"""Lines beside a strong reflector, as imperfect boards see it: docs/notes/points.md.

    python tests/benchmarks/boards.py [--boards 100] [--method das]

One chirp of 256 samples by the 192 channels of TI's cascade: a reflector at 4.6 m, 50 to 65 dB over the noise of a
channel, and thirty echoes of a small room, 0 to 25 dB over it. Each frame is recorded by a board of its own, calibrated
as :class:`trainer.run.configuration.Imperfections` has it, and by boards of which one fault is taken away. The fit is
told what the calibration of each board reports of its model error, and the frame's noise as ``trainer import`` measures
it. Printed for each kind of board: the lines within 30
and within 40 dB of the reflector that stand at no echo, sorted by whether they share its range (ghosts) or not
(sidelobes), echoes listed, and how many lines are true by the probability that they were given.
"""

from dataclasses import dataclass, field
from itertools import pairwise
from typing import Annotated, Any

import numpy as np
import torch
import typer

from shared.radar import Radar
from shared.radar.boards import mmwcas
from shared.radar.waveform import Waveform
from shared.signal.windows import cell_noise_power
from trainer.data.measurements import Cells
from trainer.data.simulation import amplitude_of, in_plane, snapshot
from trainer.estimators.array import line_array
from trainer.estimators.base import ESTIMATORS
from trainer.estimators.fitting import MODEL_ERROR_DB
from trainer.run.configuration import CALIBRATED
from trainer.run.detections import Sought, find_detections
from trainer.training.imperfections import BoardErrors

ECHOES, REFLECTOR_M = 30, 4.6
NEAR_BINS, NEAR_CELLS = 1.0, 1.0
SPANS_DB = (30.0, 40.0)
BANDS = (0.0, 0.5, 0.7, 0.85, 0.95, 1.0 + 1e-9)
ALL_FAULTS = CALIBRATED.model_copy(update={"perfect": 0.0, "dead": 0.0})
WITHOUT: dict[str, dict[str, Any]] = {
    "calibrated": {}, "no phase noise": {"phase_noise": None}, "no coupling": {"coupling_db": None},
    "no gain, phase, place": {"gain_db": (0.0, 0.0), "phase_deg": (0.0, 0.0), "position_m": (0.0, 0.0)},
    "perfect": {"perfect": 1.0},
}  # fmt: skip


@dataclass
class Tally:
    """Of the frames of one kind of board."""

    ghosts: list[list[int]] = field(default_factory=list)
    sidelobes: list[list[int]] = field(default_factory=list)
    listed: list[float] = field(default_factory=list)
    told: list[tuple[float, bool]] = field(default_factory=list)


def main(
    boards: Annotated[int, typer.Option()] = 100,
    method: Annotated[str, typer.Option()] = "das",
    told: Annotated[bool, typer.Option(help="Whether the fit is told the model error.")] = True,
) -> None:
    waveform = Waveform(chirps=1, samples=256, range_bins=256, bandwidth_hz=1.0e9)
    radar = Radar(waveform=waveform, array=mmwcas().array)
    for name, without in WITHOUT.items():
        recorder = BoardErrors(ALL_FAULTS.model_copy(update=without), radar, np.arange(radar.array.channels))
        tally = Tally()
        for number in range(boards):
            add(tally, recorder, radar, number, method, told)
        show = " ".join(
            f"{kind} {np.mean(of, axis=0)[0]:.2f}, {np.mean(of, axis=0)[1]:.2f}"
            for kind, of in (("ghosts", tally.ghosts), ("sidelobes", tally.sidelobes))
        )
        print(f"{name}: within 30, 40 dB: {show}; {np.mean(tally.listed):.2f} of the echoes listed")
        probability, true = np.array(tally.told).T
        for low, high in pairwise(BANDS):
            inside = (probability >= low) & (probability < high)
            if inside.any():
                print(f"  said {low} to {high:.2f}: {true[inside].mean():.2f} true of {np.count_nonzero(inside)}")


def add(tally: Tally, recorder: BoardErrors, radar: Radar, number: int, method: str, told: bool) -> None:
    """One frame of one board."""
    draw, step = np.random.default_rng([44, number]), radar.waveform.range_step_m
    range_m = np.concatenate([[REFLECTOR_M + draw.uniform(-0.5, 0.5) * step], draw.uniform(1.5, 8.0, ECHOES)])
    u = np.concatenate([draw.uniform(-0.2, 0.2, 1), draw.uniform(-0.8, 0.8, ECHOES)])
    snr_db = np.concatenate([draw.uniform(50.0, 65.0, 1), draw.uniform(0.0, 25.0, ECHOES)])
    amplitude = np.array([amplitude_of(level, radar) for level in snr_db])
    amplitude = amplitude * np.exp(2j * np.pi * draw.random(len(u)))
    ideal = snapshot(radar, in_plane(range_m, u), amplitude, draw)
    noise, array = cell_noise_power(radar), line_array(radar)
    values, errors = recorder(
        7, number, [0], torch.from_numpy(ideal[None].astype(np.complex64)), torch.tensor([noise]), np.zeros(1)
    )
    rows = values[0].numpy()
    noise = float(np.median(np.abs(rows) ** 2) / np.log(2.0))  # the converter's is in it
    level = max(MODEL_ERROR_DB, 10.0 * float(np.log10(max(float(errors[0]), 1e-9)))) if told else MODEL_ERROR_DB
    image = ESTIMATORS[method]().image(rows, array, radar.grid.u, noise)[None]
    seen = Cells(rows[None], np.zeros((1, len(rows)), np.float32))
    found = find_detections(image, None, seen, radar, array, Sought(noise, level))
    cell = array.resolution_cell
    bins = np.abs(found.range_m[:, None] - range_m) / step
    true = ((bins <= NEAR_BINS) & (np.abs(found.u[:, None] - u) <= NEAR_CELLS * cell)).any(axis=1)
    below = 20.0 * np.log10(np.abs(amplitude[0])) - found.amplitude_db
    beside = bins[:, 0] <= NEAR_BINS
    tally.ghosts.append([int((~true & beside & (below < span)).sum()) for span in SPANS_DB])
    tally.sidelobes.append([int((~true & ~beside & (below < span)).sum()) for span in SPANS_DB])
    hit = ((bins <= NEAR_BINS) & (np.abs(found.u[:, None] - u) <= NEAR_CELLS * cell)).any(axis=0)
    tally.listed.append(float(hit[1:].mean()))
    tally.told += list(zip(found.probability.tolist(), true.tolist(), strict=True))


if __name__ == "__main__":
    typer.run(main)
