"""The benchmark runner at sizes of a second or two: what it writes, and that both sides of each comparison agree.

No assertion is made about a clock; errors are those of the same records at full size.
"""

from __future__ import annotations

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
from shared.signal.imaging import matched_filter_row

sys.path.append(str(Path(__file__).resolve().parent))

import bench
from references import back_projection, direct_sum, nufft_image, nufft_sum
from workloads import QUICK, Workload, street

TINY = replace(
    QUICK,
    name="tiny",
    paths=200,
    peer_rays=2_000,
    direct_samples=3,
    nufft_samples=3,
    truth_paths=20,
    waveform=Waveform(samples=64, range_bins=40, chirps=8),
    elements=32,
    angle_bins=30,
    repeats=1,
    worker_frames=2,
    decided_frames=1,
    gemm=64,
    copy_mb=1,
)
REQUIRED = {"name", "ours_seconds", "reference", "reference_seconds", "ratio", "error"}
LARGEST_ERROR = {
    "cube_moving_vs_direct": 1e-6,
    "cube_moving_vs_finufft": 3e-6,  # FINUFFT's own 1e-6 included
    "cube_static_vs_finufft": 1e-6,
    "cube_two_threads_vs_one": 0.0,
    "cube_tolerance_1e-3_vs_1e-6": 1e-3,
    "cube_tolerance_1e-9_vs_1e-6": 1e-9,
    "cube_vs_chirps_1e-6": 1e-6,
    "cube_vs_chirps_1e-4": 1e-4,
    "cube_vs_gemm_limit": 1e-6,
    "cube_vs_copy_limit": 1e-6,
    "truth_vs_exact": -60.0,
    "image_vs_gemm_limit": -60.0,
    "image_vs_numpy_backprojection": -60.0,
    "truth_synthesis_vs_cube": -45.0,
    "cube_on_torch_vs_compiled": 1e-3,
    "truth_on_torch_vs_compiled": 3e-3,  # a path may have more Doppler terms than the compiled kernel gives it
    "cube_on_cuda_vs_compiled": 1e-3,
    "truth_on_cuda_vs_compiled": 3e-3,
    "cube_vs_sionna_cfr": 5e-3,  # Sionna's delays are float32
    "datafactory_help_vs_numpy": 0.0,
    "trainer_help_vs_numpy": 0.0,
    "first_frame_vs_numpy": 0.0,
    "effects_auto_vs_all": 0.0,
    "two_workers_vs_one": 0.0,
}
ON_GPU = ("cube_on_cuda_vs_compiled", "truth_on_cuda_vs_compiled")
APART = ("cube_vs_sionna_cfr", "first_frame_vs_numpy", "effects_auto_vs_all", *ON_GPU)
LOCAL = [name for name in bench.BENCHMARKS if name not in APART]


def run(names: list[str], folder: Path) -> list[dict]:
    bench.run(TINY, names, folder / "deeper" / "bench.json", Console(quiet=True))
    return json.loads((folder / "deeper" / "bench.json").read_text())


def test_without_finufft_its_comparisons_are_skipped_with_a_reason(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "finufft", None)
    (record,) = run(["cube_moving_vs_finufft", "cube_vs_copy_limit"], tmp_path)
    assert record["name"] == "cube_vs_copy_limit"
    machine = json.loads((tmp_path / "deeper" / "bench-machine.json").read_text())
    assert "pip install finufft" in machine["skipped"]["cube_moving_vs_finufft"]


@pytest.fixture(scope="module")
def records(tmp_path_factory) -> dict[str, dict]:
    folder = tmp_path_factory.mktemp("bench")
    pytest.importorskip("finufft")
    found = {record["name"]: record for record in run(LOCAL, folder)}
    found["machine"] = json.loads((folder / "deeper" / "bench-machine.json").read_text())
    return found


def test_the_file_is_a_list_of_records_with_the_required_keys(records):
    assert [name for name in records if name != "machine"] == LOCAL
    for name in LOCAL:
        record = records[name]
        assert record.keys() >= REQUIRED
        assert record["ours_seconds"] > 0.0
        assert record["reference_seconds"] > 0.0
        assert record["ratio"] == pytest.approx(record["reference_seconds"] / record["ours_seconds"])


