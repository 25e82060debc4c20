"""The experiment ``resolution``: the guide's probabilities, efficiency against the bounds, a table with every cell."""

import math
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from paper_arrays import FAR, deterministic_bound

from shared.radar import load_radar
from trainer.data.arrays import ArrayChoice, choose_array
from trainer.data.simulation import TrialCondition, Trials, simulate
from trainer.evaluation.experiments.bench import Bench, Results
from trainer.evaluation.experiments.contenders import Contender, estimator_contender
from trainer.evaluation.experiments.resolution import PAIRS, SINGLES, Resolution, locate_targets
from trainer.evaluation.experiments.robustness import Impairment, channel_factors, displaced
from trainer.evaluation.options import EvaluationConfig
from trainer.evaluation.report.tables import Numbers, condition_text
from trainer.metrics.bootstrap import wilson
from trainer.metrics.peaks import resolved, single_source_bound

PLANE_FROM_M = 200.0
"""From here on the fronts are flat to 0.01 rad over the array. At 12 m they are bent by 0.15 rad, which costs maximum
likelihood more than the noise does at 30 dB: of pairs a quarter of a cell apart it then resolves half."""


@cache
def trials_of(condition: TrialCondition, trials: int, seed: int) -> Trials:
    return simulate(FAR, condition, trials, [seed])


