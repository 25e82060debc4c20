"""The three distributions: what they declare is what they import, and their wheels are whole."""

from __future__ import annotations

import ast
import shutil
import subprocess
import sys
import tomllib
import zipfile
from email.message import Message
from email.parser import BytesParser
from importlib.metadata import PackageNotFoundError, packages_distributions, version
from pathlib import Path
from typing import Any

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("shared", "datafactory", "trainer")
RUN_FILES = ("run.json", "weights.safetensors")
SHIPPED = ROOT / "datafactory/src/datafactory/scenes/shipped"
SCENES = {path for pattern in ("*.*", "*/*.*") for path in SHIPPED.glob(pattern)}
DATA = {
    "shared": {"shared/py.typed"},
    "datafactory": {
        "datafactory/py.typed",
        "datafactory/scenes/materials/materials_77ghz.toml",
        "datafactory/view/overlay.html",
    }
    | {path.relative_to(ROOT / "datafactory/src").as_posix() for path in SCENES},
    "trainer": {"trainer/py.typed", "trainer/evaluation/report/viewer.html", "trainer/run/pretrained/README.md"}
    | {f"trainer/run/pretrained/{name}/{file}" for name in ("sparse6", "sparse4") for file in RUN_FILES},
}


def project_of(package: str) -> dict[str, Any]:
    return tomllib.loads((ROOT / package / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def requirements_of(package: str) -> dict[str, Requirement]:
    """By canonical name."""
    requirements = map(Requirement, project_of(package)["dependencies"])
    return {canonicalize_name(requirement.name): requirement for requirement in requirements}


def imported_by(package: str) -> set[str]:
    """Top-level modules that the sources of a package import, without Python's own and the package itself."""
    found = set()
    for path in (ROOT / package / "src").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                found |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
                found.add(node.module)
    return {name.partition(".")[0] for name in found} - sys.stdlib_module_names - {package}


@pytest.mark.parametrize("package", PACKAGES)
def test_what_is_imported_is_declared(package: str) -> None:
    distributions = packages_distributions()
    declared = requirements_of(package)
    for module in imported_by(package):
        providers = [f"sparseradar-{module}"] if module in PACKAGES else distributions.get(module, [module])
        assert declared.keys() & set(map(canonicalize_name, providers)), f"{package} imports {module}"


@pytest.mark.parametrize("package", PACKAGES)
def test_every_dependency_has_a_lower_bound_that_the_pins_satisfy(package: str) -> None:
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    pins = [Requirement(line) for line in lines if not line.startswith("#")]
    pinned: dict[str, str] = {canonicalize_name(pin.name): str(pin.specifier).removeprefix("==") for pin in pins}
    for name, requirement in requirements_of(package).items():
        assert any(clause.operator == ">=" for clause in requirement.specifier), str(requirement)
        own = name.startswith("sparseradar-")
        known = project_of(name.removeprefix("sparseradar-"))["version"] if own else pinned[name]
        assert requirement.specifier.contains(known, prereleases=True), f"{requirement}, constraints.txt has {known}"


@pytest.mark.parametrize("package", PACKAGES)
def test_each_package_has_the_licence_of_the_repository(package: str) -> None:
    assert (ROOT / package / "LICENSE").read_bytes() == (ROOT / "LICENSE").read_bytes()


def _can_build_here() -> bool:
    """Setuptools as the build needs it; otherwise pip fetches one into a place of its own."""
    try:
        return Version(version("setuptools")) >= Version("77")
    except PackageNotFoundError:
        return False


def _metadata(wheel: zipfile.ZipFile) -> Message:
    (name,) = (name for name in wheel.namelist() if name.endswith(".dist-info/METADATA"))
    return BytesParser().parsebytes(wheel.read(name))


@pytest.mark.slow
@pytest.mark.parametrize("package", PACKAGES)
def test_a_wheel_holds_all_sources_licence_and_readme(package: str, tmp_path: Path) -> None:
    # A copy, so that no build folder is left in the checkout and no old one is taken up.
    left_out = shutil.ignore_patterns("build", "*.egg-info", "__pycache__")
    shutil.copytree(ROOT / package, tmp_path / package, ignore=left_out)
    command = [sys.executable, "-m", "pip", "wheel", "--no-deps", "--quiet", "--disable-pip-version-check"]
    isolation = ["--no-build-isolation"] if _can_build_here() else []
    built = subprocess.run(
        [*command, *isolation, "--wheel-dir", str(tmp_path), str(tmp_path / package)],
        capture_output=True, text=True, check=False, timeout=300,
    )  # fmt: skip
    assert built.returncode == 0, built.stderr
    (path,) = tmp_path.glob("*.whl")
    source = ROOT / package / "src"
    with zipfile.ZipFile(path) as wheel:
        names = {name for name in wheel.namelist() if ".dist-info/" not in name}
        metadata = _metadata(wheel)
        (licence,) = (name for name in wheel.namelist() if name.endswith("/licenses/LICENSE"))
        assert wheel.read(licence) == (ROOT / "LICENSE").read_bytes()
    assert names == {item.relative_to(source).as_posix() for item in source.rglob("*.py")} | DATA[package]
    assert metadata["Name"] == f"sparseradar-{package}"
    assert (metadata["License-Expression"], metadata["License-File"]) == ("Apache-2.0", "LICENSE")
    assert metadata["Requires-Python"] == ">=3.11"
    text = metadata.get_payload()
    assert isinstance(text, str)
    assert text.startswith(f"# sparseradar-{package}\n")
    declared = {str(requirement) for requirement in map(Requirement, metadata.get_all("Requires-Dist", []))}
    assert declared == {str(requirement) for requirement in requirements_of(package).values()}
