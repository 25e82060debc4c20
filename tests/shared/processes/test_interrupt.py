"""An interrupt is one line and exit status 130, wherever it meets the command."""

from __future__ import annotations

import signal
import subprocess
import sys

import pytest

SCRIPT = """
import os, signal
from shared.processes.interrupt import run_command

def interrupted():
    os.kill(os.getpid(), signal.{name})

def turned_into_another_error():
    try:
        interrupted()
    except KeyboardInterrupt:
        raise TypeError("No to_python converter found") from None

run_command("program", lambda: {what})
"""


@pytest.mark.parametrize("name", [signal.SIGINT.name, signal.SIGTERM.name])
@pytest.mark.parametrize("what", ["interrupted", "turned_into_another_error", "turned_into_another_error()"])
def test_an_interrupt_is_one_line(name: str, what: str) -> None:
    script = SCRIPT.format(name=name, what=what)
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (130, "program: interrupted\n")


SWALLOWED = """
import os, signal
from shared.processes.interrupt import run_command, uninterrupted

def swallowed():
    with uninterrupted():
        try:
            os.kill(os.getpid(), signal.{name})
            print("to its end")
        except BaseException:
            pass
    print("beyond")

run_command("program", lambda: swallowed)
"""


@pytest.mark.parametrize("name", [signal.SIGINT.name, signal.SIGTERM.name])
def test_an_interrupt_waits_for_what_would_swallow_it(name: str) -> None:
    script = SWALLOWED.format(name=name)
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (130, "to its end\n", "program: interrupted\n")


CALLBACK = """
import ctypes, os, signal, time
from shared.processes.interrupt import run_command

@ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p)
def compared(first, second):
    os.kill(os.getpid(), signal.{name})
    return 0

def load():
    ctypes.CDLL(None).qsort(ctypes.create_string_buffer(2), 2, 1, compared)
    time.sleep(60)
    print("went on")

run_command("program", load)
"""


@pytest.mark.parametrize("name", [signal.SIGINT.name, signal.SIGTERM.name])
def test_an_interrupt_within_a_callback_of_c_code_comes_again(name: str) -> None:
    script = CALLBACK.format(name=name)
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "program: interrupted\n")


def test_an_error_of_its_own_stays_an_error() -> None:
    script = "from shared.processes.interrupt import run_command\nrun_command('program', lambda: 1 / 0)"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert "ZeroDivisionError" in done.stderr
