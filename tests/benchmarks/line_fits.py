"""The compiled line fit beside OMP-CFAR on the same drawn rows, one thread each."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from record import Record, timed
from workloads import Workload

from shared.radar import Radar
from trainer.data.arrays import choose_array
from trainer.estimators.base import ESTIMATORS, LineArray, line_array
from trainer.estimators.fitting import fit_lines

SEED = 1
MOST_LINES, SNR_DB = 5, (5.0, 40.0)
"""Of a row, uniform; of each line in one channel."""
WITH_LINES = 0.6
"""Share of the rows; the others are noise."""
U = np.linspace(-0.85, 0.85, 450)


def dense_frame(work: Workload) -> Record:
    """Three Doppler peaks of 630 range bins, 18 channels."""
    radar = Radar()
    array = line_array(radar, choose_array("sparse6", radar).channels(radar))
    return _beside_omp(work, "lines_of_a_dense_frame_vs_omp_cfar", array, 3 * 630)


def wide_board(work: Workload) -> Record:
    """256 range bins of 192 channels half a wavelength apart."""
    return _beside_omp(work, "lines_of_192_channels_vs_omp_cfar", LineArray(0.5 * np.arange(192.0), 1.0), 256)


def drawn_rows(array: LineArray, rows: int) -> NDArray[np.complex128]:
    """[rows, C] lines at random angles in noise of power 1."""
    draw = np.random.default_rng(SEED)
    x = draw.standard_normal((rows, array.channels, 2)) @ np.array([1.0, 1.0j]) / np.sqrt(2.0)
    for row in x[: round(WITH_LINES * rows)]:
        lines = int(draw.integers(1, MOST_LINES, endpoint=True))
        strength = 10.0 ** (draw.uniform(*SNR_DB, lines) / 20.0) * np.exp(2j * np.pi * draw.random(lines))
        row += array.manifold(draw.uniform(-0.8, 0.8, lines)) @ strength
    return np.asarray(x, dtype=np.complex128)


def _beside_omp(work: Workload, name: str, array: LineArray, rows: int) -> Record:
    x, none = drawn_rows(array, rows), np.empty((rows, 0))
    omp = ESTIMATORS["omp-cfar"]()
    fit_lines(x[:1], array, 1.0, none[:1])  # compiled
    ours, lines = timed(lambda: fit_lines(x, array, 1.0, none), work.size.repeats)
    reference, _ = timed(lambda: omp.image(x, array, U, 1.0), work.size.repeats)
    found = int(np.count_nonzero(lines.amplitude))
    return Record(
        name=name,
        ours_time=ours,
        reference="omp-cfar, 1 thread",
        reference_time=reference,
        error=0.0,
        error_unit="not compared",
        ours="fit_lines, 1 thread",
        details={"rows": rows, "channels": array.channels, "lines": found, "lines a second": found / ours.seconds},
    )
