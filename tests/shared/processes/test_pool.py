"""Worker processes that die: replaced, their tasks tried again so often, and nothing hangs or stays behind."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections import deque
from functools import partial
from pathlib import Path

import psutil
import pytest
from pool_work import Squares, note_process

from shared.dataset.claims import claimed
from shared.processes.pool import ATTEMPTS, LOSSES, Attempts, Finished, Processes, ThisProcess, WorkerPool

TESTS = Path(__file__).resolve().parents[2]


def finished(pool: WorkerPool[int, tuple[int, bytes]], items: list[int]) -> list[Finished[int, tuple[int, bytes]]]:
    """All outcomes, in the order in which they come."""
    waiting, outcomes = deque(items), list[Finished[int, tuple[int, bytes]]]()
    while waiting or pool.busy:
        while waiting and pool.has_room:
            pool.submit(waiting.popleft())
        outcomes += pool.finished(0.2)
    return outcomes


def squares(outcomes: list[Finished[int, tuple[int, bytes]]]) -> dict[int, int]:
    return {outcome.item: outcome.result[0] for outcome in outcomes if outcome.result is not None}


def test_without_processes_tasks_are_done_here_one_by_one(tmp_path: Path) -> None:
    with ThisProcess[int, tuple[int, bytes]](Squares(tmp_path, {})) as pool:
        pool.submit(3)
        assert pool.busy
        assert not pool.has_room
        assert squares(list(pool.finished(0.0))) == {3: 9}
        assert not pool.busy
    assert [path.name for path in tmp_path.glob("began-*")] == [f"began-{os.getpid()}"]


def test_processes_that_were_started_before_their_work_take_it_and_the_others_end(tmp_path: Path) -> None:
    with Processes(partial(note_process, tmp_path)) as processes:
        processes.start(3)
        wait_for(lambda: len(list(tmp_path.glob("ready-*"))) == 3)
        folder = tmp_path / "workers"
        with WorkerPool[int, tuple[int, bytes]](Squares(tmp_path, {}), 2, folder, processes) as pool:
            assert squares(finished(pool, list(range(5)))) == {number: number**2 for number in range(5)}
    ready, began = ({path.name[6:] for path in tmp_path.glob(f"{kind}-*")} for kind in ("ready", "began"))
    assert began <= ready
    assert len(ready) == 3
    assert not any(psutil.pid_exists(int(process)) for process in ready)


def test_a_worker_that_dies_is_replaced_and_its_task_tried_again(tmp_path: Path) -> None:
    deaths = {2: 1, 5: ATTEMPTS - 1}
    with WorkerPool[int, tuple[int, bytes]](Squares(tmp_path, deaths), 2, tmp_path / "workers") as pool:
        outcomes = finished(pool, list(range(7)))
    assert squares(outcomes) == {number: number**2 for number in range(7)}
    assert len(outcomes) == 7
    assert not (tmp_path / "workers").exists()
    # Not the processes that began: the last one may be ended before it has anything to do.
    assert len(list(tmp_path.glob("died-*"))) == sum(deaths.values())


def test_no_worker_hears_ctrl_c(tmp_path: Path) -> None:
    """A terminal sends it to all processes; the one that started them ends them."""
    with WorkerPool[int, tuple[int, bytes]](Squares(tmp_path, {}, seconds=60.0), 2, tmp_path / "workers") as pool:
        for number in range(2):
            pool.submit(number)
        wait_for(lambda: len(list(tmp_path.glob("began-*"))) == 2)
        blocked = {path.read_text(encoding="utf-8") for path in tmp_path.glob("began-*")}
    assert blocked == {"SIGINT"}


def test_a_task_that_three_processes_die_of_is_named_and_the_rest_is_done(tmp_path: Path) -> None:
    with WorkerPool[int, tuple[int, bytes]](Squares(tmp_path, {3: 99}), 2, tmp_path / "workers") as pool:
        outcomes = finished(pool, list(range(6)))
    assert squares(outcomes) == {number: number**2 for number in range(6) if number != 3}
    (failed,) = (outcome for outcome in outcomes if outcome.result is None)
    assert failed.item == 3
    assert "SIGKILL" in failed.failure
    assert len(list(tmp_path.glob("died-3-*"))) == ATTEMPTS


def test_workers_that_die_while_they_start_are_replaced(tmp_path: Path) -> None:
    work = Squares(tmp_path, {}, dies_at_the_start=2)
    with WorkerPool[int, tuple[int, bytes]](work, 2, tmp_path / "workers") as pool:
        outcomes = finished(pool, [1, 2, 3])
    assert squares(outcomes) == {1: 1, 2: 4, 3: 9}


def test_what_a_task_raises_is_raised_and_the_processes_end(tmp_path: Path) -> None:
    with (
        pytest.raises(ValueError, match="-1 has no square here"),
        WorkerPool[int, tuple[int, bytes]](Squares(tmp_path, {}, seconds=0.1), 2, tmp_path / "workers") as pool,
    ):
        finished(pool, [1, -1, 2, 3])
    began = [int(path.name.removeprefix("began-")) for path in tmp_path.glob("began-*")]
    assert began
    assert not any(psutil.pid_exists(process) for process in began)


SCRIPT = """
import signal
import sys
signal.signal(signal.SIGINT, signal.default_int_handler)  # tests run in the background inherit that it is ignored
from collections import deque
from pathlib import Path
sys.path.append({tests!r})
from pool_work import Squares
from shared.processes.pool import WorkerPool

