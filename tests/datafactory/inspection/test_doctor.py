"""Doctor: every missing thing is reported with its remedy, and nothing crashes."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError

import pytest
import typer
from typer.testing import CliRunner

from datafactory.cli.inspection import doctor as command
from datafactory.inspection import doctor
from datafactory.inspection.doctor import Finding
from datafactory.paths.backend import CudaDevice
from shared.physics.errors import InputError

application = typer.Typer()
application.command()(command)


def by_item(findings):
    return {finding.item: finding for finding in findings}


@pytest.fixture
def quick(monkeypatch):
    """Leave out the trial of the variant, the one slow step."""
    monkeypatch.setattr(doctor, "_variant", lambda: Finding("Mitsuba variant", "not tried", True))


def test_every_finding_that_is_not_ok_has_a_remedy():
    findings = doctor.examine()
    items = {finding.item for finding in findings}
    assert {"Python", "torch", "Mitsuba variant", "LLVM", "CPU cores", "memory", "free disk space"} <= items
    assert items & {"GPU", "GPU, tracing"}
    assert {"numba", "usd-core", "sionna-rt"} <= items
    for finding in findings:
        assert finding.ok == (finding.remedy == "") or (finding.ok and finding.remedy == ""), finding


def test_missing_packages_come_with_their_command(quick, monkeypatch):
    def missing(name):
        raise PackageNotFoundError(name)

    monkeypatch.setattr(doctor, "version", missing)
    found = by_item(doctor.examine())
    assert found["sionna-rt"] == Finding("sionna-rt", "missing", False, "pip install sionna-rt")
    assert not found["torch"].required


def test_old_llvm_is_required_whatever_gpu_there_is(quick, monkeypatch):
    def refuse():
        raise InputError("LLVM", "found 15.0.6 at libLLVM-15.so", "LLVM 17 or newer")

    monkeypatch.setattr(doctor, "find_llvm", refuse)
    monkeypatch.setattr(doctor.sys, "platform", "linux")
    for trial in ("_TRIAL", "_TORCH_TRIAL"):  # what the GPU does is another finding's
        monkeypatch.setattr(doctor, trial, "print('cuda')")
    for device in (CudaDevice("", "no driver", "a driver"), CudaDevice("a GPU", "no OptiX", "all of the driver")):
        monkeypatch.setattr(doctor, "cuda_device", lambda device=device: device)
        found = by_item(doctor.examine())["LLVM"]
        assert not found.ok
        assert found.required
        assert found.remedy.startswith("pip install karellen-llvm-core")


def test_no_gpu_is_no_fault():
    (found,) = doctor._gpu(CudaDevice("", "there is no NVIDIA driver", "a driver"))
    assert found == Finding("GPU", "none: there is no NVIDIA driver; --device cpu", True, required=False)


@pytest.mark.parametrize(
    ("device", "trial", "torch_trial", "tracing", "signals"),
    [
        (CudaDevice("a GPU"), "print('cuda')", "print()", True, True),
        (CudaDevice("a GPU", "no OptiX", "all of the driver"), "print('cuda')", "print()", False, True),
        (CudaDevice("a GPU"), "raise SystemExit('the driver is too old')", "print()", False, True),
        (CudaDevice("a GPU"), "print('cuda')", "print('torch is built without CUDA')", True, False),
        (CudaDevice("a GPU"), "print('cuda')", "import os; os.abort()", True, False),
    ],
)
def test_a_gpu_is_usable_or_it_is_said_why_not(monkeypatch, device, trial, torch_trial, tracing, signals):
    monkeypatch.setattr(doctor, "_TRIAL", trial)
    monkeypatch.setattr(doctor, "_TORCH_TRIAL", torch_trial)
    found = by_item(doctor._gpu(device))
    for item, usable in (("GPU, tracing", tracing), ("GPU, signals", signals)):
        assert found[item].ok == usable
        assert not found[item].required
        assert (found[item].value == "a GPU: --device cuda") == usable
        assert bool(found[item].remedy) != usable


@pytest.mark.parametrize(
    ("script", "problem"),
    [
        ("import os; os.abort()", "ended by signal 6"),
        ("raise ValueError('the driver is too old')", "the driver is too old"),
        ("raise SystemExit(1)", "no message"),
    ],
)
def test_a_variant_that_aborts_is_a_finding(monkeypatch, script, problem):
    monkeypatch.setattr(doctor, "_TRIAL", script)
    finding = doctor._variant()
    assert not finding.ok
    assert problem in finding.value
    assert finding.remedy


def test_little_memory_and_disk_are_noted(quick, monkeypatch):
    monkeypatch.setattr(doctor, "MINIMUM_MEMORY_GIB", 1e9)
    monkeypatch.setattr(doctor, "MINIMUM_DISK_GIB", 1e9)
    found = by_item(doctor.examine())
    for item in ("memory", "free disk space"):
        assert not found[item].ok
        assert not found[item].required
        assert "at least 1e+09 GiB" in found[item].remedy


@pytest.mark.parametrize(
    ("finding", "status"),
    [
        (Finding("thing", "here", True), 0),
        (Finding("thing", "missing", False, "pip install thing", required=False), 0),
        (Finding("thing", "missing", False, "pip install thing"), 1),
    ],
)
def test_exit_status_follows_what_is_required(monkeypatch, finding, status):
    monkeypatch.setattr("datafactory.inspection.doctor.examine", lambda: [finding])
    result = CliRunner().invoke(application, [])
    assert result.exit_code == status
    assert finding.remedy in result.output
    assert "thing" in result.output
