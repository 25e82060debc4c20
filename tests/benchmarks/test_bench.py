"""The benchmark runner at sizes of a second or two: every comparison runs, and what it writes.

No assertion is made about a clock. That both sides agree is held by the tests of either.
"""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer import Typer
from typer.testing import CliRunner

from shared.radar.waveform import Waveform

sys.path.append(str(Path(__file__).resolve().parent))

import bench
from workloads import QUICK

TINY = replace(
    QUICK,
    name="tiny",
    paths=200,
    rays=2_000,
    direct_samples=3,
    waveform=Waveform(samples=64, range_bins=40, chirps=8),
    elements=32,
    angle_bins=30,
    repeats=1,
    worker_frames=2,
    decided_frames=1,
)


def test_every_comparison_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By the command itself; what is not there is skipped, with the reason in the file of the machine."""
    monkeypatch.setattr(bench, "QUICK", TINY)
    app = Typer()
    app.command()(bench.main)
    out = tmp_path / "deeper" / "bench.json"
    done = CliRunner().invoke(app, ["--quick", "--out", str(out)])
    assert done.exit_code == 0, done.output
    records, machine = json.loads(out.read_text()), json.loads(out.with_name("bench-machine.json").read_text())
    assert {record["name"] for record in records} | set(machine["skipped"]) == set(bench.BENCHMARKS)
    assert all("cuda" in name for name in machine["skipped"])
    for record in records:
        assert record["ratio"] == pytest.approx(record["reference_seconds"] / record["ours_seconds"])
    sampled = next(record for record in records if record["name"] == "cube_moving_vs_direct")
    assert "3 of 384 channel-chirps, scaled" in sampled["reference"]
    assert sampled["reference_seconds"] == pytest.approx(sampled["measured_reference_seconds"] * 384 / 3)
    assert machine["size"] == "tiny"
    assert machine["versions"]["numpy"] == np.__version__
