"""Examples as their users run them."""

import os
import subprocess
import sys

from manual import ROOT

EXAMPLES = ROOT / "examples"


def example(name: str, *arguments: object, **environment: str) -> subprocess.CompletedProcess[str]:
    """An example in a process of its own; a warning of its own code is an error.

    :param environment: its variables, without their ``EXAMPLES_``
    """
    return subprocess.run(
        [sys.executable, "-W", "error::UserWarning:__main__", f"{EXAMPLES / name}.py", *map(str, arguments)],
        capture_output=True, text=True, check=False, cwd=ROOT,
        env=os.environ | {f"EXAMPLES_{variable}": value for variable, value in environment.items()},
    )  # fmt: skip
