"""A fresh Python, for what belongs to a whole process."""

from __future__ import annotations

import os
import subprocess
import sys


def python(*arguments: object, **environment: str) -> str:
    """What it prints; it succeeds.

    :param environment: over this process's
    """
    done = subprocess.run(
        [sys.executable, *map(str, arguments)],
        capture_output=True, text=True, encoding="utf-8", check=False, env=os.environ | environment,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout
