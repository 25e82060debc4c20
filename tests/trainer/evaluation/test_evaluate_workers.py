"""Worker processes of ``trainer evaluate``: what they are, and that none outlives what started it."""

from __future__ import annotations

import multiprocessing
import os
import signal
import subprocess
import sys
import time
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
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_dataset(tmp_path_factory.mktemp("data") / "data", {"test": [frame(0, RADAR)]}, RADAR)


@pytest.fixture(scope="module")
def bench(data: Path) -> Bench:
    return open_bench(data, EvaluationConfig(methods=("das",), arrays=("full",), seed=7))[0]


def results(pool: Workers, *work: str) -> Iterator[tuple[int, Values]]:
    experiment = Troubled(work, name="-".join(work))
    return pool.results(experiment, experiment.tasks(pool.bench), range(len(work)))


def gone(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    # One that has ended and that nobody asked about: init, which inherits it, may not care.
    return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] == "Z"


def stop(pids: set[int]) -> None:
    """What Ctrl-C does, in the middle of other cells."""
    assert pids <= {child.pid for child in multiprocessing.active_children()} | {os.getpid()}
    raise KeyboardInterrupt


def use(pool: Workers, pids: set[int]) -> None:
    found = dict(results(pool, "report", "gpu", "report", "report", "report"))
    assert sorted(found) == [0, 1, 2, 3, 4]
    # A GPU is one: what needs it stays here.
    assert [place for place, values in found.items() if values["pid"] == os.getpid()] == [1]
    for place in (0, 2, 3, 4):
        assert (found[place]["deaf"], found[place]["threads"], found[place]["seed"]) == (True, 1, 7)
    with pytest.raises(InputError, match=r"^part-00000\.parquet: row 3: damaged; expected a whole row$"):
        dict(results(pool, "report", "refuse"))
    pids |= {int(values["pid"]) for values in found.values()}
    for _ in results(pool, "report", "hang", "hang", "hang"):
        stop(pids)


def test_cells_are_computed_elsewhere_and_no_worker_outlives_an_interrupt(bench: Bench, tmp_path: Path) -> None:
    """One thread a worker, deaf to the terminal's Ctrl-C; an input error is one line; hanging cells are ended."""
    pids: set[int] = set()
    with pytest.raises(KeyboardInterrupt), Workers(bench, 2, tmp_path / "workers") as pool:
        use(pool, pids)
    assert 2 <= len(pids) <= 3
    assert all(gone(pid) for pid in pids - {os.getpid()})
    assert not multiprocessing.active_children()
    assert not (tmp_path / "workers").exists()


def test_one_worker_is_this_process_with_one_thread(bench: Bench, tmp_path: Path) -> None:
    with Workers(bench, 1, tmp_path / "workers") as pool:
        ((_, values),) = results(pool, "report")
        assert not (tmp_path / "workers").exists()
    assert (values["pid"], values["threads"], values["deaf"]) == (os.getpid(), 1, False)


def test_a_worker_that_dies_is_replaced_and_its_cell_computed(bench: Bench, tmp_path: Path) -> None:
    died = tmp_path / "died"
    with Workers(bench, 2, tmp_path / "workers") as pool:
        experiment = Troubled(("report", "die once", "report"), name="dies", died=died)
        found = dict(pool.results(experiment, experiment.tasks(pool.bench), range(3)))
    assert sorted(found) == [0, 1, 2]
    assert len(died.read_text().split()) == 1
    assert int(died.read_text()) not in {int(values["pid"]) for values in found.values()}


@pytest.mark.slow
def test_a_cell_that_three_workers_die_of_is_one_line_here(bench: Bench, tmp_path: Path) -> None:
    line = r"^report-die-hang die place=1: three worker processes died of it, its process ended by SIGKILL.*--resume"
    with pytest.raises(Stopped, match=line), Workers(bench, 2, tmp_path / "workers") as pool:
        list(results(pool, "report", "die", "hang"))
    assert not multiprocessing.active_children()


SCRIPT = """
import multiprocessing, sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
from troubled_experiment import Troubled
from trainer.evaluation.evaluate import open_bench
from trainer.evaluation.options import EvaluationConfig
from trainer.evaluation.workers import Workers

bench = open_bench(Path(sys.argv[2]), EvaluationConfig(methods=("das",), arrays=("full",)))[0]
experiment = Troubled(("report", "hang", "hang"))
with Workers(bench, 2, Path(sys.argv[3])) as pool:
    for _ in pool.results(experiment, experiment.tasks(bench), range(3)):
        print(*(child.pid for child in multiprocessing.active_children()), flush=True)
"""


@pytest.mark.slow
def test_workers_end_with_a_parent_that_was_killed(data: Path, tmp_path: Path) -> None:
    """A script needs no guard around its main part."""
    script = tmp_path / "script.py"
    script.write_text(SCRIPT)
    command = [sys.executable, str(script), str(Path(__file__).parents[1]), str(data), str(tmp_path / "workers")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        workers = [int(word) for word in parent.stdout.readline().split()]
        assert len(workers) == 2
        parent.send_signal(signal.SIGKILL)
    for _ in range(600):
        if all(gone(pid) for pid in workers):
            break
        time.sleep(0.1)
    assert all(gone(pid) for pid in workers)
