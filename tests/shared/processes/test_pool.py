"""Worker processes that die are replaced; interrupts, limits of control groups, a stranger's package of our name."""

import os
import signal
import subprocess
import sys
from collections import deque
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import psutil
import pytest
from pool_work import Squares, note_process
from processes import wait_for

from datafactory.inspection.doctor import examine_names
from shared.dataset.claims import claimed
from shared.processes import machine
from shared.processes.machine import group_limits, usable_cores, usable_memory
from shared.processes.pool import ATTEMPTS, LOSSES, Attempts, Finished, Processes, ThisProcess, WorkerPool
from trainer.cli.entry import main

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
    wait_for(lambda: not any(psutil.pid_exists(process) for process in began), seconds=60.0)


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


BESIDE = """
import ctypes, os, signal, time
from shared.processes.interrupt import run_command, uninterrupted

def interrupted():
    os.kill(os.getpid(), signal.{name})

def turned_into_another_error():
    try:
        interrupted()
    except KeyboardInterrupt:
        raise TypeError("No to_python converter found") from None

def swallowed():
    with uninterrupted():
        try:
            interrupted()
            print("to its end")
        except BaseException:
            pass
    print("beyond")

@ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p)
def compared(first, second):
    interrupted()
    return 0

def within_a_callback_of_c_code():
    ctypes.CDLL(None).qsort(ctypes.create_string_buffer(2), 2, 1, compared)
    time.sleep(60)
    print("went on")

def within_code_that_a_library_runs():
    run = ctypes.pythonapi.PyRun_String
    run.restype, run.argtypes = ctypes.py_object, [ctypes.c_char_p, ctypes.c_int, ctypes.py_object, ctypes.py_object]
    statements = 257  # Py_file_input
    run(b"interrupted()", statements, {{"interrupted": interrupted}}, {{}})

run_command("program", lambda: {what})
"""


def run(what: str, name: str = "SIGINT") -> tuple[int, str, str]:
    """(exit status, standard output, standard error)"""
    with TemporaryDirectory() as folder:
        Path(folder, "program.py").write_text(BESIDE.format(name=name, what=what), encoding="utf-8")
        # As ``python -m``: only there does CPython look at the end whether an interrupt was noted.
        command = [sys.executable, "-m", "program"]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    return done.returncode, done.stdout, done.stderr


@pytest.mark.parametrize("name", [signal.SIGINT.name, signal.SIGTERM.name])
@pytest.mark.parametrize(
    ("what", "said"),
    [
        ("interrupted", ""),
        ("turned_into_another_error", ""),
        ("turned_into_another_error()", ""),
        ("within_code_that_a_library_runs", ""),
        ("swallowed", "to its end\n"),
        ("within_a_callback_of_c_code", ""),
    ],
)
def test_an_interrupt_is_one_line(name: str, what: str, said: str) -> None:
    """It waits for what would swallow it, and comes again where C code does."""
    assert run(what, name) == (130, said, "program: interrupted\n")


def test_an_error_of_its_own_stays_an_error() -> None:
    assert "ZeroDivisionError" in run("1 / 0")[2]


UNLIMITED_V1 = "9223372036854771712"


def write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"{text}\n", encoding="ascii")


def test_a_job_of_slurm_is_held_by_its_own_group_or_by_one_above(tmp_path: Path) -> None:
    """Version 2: the step has no limit of its own, the job above it has."""
    group = "system.slice/slurmstepd.scope/job_7/step_batch/user/task_0"
    write(tmp_path / group / "memory.max", "max")
    write(tmp_path / "system.slice/slurmstepd.scope/job_7/memory.max", "4294967296")
    write(tmp_path / "system.slice/memory.max", "9000000000")
    assert sorted(group_limits(f"0::/{group}\n", tmp_path)) == [4294967296, 9000000000]


def test_a_container_sees_its_own_group_in_place_of_the_root(tmp_path: Path) -> None:
    write(tmp_path / "memory.max", "2000000000")
    assert group_limits("0::/docker/0123abcd\n", tmp_path) == [2000000000]
    assert group_limits("0::/\n", tmp_path) == [2000000000]


def test_version_1_has_a_hierarchy_for_memory(tmp_path: Path) -> None:
    write(tmp_path / "memory/slurm/uid_1/job_7/memory.limit_in_bytes", "3000000000")
    write(tmp_path / "memory/memory.limit_in_bytes", UNLIMITED_V1)
    groups = "9:name=systemd:/\n7:cpu,cpuacct:/slurm\n4:memory:/slurm/uid_1/job_7\n0::/\n"
    assert sorted(group_limits(groups, tmp_path)) == [3000000000, int(UNLIMITED_V1)]


@pytest.mark.parametrize("groups", ["", "0::/\n", "4:memory:/a/b\n"])
def test_without_groups_there_is_no_limit(groups: str, tmp_path: Path) -> None:
    assert group_limits(groups, tmp_path) == []


def test_the_smallest_limit_holds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine, "MOUNTED", tmp_path)
    monkeypatch.setattr(machine, "GROUPS_OF_THIS", tmp_path / "cgroup")
    assert usable_memory() == psutil.virtual_memory().total
    write(tmp_path / "cgroup", "0::/job")
    write(tmp_path / "job/memory.max", "1000000")
    assert usable_memory() == 1000000
    assert usable_cores() >= 1


def install(folder: Path, name: str, package: str) -> None:
    """A distribution as pip records it, without its files."""
    info = folder / f"{name.replace('-', '_')}-0.0.36.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 0.0.36\n", encoding="utf-8")
    (info / "RECORD").write_text(f"{package}/__init__.py,,\n{info.name}/METADATA,,\n", encoding="utf-8")


def test_the_import_says_so_in_one_line(tmp_path: Path) -> None:
    install(tmp_path, "trainer", "trainer")
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path])}
    done = subprocess.run(
        [sys.executable, "-c", "import trainer"], capture_output=True, text=True, env=environment, check=False
    )
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1] == (
        "ImportError: the distribution 'trainer' is installed over 'sparseradar-trainer', both bring the package "
        "'trainer'; mend it: pip uninstall -y trainer && pip install --force-reinstall --no-deps sparseradar-trainer"
    )


def test_the_command_says_so_in_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(tmp_path, "trainer", "trainer")
    monkeypatch.syspath_prepend(str(tmp_path))
    with pytest.raises(SystemExit) as caught:
        main()
    assert str(caught.value.code).startswith("trainer: the distribution 'trainer' is installed over")
    assert "\n" not in str(caught.value.code)


def test_the_doctor_finds_one_of_any_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(tmp_path, "somebodys-trainer", "trainer")
    monkeypatch.syspath_prepend(str(tmp_path))
    (finding,) = [finding for finding in examine_names() if not finding.ok]
    assert finding.item == "package trainer"
    assert finding.value == "somebodys-trainer is installed over sparseradar-trainer"
    assert finding.remedy.startswith("pip uninstall -y somebodys-trainer && pip install --force-reinstall")
    assert finding.required
