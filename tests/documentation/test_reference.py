"""The generated pages are produced from the models, the commands and the docstrings."""

from __future__ import annotations

import os
import subprocess
import sys
from inspect import signature
from pathlib import Path

import pytest
from manual import DOCS, ROOT
from pydantic import BaseModel
from reference import commands_page, descriptions, fit_page, materials_page, names_page, radar_page
from typer.main import get_command

from datafactory import convert, merge, plan, render, trace
from datafactory.cli.app import app as datafactory
from datafactory.scenes.materials.table import MaterialEntry, load_materials
from shared.radar.front_end import FrontEnd
from shared.radar.radar import Radar
from shared.radar.waveform import Waveform
from trainer.cli.app import app as trainer
from trainer.run.configuration import FitConfig


def test_a_line_without_a_field_and_a_field_without_a_line_fail() -> None:
    class Renamed(BaseModel):
        """:param count: how many"""

        number: int = 4

    class Gone(BaseModel):
        """:param count: how many"""

    with pytest.raises(ValueError, match="Renamed: no :param line for number"):
        descriptions(Renamed)
    with pytest.raises(ValueError, match="Gone: :param count, which is no field"):
        descriptions(Gone)


def test_the_pages_of_models_have_every_field() -> None:
    for page, models in (
        (radar_page(), (Radar, Waveform, FrontEnd)),
        (materials_page(), (MaterialEntry,)),
        (fit_page(), (FitConfig,)),
    ):
        assert [name for model in models for name in model.model_fields if f"| `{name}` |" not in page] == []
    assert "| `chirps` | integer >= 1, <= 65536 | `128` | chirps a frame |" in radar_page()
    assert '`"simultaneous"` or `"tdm"`' in radar_page()
    assert "`iwr1843`" in radar_page()
    assert [name for name in load_materials().materials if f"| `{name}` |" not in materials_page()] == []


@pytest.mark.parametrize(("program", "app"), [("datafactory", datafactory), ("trainer", trainer)])
def test_the_pages_of_commands_have_every_option(program: str, app: object) -> None:
    page = commands_page(program)
    for name, command in get_command(app).commands.items():  # type: ignore[arg-type, attr-defined]
        assert f"## {program} {name}\n" in page
        section = page.partition(f"## {program} {name}\n")[2].partition("\n## ")[0]
        for parameter in command.params:
            if parameter.param_type_name == "option" and not getattr(parameter, "hidden", False):
                assert parameter.opts[0] in section


def test_functions_of_options_have_a_table_of_their_parameters() -> None:
    page = names_page("datafactory")
    for function in (render, trace, plan, merge, convert):
        section = page.partition(f"## datafactory.{function.__name__}\n")[2].partition("\n## ")[0]
        for name in signature(function).parameters:
            assert f"| `{name}` |" in section
    assert "- raises RunFailed: worker processes died" in page


def test_no_description_is_empty_and_units_survive() -> None:
    for program in ("datafactory", "trainer"):
        rows = [line for line in commands_page(program).splitlines() if line.startswith("| `")]
        assert [row for row in rows if row.endswith("|  |")] == []
    assert "for this error [dB]" in commands_page("datafactory")


@pytest.mark.slow
def test_the_site_is_made_without_a_warning(tmp_path: Path) -> None:
    """``make docs``: strict, so that a dead link or anchor, a page that is missing from the menu or a docstring that
    cannot be read ends it."""
    made = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--config-file", str(DOCS / "site/mkdocs.yml"),
         "--site-dir", str(tmp_path / "site")],
        capture_output=True, text=True, check=False, cwd=ROOT, env={**os.environ, "NO_MKDOCS_2_WARNING": "1"},
    )  # fmt: skip
    assert made.returncode == 0, made.stdout + made.stderr
    assert made.stdout + made.stderr == ""
    for page in ("index", "start", "examples/tour", "reference/radar", "reference/trainer"):
        assert (tmp_path / f"site/{page}.html").is_file()
    text = (tmp_path / "site/start.html").read_text(encoding="utf-8")
    assert "fonts.googleapis.com" not in text
