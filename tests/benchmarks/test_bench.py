"""The benchmark runner at sizes of a second or two: what it writes, and that both sides of each comparison agree.

No assertion is made about a clock; errors are those of the same records at full size.
"""

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console
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
    direct_samples=3,
    waveform=Waveform(samples=64, range_bins=40, chirps=8),
    elements=32,
    angle_bins=30,
    repeats=1,
)
LARGEST_ERROR = {
    "cube_moving_vs_direct": 1e-6,
    "cube_vs_chirps_1e-6": 1e-6,
    "cube_vs_chirps_1e-4": 1e-4,
    "truth_vs_exact": -60.0,
    "cube_on_torch_vs_compiled": 1e-3,
    "truth_on_torch_vs_compiled": 3e-3,  # a path may have more Doppler terms than the compiled kernel gives it
    "cube_on_cuda_vs_compiled": 1e-3,
    "truth_on_cuda_vs_compiled": 3e-3,
    "images_of_a_frame_vs_omp_cfar": 0.0,
    "images_and_points_of_a_frame_vs_omp_cfar": 0.0,
}
ON_GPU = [name for name in LARGEST_ERROR if "cuda" in name]


def test_both_sides_of_each_comparison_agree(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By the command itself; what is not there is skipped, with the reason in the file of the machine."""
    monkeypatch.setattr(bench, "QUICK", TINY)
    app = Typer()
    app.command()(bench.main)
    out = tmp_path / "deeper" / "bench.json"
    done = CliRunner().invoke(app, ["--quick", "--out", str(out)])
    assert done.exit_code == 0, done.output
    records, machine = json.loads(out.read_text()), json.loads(out.with_name("bench-machine.json").read_text())
    assert {record["name"] for record in records} | set(machine["skipped"]) == set(LARGEST_ERROR)
    assert set(machine["skipped"]) <= set(ON_GPU)
    for record in records:
        assert record["error"] <= LARGEST_ERROR[record["name"]], record["name"]
        assert record["ratio"] == pytest.approx(record["reference_time"]["seconds"] / record["ours_time"]["seconds"])
    sampled = next(record for record in records if record["name"] == "cube_moving_vs_direct")
    assert "3 of 384 channel-chirps, scaled" in sampled["reference"]
    measured_seconds = sampled["details"]["measured_reference_seconds"]
    assert sampled["reference_time"]["seconds"] == pytest.approx(measured_seconds * 384 / 3)
    assert machine["size"] == "tiny"
    assert machine["versions"]["numpy"] == np.__version__


@pytest.mark.gpu
@pytest.mark.parametrize("name", ON_GPU)
def test_a_gpu_agrees(tmp_path: Path, name: str) -> None:
    found = bench.run(TINY, [name], tmp_path / "bench.json", Console(quiet=True))
    if not found:
        pytest.skip(json.loads((tmp_path / "bench-machine.json").read_text())["skipped"][name])
    assert found[0].error <= LARGEST_ERROR[name]
