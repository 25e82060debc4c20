"""A stranger's distribution with one of our import names is named, with the commands that mend it."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from datafactory.inspection.doctor import examine_names
from trainer.cli.entry import main


def install(folder: Path, name: str, package: str) -> None:
    """A distribution as pip records it, without its files."""
    info = folder / f"{name.replace('-', '_')}-0.0.36.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 0.0.36\n", encoding="utf-8")
    (info / "RECORD").write_text(f"{package}/__init__.py,,\n{info.name}/METADATA,,\n", encoding="utf-8")


def test_the_import_says_so_in_one_line(tmp_path: Path) -> None:
    install(tmp_path, "trainer", "trainer")
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path])}
    done = subprocess.run(
        [sys.executable, "-c", "import trainer"], capture_output=True, text=True, env=environment, check=False
    )
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1] == (
        "ImportError: the distribution 'trainer' is installed over 'sparseradar-trainer', both bring the package "
        "'trainer'; mend it: pip uninstall -y trainer && pip install --force-reinstall --no-deps sparseradar-trainer"
    )


def test_the_command_says_so_in_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(tmp_path, "trainer", "trainer")
    monkeypatch.syspath_prepend(str(tmp_path))
    with pytest.raises(SystemExit) as caught:
        main()
    assert str(caught.value.code).startswith("trainer: the distribution 'trainer' is installed over")
    assert "\n" not in str(caught.value.code)


def test_the_doctor_finds_one_of_any_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(tmp_path, "somebodys-trainer", "trainer")
    monkeypatch.syspath_prepend(str(tmp_path))
    (finding,) = [finding for finding in examine_names() if not finding.ok]
    assert finding.item == "package trainer"
    assert finding.value == "somebodys-trainer is installed over sparseradar-trainer"
    assert finding.remedy.startswith("pip uninstall -y somebodys-trainer && pip install --force-reinstall")
    assert finding.required
