"""What ``check``, ``scenes`` and ``doctor`` say: each missing thing with its remedy, and nothing crashes."""

import json
from dataclasses import asdict
from importlib.metadata import PackageNotFoundError
from pathlib import Path

import pytest
from factory_command import run
from typer.testing import CliRunner
from usd_files import CUBE, METRES_Z_UP, cube, mesh, ops, read, translated, write_usda

from datafactory.cli.app import app
from datafactory.inspection import doctor
from datafactory.inspection.doctor import Finding
from datafactory.inspection.scene import SceneReport, examine_scene
from datafactory.paths.backend import CudaDevice
from datafactory.scenes.materials.table import load_materials
from datafactory.scenes.readers.common import sphere
from datafactory.scenes.readers.open import named_scenes
from shared.physics.errors import InputError

STREET = mesh("street", [(-60, -60, 0), (60, -60, 0), (60, 60, 0), (-60, 60, 0)], [range(4)], "asphalt")
BENT = mesh("bent", [(5, 5, 0), (6, 5, 0), (6, 6, 0), (6, 6, 0)], [(0, 1, 2), (1, 2, 3)], "glass")
BODY = f"""{STREET}{BENT}
def Mesh "box" {{
  {CUBE}
  custom token radar:material = "mithril"
  {translated(20, 0, 1)}
}}
def Mesh "wheel" {{
  {CUBE}
  custom token radar:material = "metal"
  {ops(translate=(-20, 0, 2), rotateX={0: 0, 48: 720})}
}}
def Mesh "cart" {{
  {CUBE}
  custom token radar:material = "metal"
  {ops(translate={0: (0, 20, 1), 24: (3, 20, 1)})}
}}
def Sphere "ball" {{
  double radius = 0.5
  {translated(-20, 10, 1)}
}}
def Xform "walker" {{
  custom token radar:target = "pedestrian"
  custom double3 radar:velocity = (0, 1.5, 0)
  {translated(0, -20, 0)}
}}
def Camera "camera" {{
}}
def BasisCurves "wire" {{
}}"""


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> SceneReport:
    folder = tmp_path_factory.mktemp("check")
    return examine_scene(read(folder, BODY, f"{METRES_Z_UP}\n timeCodesPerSecond = 24"), load_materials())


def test_counts_sizes_and_what_materials_became(report: SceneReport) -> None:
    triangles = 2 + 12 + 1 + 12 + 12 + len(sphere(0.5)[1])
    assert (report.objects, report.triangles, report.point_targets) == (6, triangles, 1)
    assert report.size_m == pytest.approx((120, 120, 3))
    uses = {item.name: item for item in report.materials}
    assert [uses[name].known for name in ("asphalt", "mithril", "glass", "metal")] == [True, False, True, True]
    assert (uses["metal"].objects, uses["metal"].triangles) == (2, 24)
    assert uses["metal"].area_m2 == pytest.approx(48.0)
    assert uses["asphalt"].area_m2 == pytest.approx(120.0**2)


def test_what_moves_and_until_when(report: SceneReport) -> None:
    motions = {item.kind: item for item in report.motions}
    assert (motions["straight on"].fastest_mps, motions["straight on"].rests_from_s) == (1.5, None)
    assert (motions["along a track"].fastest_mps, motions["along a track"].rests_from_s) == (3.0, 1.0)
    turning = motions["turns or changes its size"]
    assert turning.fastest_mps == pytest.approx(
        6.2832 * 2**0.5, rel=1e-3
    )  # 2 turns in 2 s, corners 1.41 m off the axle
    assert turning.rests_from_s == 2.0


def test_what_is_dropped_and_what_to_know(report: SceneReport) -> None:
    assert "1 triangles without area dropped" in report.dropped
    assert "1 prims of type BasisCurves ignored" in report.dropped
    assert all(area > 0.0 for area in report.ground_m2.values())
    text = "\n".join(report.remarks)
    assert "glass let waves through" in text
    assert "triangles sample 1 curved surfaces" in text
    assert "7 rims of open sheets" in text  # four of the street, three of the bent pane
    assert "1 objects turn or deform" in text
    json.dumps(asdict(report))


def test_a_name_of_the_map_that_no_material_has_is_said(tmp_path: Path) -> None:
    (tmp_path / "materials.toml").write_text('[map]\nmithral = "metal"\nmithril = "metal"\n')
    scene = write_usda(tmp_path, BODY)
    known = json.loads(run("check", "--scene", scene, "--materials", tmp_path / "materials.toml", "--json"))
    vain = "--materials: no material of the scenes has these names of [map]: mithral; did you mean 'mithril'?"
    assert vain in known["remarks"]


def test_the_command_prints_it_and_json(tmp_path: Path) -> None:
    path = write_usda(tmp_path, f'def Mesh "m" {{\n{CUBE}\n}}')
    shown = run("check", "--scene", path)
    for part in ("1 objects, 12 triangles, 0 point targets; 2 x 2 x 2 m", "nothing moves", "no sensor can be drawn"):
        assert part in shown
    assert json.loads(run("check", "--scene", path, "--json"))["triangles"] == 12


def test_variants_and_missing_geometry_are_options_of_the_command(tmp_path: Path) -> None:
    path = write_usda(tmp_path, f'{cube("m")}\ndef "lost" (references = @gone.usd@) {{\n}}')
    asked = ("check", "--scene", path, "--allow-missing", "--json")
    assert any("gone.usd" in line for line in json.loads(run(*asked))["dropped"])
    with pytest.raises(InputError, match="--variant: no prim has a variant set 'body'"):
        run(*asked, "--variant", "body=high")


def test_scenes_are_listed_by_the_names_that_scene_takes() -> None:
    names = {item.name: item for item in named_scenes()}
    assert {"shipped:street", "shipped:tiny", "shipped:effects/wall", "sionna:munich"} <= names.keys()
    assert names["shipped:street"].bytes > 5e5
    assert "Test range" in names["shipped:test_range"].about
    shown = run("scenes")
    assert "shipped:street" in shown
    assert "sionna:munich" in shown


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
        (Finding("thing", "15 [old]", False, "pip install thing"), 1),
    ],
)
def test_exit_status_follows_what_is_required(monkeypatch, finding, status):
    monkeypatch.setattr("datafactory.inspection.doctor.examine", lambda: [finding])
    shown, as_json = (CliRunner().invoke(app, ["doctor", *more]) for more in ((), ("--json",)))
    assert (shown.exit_code, as_json.exit_code) == (status, status)
    assert finding.remedy in shown.output
    assert "thing" in shown.output
    assert json.loads(as_json.stdout) == [asdict(finding)]
