"""A fresh Python, for what belongs to a whole process; waiting for something, and for processes that end."""

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterable
from typing import Any, TypeVar

import psutil

T = TypeVar("T")


def python(*arguments: object, **environment: str) -> str:
    """What a fresh Python prints; it succeeds.

    :param environment: over this process's
    """
    done = subprocess.run(
        [sys.executable, *map(str, arguments)],
        capture_output=True, text=True, encoding="utf-8", check=False, env=os.environ | environment,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout


def wait_for(condition: Callable[[], T], seconds: float = 120.0, process: subprocess.Popen[Any] | None = None) -> T:
    """What the condition says as soon as it holds; fails after a time that no slow machine takes.

    :param process: must not end before
    """
    end = time.monotonic() + seconds
    while not (found := condition()):
        assert time.monotonic() < end, "waited in vain"
        assert process is None or process.poll() is None, process.communicate()
        time.sleep(0.02)
    return found


def have_ended(processes: Iterable[psutil.Process]) -> bool:
    """Also those that nobody has asked about since: init, which inherits them, may not care."""
    return not any(found.is_running() and found.status() != psutil.STATUS_ZOMBIE for found in processes)
