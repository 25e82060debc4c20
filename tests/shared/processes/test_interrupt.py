"""An interrupt is one line and exit status 130, wherever it meets the command."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

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
