"""What is freed stays with the process: the next arrays of that size take no new pages."""

from __future__ import annotations

import platform
import subprocess
import sys

import pytest

FAULTS_OF_THE_LAST_ARRAYS = """
import resource
import numpy as np
from datafactory.run.memory import keep_freed_memory

def faults():
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt

keep_freed_memory()
for _ in range(3):
    before = faults()
    len([np.full(15 * 2**20, 1, dtype=np.uint8) for _ in range(6)])
print(faults() - before)
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="only the GNU C library has these limits")
def test_memory_that_was_freed_is_not_asked_for_again():
    """Ninety megabytes for the third time. Without the limits that is 30 to 20 000 page faults, by the page's size."""
    done = subprocess.run([sys.executable, "-c", FAULTS_OF_THE_LAST_ARRAYS], capture_output=True, text=True, check=True)
    assert int(done.stdout) <= 2
