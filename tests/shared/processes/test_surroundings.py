"""What a process meets: an interrupt, limits of control groups, a stranger's package of one of our names."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import psutil
import pytest

from datafactory.inspection.doctor import examine_names
from shared.processes import machine
from shared.processes.machine import group_limits, usable_cores, usable_memory
from trainer.cli.entry import main

SCRIPT = """
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
        Path(folder, "program.py").write_text(SCRIPT.format(name=name, what=what), encoding="utf-8")
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