def located(
    method: str, array: str, condition: TrialCondition, trials: int, seed: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """([T, K] angles that a method finds on an array, [T, K] the true ones, [T] phases), of plane waves."""
    drawn = trials_of(condition, trials, seed)
    found = locate_targets(contender(method, array), drawn)["found"]
    plane = np.tile(drawn.rows * FAR.waveform.range_step_m >= PLANE_FROM_M, len(drawn.snapshots))
    return found[plane], drawn.u[plane], drawn.phase_rad[plane]


def contender(method: str, array: str) -> Contender:
    return estimator_contender(method, choose_array(array, FAR), FAR)


def error_over_bound(array: str, snr_db: float, trials: int) -> tuple[float, float]:
    """(root-mean-square error of maximum likelihood of one target over the root of the bound, bias over its error)."""
    found, true, _ = located("ml", array, TrialCondition(0.0, snr_db), trials, 3)
    errors = (found - true)[:, 0]
    rmse = math.sqrt(float(np.mean(errors**2)))
    bias = float(errors.mean()) / (rmse / math.sqrt(len(errors)))
    bound = single_source_bound(contender("ml", array).answer.line, 10.0 ** (snr_db / 10.0))
    return rmse / math.sqrt(bound), bias


@pytest.mark.parametrize(("array", "snr_db"), [("full", 0.0), ("sparse6", 5.0), ("sparse4", 10.0), ("sparse4", 30.0)])
def test_maximum_likelihood_is_efficient_above_its_threshold(array: str, snr_db: float) -> None:
    ratio, bias = error_over_bound(array, snr_db, 2200)
    assert 0.95 <= ratio <= 1.1
    assert abs(bias) < 4.0


def test_below_the_threshold_sidelobes_take_over() -> None:
    assert error_over_bound("sparse4", 0.0, 550)[0] > 3.0


def test_maximum_likelihood_of_pairs_is_efficient() -> None:
    found, true, phase = located("ml", "sparse6", TrialCondition(1.0, 20.0), 440, 5)
    whole = contender("ml", "full").answer.line
    middle = 0.5 * (whole.positions_m.min() + whole.positions_m.max())
    at_origin = phase + 2.0 * np.pi / whole.wavelength_m * middle * np.diff(true, axis=1)[:, 0]
    line = contender("ml", "sparse6").answer.line
    variances = []
    for u, turn in zip(true, at_origin, strict=True):
        amplitudes = 10.0 * np.exp(1j * np.array([0.0, turn])).astype(np.complex128)  # 20 dB over noise of power 1
        variances.append(np.diag(deterministic_bound(line, u, np.outer(amplitudes, amplitudes.conj()), 1.0)))
    ratio = math.sqrt(float(np.mean((found - true) ** 2)) / float(np.mean(variances)))
    assert 0.9 <= ratio <= 1.1


def test_one_target_is_located_where_it_stands() -> None:
    found, true, _ = located("ml", "full", TrialCondition(0.0, 60.0), 10, 0)
    np.testing.assert_allclose(found, true, atol=1e-4)


GUIDE = {
    ("sparse6", 1.0, "das"): (0.61, 0.68, 0.73),
    ("sparse6", 0.5, "das"): (0.07, 0.08, 0.12),
    ("sparse6", 0.5, "iaa"): (0.56, 0.81, 1.0),
    ("sparse6", 0.5, "ml"): (0.84, 0.99, 1.0),
    ("sparse6", 0.25, "ml"): (0.26, 0.78, 0.97),
    ("sparse4", 1.0, "iaa"): (0.69, 0.94, 1.0),
    ("sparse4", 0.5, "iaa"): (0.28, 0.58, 0.83),
    ("sparse4", 0.5, "ml"): (0.73, 0.97, 1.0),
    ("sparse4", 0.25, "das"): (0.0, 0.0, 0.0),
}
"""P(resolve) of the project's facts at 10, 20 and 30 dB, from 200 trials: a standard error of up to 0.035."""


@pytest.mark.parametrize(("array", "separation", "method"), GUIDE)
def test_probability_of_resolution_is_that_of_the_guide(array: str, separation: float, method: str) -> None:
    for snr_db, expected in zip((10.0, 20.0, 30.0), GUIDE[array, separation, method], strict=True):
        found, true, _ = located(method, array, TrialCondition(separation, snr_db), 110, 0)
        assert len(found) >= 100
        probability = wilson(int(resolved(found, true).sum()), len(found))
        # 0.08, or the Wilson intervals of these trials and the guide's standard error.
        assert probability.low - 0.08 <= expected <= probability.high + 0.08, snr_db


def small_bench() -> Bench:
    """Delay-and-sum on two arrays, no data: this experiment simulates its own."""
    contenders = tuple(contender("das", array) for array in ("sparse6", "sparse4"))
    return Bench("0" * 64, FAR, (), frozenset(), contenders, EvaluationConfig(trials=10))


def counted(experiment: Resolution, bench: Bench, results: Results) -> Numbers:
    numbers = Numbers(experiment.name, 0)
    experiment.count(bench, results, numbers)
    return numbers


def test_a_resolution_table_has_every_cell_once() -> None:
    experiment, bench = Resolution(), small_bench()
    tasks = experiment.tasks(bench)
    # Delay-and-sum and maximum likelihood.
    assert len({task.key for task in tasks}) == len(tasks) == 2 * 2 * (len(PAIRS) + len(SINGLES))
    results = {task.key: task.compute() for task in tasks}
    for method, array, condition in results:
        if method == "ml":
            values = results[method, array, condition]
            # Who finds nothing resolves nothing.
            results[method, array, condition] = {**values, "found": np.full_like(values["found"], np.nan)}
    rows = [row for row in counted(experiment, bench, results).rows if row.metric == "probability of resolution"]
    whole = [row for row in rows if "phase" not in row.condition]
    assert len({(row.method, row.array, str(row.condition)) for row in whole}) == len(whole) == 2 * 2 * len(PAIRS)
    assert all(row.value == 0.0 for row in rows if row.method == "ml")
    assert any(row.value > 0.5 for row in rows if row.method == "das")


def test_a_known_error_reads_as_what_it_is() -> None:
    experiment, bench = Resolution(), small_bench()
    single, true = TrialCondition(0.0, 20.0), np.linspace(-0.4, 0.4, 50)[:, None]
    results = {}
    for task in experiment.tasks(bench):
        two = task.key[-1].startswith("separation")
        angles = np.tile([[-0.1, 0.1]] if two else [[0.1]], (50, 1))
        results[task.key] = {"found": angles, "u": angles, "phase_rad": np.zeros(50)}
    found = true + 0.01
    found[7] = np.nan
    text = condition_text(single.named)
    results["das", "sparse6", text] = {"found": found, "u": true, "phase_rad": np.zeros(50)}
    nothing = {"found": np.full_like(true, np.nan), "u": true, "phase_rad": np.zeros(50)}
    results["das", "sparse4", text] = nothing
    numbers = counted(experiment, bench, results)
    bias = numbers.row(("das", "sparse6"), "bias [bins]", single.named)
    assert bias.value == pytest.approx(0.01 / FAR.grid.step)
    assert bias.samples == 49
    ratio = numbers.row(("das", "sparse6"), "RMSE over bound", single.named)
    line = bench.contenders[0].answer.line
    assert ratio.value == pytest.approx(0.01 / math.sqrt(single_source_bound(line, 100.0)))
    # Where nothing was found there is no error.
    for metric in ("bias [bins]", "RMSE over bound"):
        none = numbers.row(("das", "sparse4"), metric, single.named)
        assert math.isnan(none.value)
        assert none.samples == 0


def test_impairments_do_what_they_say():
    generator = np.random.default_rng(2)
    array = load_radar("avr-qdm-110").array
    sparse = ArrayChoice(name="sparse4", rx=(0, 1, 10, 15))
    assert np.all(channel_factors(Impairment("SNR", 20.0), array, sparse, generator) == 1.0)
    dead = channel_factors(Impairment("dead RX", 2.0), array, sparse, generator)
    assert np.count_nonzero(dead == 0) == 2 * 3
    assert set(array.channel_rx[dead == 0]) < set(sparse.rx)
    phases = np.stack([channel_factors(Impairment("phase error", 10.0), array, sparse, generator) for _ in range(50)])
    assert np.allclose(np.abs(phases), 1.0)
    assert np.rad2deg(np.angle(phases)).std() == pytest.approx(10.0, rel=0.07)
    gains = np.stack([channel_factors(Impairment("gain error", 2.0), array, sparse, generator) for _ in range(50)])
    assert (20.0 * np.log10(np.abs(gains))).std() == pytest.approx(2.0, rel=0.07)
    moved = displaced(array, 0.5, generator)
    difference = moved.rx - array.rx
    assert not difference[:, [0, 2]].any()
    assert 0.2e-3 < difference[:, 1].std() < 0.9e-3
    assert displaced(array, 0.0, generator) == array