folder = Path({folder!r})
with WorkerPool(Squares(folder, {{}}, seconds=60.0), 2, folder / "workers") as pool:
    for number in range(4):
        pool.submit(number)
    while pool.busy:
        list(pool.finished(0.2))
"""


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGINT])
def test_workers_end_with_the_process_that_started_them(how: signal.Signals, tmp_path: Path) -> None:
    """Also a script without a guard around its main part may have workers."""
    script = tmp_path / "script.py"
    script.write_text(SCRIPT.format(tests=str(TESTS), folder=str(tmp_path)), encoding="utf-8")
    parent = subprocess.Popen([sys.executable, str(script)], stderr=subprocess.DEVNULL)
    wait_for(lambda: len(list(tmp_path.glob("began-*"))) == 2)
    began = [int(path.name.removeprefix("began-")) for path in tmp_path.glob("began-*")]
    os.kill(parent.pid, how)
    assert parent.wait(timeout=30) != 0
    wait_for(lambda: not any(psutil.pid_exists(process) for process in began))


def wait_for(condition: object, seconds: float = 60.0) -> None:
    """Until the condition holds; fails after a time that no slow machine takes."""
    assert callable(condition)
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.05)


HELD = """
import os, signal, sys
from pathlib import Path
from shared.dataset.claims import claimed
with claimed(Path(sys.argv[1]), Path(sys.argv[1]) / "notes", "--out", int):
    os.kill(os.getpid(), signal.SIGKILL)
"""


def test_a_folder_has_one_job_at_a_time_and_a_crash_releases_it(tmp_path: Path) -> None:
    folder, command = tmp_path / "made" / "here", [sys.executable, "-c", HELD, str(tmp_path / "made" / "here")]
    with claimed(folder, folder / "notes", "--out", int):
        other = subprocess.run(command, capture_output=True, text=True, check=False)
        assert "--out: another process is at work" in other.stderr
    assert not (tmp_path / "made").exists()
    assert subprocess.run(command, check=False).returncode == -signal.SIGKILL
    assert (folder / "notes" / "lock").exists()
    with claimed(folder, folder / "notes", "--out", int):
        pass
    assert list(tmp_path.rglob("lock")) == []


def test_a_lost_machine_is_no_fault_of_its_tasks_unless_it_always_is() -> None:
    attempts = Attempts[str, int]()
    assert [attempts.lost("a") for _ in range(LOSSES - 1)] == [None] * (LOSSES - 1)
    assert attempts.died("a", "it ended") is None
    assert attempts.lost("a") == Finished("a", None, "10 machines were lost while they worked on it")
