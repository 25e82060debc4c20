"""Worker processes of ``trainer evaluate``: what they are, and that none outlives what started it."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from tiny_radar import RADAR, frame, write_dataset
from troubled_experiment import Troubled

from shared.physics.errors import InputError
from trainer.errors import Stopped
from trainer.evaluation.evaluate import open_bench
from trainer.evaluation.experiments.bench import Bench
from trainer.evaluation.options import EvaluationConfig
from trainer.evaluation.store import Values
from trainer.evaluation.workers import Workers


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Bench:
    data = write_dataset(tmp_path_factory.mktemp("data") / "data", {"test": [frame(0, RADAR)]}, RADAR)
    return open_bench(data, EvaluationConfig(methods=("das",), arrays=("full",), seed=7))[0]


def results(pool: Workers, *work: str) -> Iterator[tuple[int, Values]]:
    experiment = Troubled(work, name="-".join(work))
    return pool.results(experiment, experiment.tasks(pool.bench), range(len(work)))


def test_cells_are_computed_elsewhere_and_no_worker_outlives_the_context(bench: Bench, tmp_path: Path) -> None:
    """One thread a worker, deaf to the terminal's Ctrl-C; an input error is one line; the next cells go on after it."""
    with Workers(bench, 2, tmp_path / "workers") as pool:
        found = dict(results(pool, "report", "gpu", "report", "report", "report"))
        assert sorted(found) == [0, 1, 2, 3, 4]
        # A GPU is one: what needs it stays here.
        assert [place for place, values in found.items() if values["pid"] == os.getpid()] == [1]
        for place in (0, 2, 3, 4):
            assert (found[place]["deaf"], found[place]["threads"], found[place]["seed"]) == (True, 1, 7)
        with pytest.raises(InputError, match=r"^part-00000\.parquet: row 3: damaged; expected a whole row$"):
            dict(results(pool, "report", "refuse"))
        assert list(dict(results(pool, "report"))) == [0]
        assert multiprocessing.active_children()
    assert not multiprocessing.active_children()
    assert not (tmp_path / "workers").exists()


def test_one_worker_is_this_process_with_one_thread(bench: Bench, tmp_path: Path) -> None:
    with Workers(bench, 1, tmp_path / "workers") as pool:
        ((_, values),) = results(pool, "report")
        assert not (tmp_path / "workers").exists()
    assert (values["pid"], values["threads"], values["deaf"]) == (os.getpid(), 1, False)


@pytest.mark.slow
def test_a_cell_that_three_workers_die_of_is_one_line_here(bench: Bench, tmp_path: Path) -> None:
    line = r"^report-die-report die place=1: three worker processes died of it, its process ended by SIGKILL.*--resume"
    with pytest.raises(Stopped, match=line), Workers(bench, 2, tmp_path / "workers") as pool:
        list(results(pool, "report", "die", "report"))
    assert not multiprocessing.active_children()
