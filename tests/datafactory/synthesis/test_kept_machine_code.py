"""The truth's loop gives the same bytes just compiled, and in a process that takes its machine code from the disk."""

from __future__ import annotations

import os
import subprocess
import sys

SUMS = """
import hashlib
import numpy as np
from datafactory.synthesis.doppler_moments import BINOMIAL, BLOCK, SHIFT_TERMS, add_doppler_moments

paths, cells = 2000, 64
for count in range(1, 8):
    random = np.random.default_rng(count)
    grid = np.zeros((cells, count * SHIFT_TERMS * 2 * BLOCK), np.float32)
    points = random.uniform(-10.0, 10.0, (paths, 3)) + [20.0, 0.0, 0.0]
    table = random.standard_normal((5, 200, count)) + 1j * random.standard_normal((5, 200, count))
    elements = np.zeros((BLOCK, 3))
    elements[:, 1] = 0.002 * np.arange(BLOCK)
    add_doppler_moments(
        np.full(paths, count), points, random.uniform(-3.0, 3.0, (paths, 3)), random.uniform(5.0, 20.0, paths),
        random.uniform(-3.0, 3.0, paths), random.uniform(-0.05, 0.05, paths),
        random.standard_normal(paths) + 1j * random.standard_normal(paths),
        elements, np.zeros(3), 3.0, 128.0, 0.01, 77.5e9, 1e9, 1e-5, 0.013, np.ones(cells, bool), (-2, -6.0, table),
        BINOMIAL, grid,
    )
    assert grid.any()
    print(count, hashlib.sha256(grid.tobytes()).hexdigest())
"""


def test_code_just_compiled_and_code_that_was_kept_give_the_same_bytes(tmp_path):
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    runs = [
        subprocess.run([sys.executable, "-c", SUMS], env=environment, capture_output=True, text=True, check=True).stdout
        for _ in range(2)
    ]
    assert any(tmp_path.rglob("*.nbc"))
    assert runs[0].count("\n") == 7
    assert runs[0] == runs[1]
