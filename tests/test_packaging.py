"""The three distributions: what they declare is what they import, and their wheels are whole."""

import ast
import json
import re
import shutil
import subprocess
import sys
import sysconfig
import tomllib
import venv
import zipfile
from email.parser import BytesParser
from functools import partial
from importlib.metadata import PackageNotFoundError, packages_distributions, version
from itertools import chain
from pathlib import Path
from typing import Any

import pytest
from manual import ROOT
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version
from third_party import third_party

PACKAGES = ("shared", "datafactory", "trainer")
RUN_FILES = ("run.json", "weights.safetensors")
SHIPPED = ROOT / "datafactory/src/datafactory/scenes/shipped"
NOT_INSTALLED = {"sumo": "eclipse-sumo"}
"""Distributions, by module, of extras that the set-up leaves out."""
VIEWER = ROOT / "trainer/src/trainer/evaluation/report/viewer"
SCENES = {path for pattern in ("*.*", "*/*.*") for path in SHIPPED.glob(pattern)}
DATA = {
    "shared": {"shared/py.typed"},
    "datafactory": {
        "datafactory/py.typed",
        "datafactory/scenes/materials/materials_77ghz.toml",
        "datafactory/view/overlay.html",
    }
    | {path.relative_to(ROOT / "datafactory/src").as_posix() for path in SCENES},
    "trainer": {"trainer/py.typed", "trainer/run/pretrained/README.md"}
    | {path.relative_to(ROOT / "trainer/src").as_posix() for path in VIEWER.iterdir()}
    | {f"trainer/run/pretrained/{name}/{file}" for name in ("sparse6", "sparse4") for file in RUN_FILES},
}


