"""Frames traced on a GPU are those traced on the processor: the same paths, but for what float32 rounds otherwise.

A process has one device, so that every trace has a process of its own. On the processor the comparison is of a trace
with itself; that holds what the test does, where there is no GPU to hold to it.
"""

from pathlib import Path

import numpy as np
import pytest
from processes import python

from datafactory.paths.backend import cuda_device
from datafactory.paths.storage import TracedFrame, read_paths
from shared.physics.units import power_to_db

SHARE_OF_PATHS = 0.01
"""Rays that graze an edge may meet another face after other rounding."""
POWER_DB = 0.1


def traced(out: Path, device: str) -> list[TracedFrame]:
    """Two frames of the smallest scene with every effect, traced by the command."""
    python("-m", "datafactory", "trace", "shipped:tiny", "--out", out, "--frames", 2, "--rays", 4000,
           "--effects", "all", "--device", device, "--workers", 1)  # fmt: skip
    return [frame for shard in sorted(out.glob("paths/*.parquet")) for frame in read_paths(shard)]


def power_by_range(frame: TracedFrame) -> np.ndarray:
    """[bins] of 1 m."""
    table = frame.table
    range_m = table.range_m()
    power = np.abs(table.every("amplitude")) ** 2
    return np.bincount(range_m.astype(np.int64), weights=power, minlength=300)[:300]


@pytest.mark.parametrize("device", ["cpu", pytest.param("cuda", marks=pytest.mark.gpu)])
def test_the_same_paths_on_every_device(tmp_path, device):
    if device == "cuda" and (problem := cuda_device().problem):
        pytest.skip(f"no CUDA device: {problem}")
    references, frames = traced(tmp_path / "cpu", "cpu"), traced(tmp_path / device / "again", device)
    assert len(frames) == len(references) == 2
    for frame, reference in zip(frames, references, strict=True):
        assert frame.pose == reference.pose
        assert abs(len(frame.table) - len(reference.table)) <= SHARE_OF_PATHS * len(reference.table)
        made, expected = power_by_range(frame), power_by_range(reference)
        strong = expected > 1e-4 * expected.max()
        assert np.abs(power_to_db(made[strong]) - power_to_db(expected[strong])).max() < POWER_DB