@pytest.mark.parametrize("name", LOCAL)
def test_both_sides_of_each_comparison_agree(records, name):
    assert records[name]["error"] <= LARGEST_ERROR[name]


def test_samples_are_labelled_and_scaled(records):
    record = records["cube_moving_vs_direct"]
    assert "3 of 384 channel-chirps, scaled" in record["reference"]
    assert record["reference_seconds"] == pytest.approx(record["measured_reference_seconds"] * 384 / 3)
    assert record["peak_memory_mb"] > 10.0  # of the whole process, whatever ran in it before


def test_the_machine_is_described_beside_the_records(records):
    machine = records["machine"]
    assert machine["size"] == "tiny"
    assert machine["cores"] >= 1
    assert machine["versions"]["numpy"] == np.__version__
    assert len(machine["load_average_1_5_15_min"]) == 3


@pytest.mark.gpu
@pytest.mark.parametrize("name", ON_GPU)
def test_a_gpu_agrees(tmp_path, name):
    found = run([name], tmp_path)
    if not found:
        machine = json.loads((tmp_path / "deeper" / "bench-machine.json").read_text())
        pytest.skip(machine["skipped"][name])
    assert found[0]["error"] <= LARGEST_ERROR[name]


@pytest.mark.slow
def test_sionna_agrees_on_its_own_paths(variant, tmp_path):
    (record,) = run(["cube_vs_sionna_cfr"], tmp_path)
    assert record["paths"] > 100
    assert record["error"] <= LARGEST_ERROR["cube_vs_sionna_cfr"]


@pytest.mark.slow
def test_whole_commands_are_timed_beside_another(tmp_path):
    for record in run(["first_frame_vs_numpy", "effects_auto_vs_all"], tmp_path):
        assert record["ours_cpu_seconds"] > 0.0
        assert record["error"] == LARGEST_ERROR[record["name"]]


def test_the_references_are_one_another():
    """Direct sum against NUFFT; exact image against the slow matched filter; back projection near both."""
    pytest.importorskip("finufft")
    work = Workload(TINY)
    radar, paths = work.radar, street(50, 10.0)
    direct = direct_sum(paths, radar, radar.array, 17, 5)
    nufft, _ = nufft_sum(paths, radar, radar.array, 17, 5, 1e-12)
    assert np.abs(nufft - direct).max() < 1e-9 * np.abs(direct).max()
    fast_time = np.stack([direct_sum(paths, radar, work.sensor, channel, 0) for channel in range(32)], axis=1)
    image = nufft_image(fast_time, radar, work.sensor, np.arange(40))
    peak = np.abs(image).max()
    slow = matched_filter_row(fast_time, radar, work.sensor, 23)
    assert np.abs(image[23] - slow).max() < 1e-9 * peak
    projected = back_projection(fast_time, radar, work.sensor)
    assert np.abs(projected - image).max() < 10.0 ** (-40.0 / 20.0) * peak


def test_the_command_writes_what_it_is_asked_for(tmp_path, monkeypatch):
    monkeypatch.setattr(bench, "QUICK", TINY)
    app = Typer()
    app.command()(bench.main)
    out = tmp_path / "one.json"
    done = CliRunner().invoke(app, ["--quick", "--only", "cube_vs_copy_limit", "--out", str(out)])
    assert done.exit_code == 0, done.output
    assert [record["name"] for record in json.loads(out.read_text())] == ["cube_vs_copy_limit"]


def test_bad_arguments_are_one_line(tmp_path):
    app = Typer()
    app.command()(bench.main)
    done = CliRunner().invoke(app, ["--only", "cube_moving"])
    assert done.exit_code == 2
    assert "--only: 'cube_moving'; expected one of cube_moving_vs_direct" in done.output
    (tmp_path / "file").write_text("")
    with pytest.raises(bench.InputError, match="--out"):
        bench.run(TINY, [], tmp_path / "file" / "bench.json", Console(quiet=True))