def project_of(package: str) -> dict[str, Any]:
    return tomllib.loads((ROOT / package / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def requirements_of(package: str) -> dict[str, Requirement]:
    """By canonical name, those of the extras too."""
    project = project_of(package)
    extras = project.get("optional-dependencies", {}).values()
    requirements = map(Requirement, chain(project["dependencies"], *extras))
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
        providers = (
            [f"sparseradar-{module}"]
            if module in PACKAGES
            else distributions.get(module, [NOT_INSTALLED.get(module, module)])
        )
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


def test_the_lock_has_every_requirement_with_a_hash_at_the_pinned_version() -> None:
    """``make lock`` writes it."""
    text = (ROOT / "requirements.lock").read_text(encoding="utf-8")
    entries = re.findall(r"^([\w.-]+)==(\S+)((?:.|\n)*?)(?=^[\w.-]+==|\Z)", text, re.M)
    locked = {canonicalize_name(name): version for name, version, _ in entries}
    assert all("--hash=sha256:" in hashes for _, _, hashes in entries)
    for line in third_party():
        requirement = Requirement(line)
        assert requirement.specifier.contains(locked[canonicalize_name(requirement.name)]), line
    pins = (ROOT / "constraints.txt").read_text(encoding="utf-8")
    pinned = {canonicalize_name(name): version for name, version in re.findall(r"^([\w.-]+)==(\S+)$", pins, re.M)}
    assert {name: locked[name] for name in pinned.keys() & locked.keys()} == {
        name: pinned[name] for name in pinned.keys() & locked.keys()
    }


def _can_build_here() -> bool:
    """Setuptools as the build needs it; otherwise pip fetches one into a place of its own."""
    try:
        return Version(version("setuptools")) >= Version("77")
    except PackageNotFoundError:
        return False


@pytest.fixture(scope="module")
def wheels(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The wheel of each package, built from a copy: no build folder is left in the checkout, no old one taken up."""
    folder = tmp_path_factory.mktemp("wheels")
    left_out = shutil.ignore_patterns("build", "*.egg-info", "__pycache__")
    for package in PACKAGES:
        shutil.copytree(ROOT / package, folder / package, ignore=left_out)
    command = [sys.executable, "-m", "pip", "wheel", "--no-deps", "--quiet", "--disable-pip-version-check"]
    isolation = ["--no-build-isolation"] if _can_build_here() else []
    sources = [str(folder / package) for package in PACKAGES]
    built = subprocess.run(
        [*command, *isolation, "--wheel-dir", str(folder), *sources],
        capture_output=True, text=True, check=False, timeout=600,
    )  # fmt: skip
    assert built.returncode == 0, built.stderr
    return {package: next(folder.glob(f"sparseradar_{package}-*.whl")) for package in PACKAGES}


@pytest.mark.parametrize("package", PACKAGES)
def test_a_wheel_holds_all_sources_licence_and_readme(package: str, wheels: dict[str, Path]) -> None:
    source = ROOT / package / "src"
    with zipfile.ZipFile(wheels[package]) as wheel:
        names = {name for name in wheel.namelist() if ".dist-info/" not in name}
        (described,) = (name for name in wheel.namelist() if name.endswith(".dist-info/METADATA"))
        metadata = BytesParser().parsebytes(wheel.read(described))
        (licence,) = (name for name in wheel.namelist() if name.endswith("/licenses/LICENSE"))
        assert wheel.read(licence) == (ROOT / "LICENSE").read_bytes()
    assert names == {item.relative_to(source).as_posix() for item in source.rglob("*.py")} | DATA[package]
    assert metadata["Name"] == f"sparseradar-{package}"
    assert (metadata["License-Expression"], metadata["Requires-Python"]) == ("Apache-2.0", ">=3.11")


def ran(home: Path, *command: object) -> str:
    """What a command prints in an empty home."""
    plain = {"PATH": "/usr/bin:/bin", "HOME": str(home), "OMP_NUM_THREADS": "1"}
    done = subprocess.run(
        [*map(str, command)], capture_output=True, text=True, check=False, cwd=home, env=plain, timeout=1200
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


LOOK = """
import json, sys
from importlib.metadata import version
import shared, datafactory, trainer
from datafactory.scenes.materials.table import load_materials
from shared.radar import load_radar
from trainer.run.pretrained import pretrained_run
from trainer.run.folder import load_imager
print(json.dumps({
    "places": [package.__file__ for package in (shared, datafactory, trainer)],
    "versions": [version(f"sparseradar-{name}") for name in ("shared", "datafactory", "trainer")],
    "materials": len(load_materials().materials),
    "boards": load_radar("iwr1843").name,
    "weights": [load_imager(pretrained_run(name))[0].array.name for name in ("sparse6", "sparse4")],
}))
"""


@pytest.mark.slow
def test_the_wheels_work_in_an_empty_environment(wheels: dict[str, Path], tmp_path: Path) -> None:
    """Installed beside nothing but what they depend on, in an empty home: commands, package data, shipped networks.

    The dependencies are not installed again: their folder is added to the environment's path by a line in a ``.pth``
    file. The ``.pth`` files of that folder itself, which editable installs leave, are not obeyed then.
    """
    environment = tmp_path / "venv"
    venv.create(environment, with_pip=False)
    (site,) = environment.glob("lib/python*/site-packages")
    (site / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n", encoding="utf-8")
    python, home = environment / "bin" / "python", tmp_path / "home"
    home.mkdir()
    run = partial(ran, home)
    run(
        sys.executable, "-m", "pip", "--python", python, "install", "--no-deps", "--no-index", "--quiet",
        "--disable-pip-version-check", *wheels.values(),
    )  # fmt: skip
    found = json.loads(run(python, "-W", "ignore", "-c", LOOK))
    assert all(Path(place).is_relative_to(site) for place in found["places"])
    assert found["versions"] == [project_of(package)["version"] for package in PACKAGES]
    assert found["materials"] > 15
    assert found["boards"] == "iwr1843"
    assert found["weights"] == ["sparse6", "sparse4"]
    for program, command in (("datafactory", "render"), ("trainer", "fit")):
        assert command in run(environment / "bin" / program, "--help")
    few = ("--radar", "iwr1642", "--frames", 2, "--workers", 1)
    run(environment / "bin/datafactory", "points", *few, "--out", "two")
    assert "as they were written" in run(environment / "bin/datafactory", "inspect", "two", "--verify", "--frames", "0")
