"""An interrupt is one line and exit status 130, wherever it meets the command."""

from __future__ import annotations

import signal
import subprocess
import sys

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

run_command("program", lambda: {what})
"""


def run(what: str, name: str = "SIGINT") -> tuple[int, str, str]:
    """(exit status, standard output, standard error)"""
    command = [sys.executable, "-c", SCRIPT.format(name=name, what=what)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return done.returncode, done.stdout, done.stderr


@pytest.mark.parametrize("name", [signal.SIGINT.name, signal.SIGTERM.name])
@pytest.mark.parametrize(
    ("what", "said"),
    [
        ("interrupted", ""),
        ("turned_into_another_error", ""),
        ("turned_into_another_error()", ""),
        ("swallowed", "to its end\n"),
        ("within_a_callback_of_c_code", ""),
    ],
)
def test_an_interrupt_is_one_line(name: str, what: str, said: str) -> None:
    """It waits for what would swallow it, and comes again where C code does."""
    assert run(what, name) == (130, said, "program: interrupted\n")


def test_an_error_of_its_own_stays_an_error() -> None:
    assert "ZeroDivisionError" in run("1 / 0")[2]
