"""Rows of imperfect channels at 60 dB SNR, and which of their lines are wrong.

``python tests/trainer/measured_rows.py`` prints how many of 200 rows are wrong by estimator, told the thermal noise
alone and told the model error too.
"""

import numpy as np
from numpy.typing import NDArray
from paper_arrays import ARRAYS, U, echoes, noise
from scipy.signal import find_peaks

from shared.signal.model_error import NO_MODEL_ERROR_DB, row_noise
from trainer.estimators.array import LineArray
from trainer.estimators.base import ESTIMATORS, Estimator
from trainer.estimators.fitting import fit_lines
from trainer.estimators.ml import MaximumLikelihood

THERMAL = 1e-6
MODEL_ERROR_DB = -20.0
ROWS = 24
APART_DEG = 7.0
LEAST_DB = -15.0
"""A line of the image less than that below the row's largest is no target: the error of a channel is -20 dB."""
NEAR_CELLS = 0.25


def measured_rows(
    array: LineArray, targets: int, count: int = ROWS, seed: int = 0
) -> tuple[NDArray[np.complex128], NDArray[np.float64]]:
    """(rows [R, C] of unit reflectors at random phases, APART_DEG apart, u [R, K]); each row has a board of its own.

    Gain (of the amplitude) and phase [rad] of each channel have the same deviation; their powers add to the error's.
    """
    generator = np.random.default_rng(seed)
    first = generator.uniform(-35.0, 25.0, count)
    u = np.sin(np.deg2rad(first[:, None] + APART_DEG * np.arange(targets)))
    clean = echoes(array, u, np.exp(2j * np.pi * generator.random(u.shape)))
    deviation = np.sqrt(0.5 * 10.0 ** (MODEL_ERROR_DB / 10.0))
    gain, phase = deviation * generator.standard_normal((2, count, array.channels))
    return clean * (1.0 + gain) * np.exp(1j * phase) + noise(array, count, THERMAL, generator), u


def estimator_of(name: str, targets: int) -> Estimator:
    return MaximumLikelihood(targets) if name == "ml" else ESTIMATORS[name]()


def wrong_rows(image: NDArray[np.float64], u: NDArray[np.float64], array: LineArray) -> int:
    """Rows whose lines above LEAST_DB are not as many as the reflectors, or not each near its own."""
    wrong = 0
    for row, places in zip(image, u, strict=True):
        peaks = find_peaks(np.pad(row, 1), height=max(row.max(), 1e-30) * 10.0 ** (LEAST_DB / 20.0))[0] - 1
        near = len(peaks) == len(places) and np.abs(U[peaks] - places).max() < NEAR_CELLS * array.resolution_cell
        wrong += not near
    return wrong


def fit_counts(rows: NDArray[np.complex128], array: LineArray, model_error_db: float) -> NDArray[np.intp]:
    """[R] lines that the fit finds, begun with none."""
    found = fit_lines(rows, array, THERMAL, np.empty((len(rows), 0)), model_error_db)
    return np.count_nonzero(found.amplitude, axis=1)


def main(count: int = 200) -> None:
    """The table of docs/notes/measured.md."""
    names = ("iaa", "iaa-view", "omp", "omp-cfar", "spice", "likes", "ml")
    cases = [(array, targets) for array in ("sparse6", "sparse4") for targets in (1, 2)]
    measured = {case: measured_rows(ARRAYS[case[0]], case[1], count) for case in cases}
    for name in (*names, "line fit"):
        cells = []
        for (array, targets), (rows, u) in measured.items():
            for error in (NO_MODEL_ERROR_DB, MODEL_ERROR_DB):
                if name == "line fit":
                    cells.append(int(np.sum(fit_counts(rows, ARRAYS[array], error) != targets)))
                    continue
                told = THERMAL if error == NO_MODEL_ERROR_DB else np.asarray(row_noise(rows, THERMAL, error))
                image = estimator_of(name, targets).image(rows, ARRAYS[array], U, told)
                cells.append(wrong_rows(image, u, ARRAYS[array]))
        print(f"| {name} | {' | '.join(map(str, cells))} |")


if __name__ == "__main__":
    main()
