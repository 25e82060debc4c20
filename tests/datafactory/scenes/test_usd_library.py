"""An interrupt while USD loads its parts is one line; USD alone prints a traceback and goes on."""

from __future__ import annotations

import subprocess
import sys

SCRIPT = """
import os, signal, sys
from shared.processes.interrupt import run_command

class InterruptAt:
    def find_spec(self, name, path=None, target=None):
        if name == "pxr.Kind":  # loaded by UsdGeom, from C++
            sys.meta_path.remove(self)
            os.kill(os.getpid(), signal.SIGTERM)

sys.meta_path.insert(0, InterruptAt())

def load():
    import datafactory.scenes.usd_library
    print("went on")

run_command("program", load)
"""


def test_an_interrupt_while_usd_is_imported_is_one_line() -> None:
    done = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "program: interrupted\n")
