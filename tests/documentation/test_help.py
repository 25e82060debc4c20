"""What ``--help`` ends with: two examples of each command, run here; it answers without what computes.

The reference pages are made of the same commands, of the models and of the docstrings.
"""

import os
import shlex
import subprocess
import sys
from inspect import signature
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer
from command_line import ended
from manual import DOCS, ROOT
from processes import python
from pydantic import BaseModel
from raw_files import write_two_lanes
from reference import commands_page, descriptions, fit_page, materials_page, names_page, radar_page
from small_radar import write_small_radar
from typer.main import get_command
from typer.models import CommandInfo
from typer.testing import CliRunner

from datafactory import convert, merge, plan, render, trace
from datafactory.cli.app import EXAMPLES as OF_DATAFACTORY
from datafactory.cli.app import app as datafactory
from datafactory.scenes.materials.table import MaterialEntry, load_materials
from shared.radar import load_radar
from shared.radar.front_end import FrontEnd
from shared.radar.radar import Radar
from shared.radar.waveform import Waveform
from shared.signal.signal import if_signal
from trainer.cli.app import EXAMPLES as OF_TRAINER
from trainer.cli.app import app as trainer
from trainer.run.configuration import FitConfig

APPS = {"datafactory": datafactory, "trainer": trainer}
GROUPS: dict[str, Any] = {program: get_command(app) for program, app in APPS.items()}
NAMES = [("datafactory", name) for name in OF_DATAFACTORY] + [("trainer", name) for name in OF_TRAINER]
EVERY = [*sum(OF_DATAFACTORY.values(), ()), *sum(OF_TRAINER.values(), ())]

SMALLER = {
    "--radar": "small.toml", "--rays": "2000", "--effects": "diffuse", "--workers": "1", "--split": "1:1:1",
    "--steps": "2", "--rows": "16", "--points": "0", "--batch": "1", "--validate-every": "2", "--width": "4",
    "--blocks": "1", "--quick": "", "--trials": "2", "--shown": "1", "--experiments": "street",
}  # fmt: skip
"""Given besides, or instead, where a command has the option."""
FEWER = {"shipped:street": "shipped:tiny", "sionna:munich": "sionna:simple_street_canyon_with_cars"}
"""In place of a scene."""
CORNERS = {"corner.bin": (5.02, 0.0), "other.bin": (4.1, 15.0), "adc_data.bin": (3.0, -20.0)}
"""Captures that the examples name: metres and degrees of the reflector in each."""


def test_every_command_has_two_examples() -> None:
    for program, examples in (("datafactory", OF_DATAFACTORY), ("trainer", OF_TRAINER)):
        assert examples.keys() == GROUPS[program].commands.keys()
        assert all(len(pair) == 2 for pair in examples.values())


@pytest.mark.parametrize(("program", "name"), NAMES, ids=" ".join)
def test_help_ends_with_examples_that_are_understood(program: str, name: str) -> None:
    pair = (OF_DATAFACTORY if program == "datafactory" else OF_TRAINER)[name]
    shown = CliRunner().invoke(APPS[program], [name, "--help"], env={"COLUMNS": "200"})
    lines = [line.strip() for line in shown.stdout.splitlines() if line.strip()]
    assert lines[-3:] == ["Examples:", *pair]
    for text in pair:
        own, command, *arguments = shlex.split(text)
        assert own == program
        GROUPS[program].commands[command].make_context(command, arguments)


@pytest.mark.slow
def test_the_examples_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, variant: str) -> None:
    """In the order of the lists, each on what those before it wrote; captures, and the jobs that ``merge`` joins, are
    made here."""
    monkeypatch.chdir(tmp_path)
    write_small_radar(tmp_path)
    Path("build").mkdir()
    for job in (0, 1):
        _run(f"datafactory points --frames 4 --out build/jobs --shard {job}/2")
    radar = load_radar("iwr1843")
    for name, (range_m, angle_deg) in CORNERS.items():
        place = range_m * np.exp(1j * np.deg2rad(angle_deg))
        cube = if_signal(radar, np.array([[place.real, place.imag, 0.0]]), np.zeros((1, 3)), np.ones(1))
        write_two_lanes(tmp_path / name, np.asarray(cube)[None], radar)
    for text in EVERY:
        _run(text)
    for made in (
        "mine/manifest.json", "whole/manifest.json", "street.html", "run.onnx", "images", "images-of-run",
        "report/report.html", "accuracy/accuracy.png",
    ):  # fmt: skip
        assert (tmp_path / "build" / made).exists(), made


def _run(text: str) -> None:
    """In this process, smaller; the exit status is 0."""
    program, name, *arguments = shlex.split(text)
    arguments = [FEWER.get(word, word) for word in arguments]
    options = {option for parameter in GROUPS[program].commands[name].params for option in parameter.opts}
    smaller = {option: value for option, value in SMALLER.items() if option in options}
    if name in ("render", "trace"):
        smaller |= {"--frames": "3"}
    if name != "fit":  # elsewhere it is a flag, or adds frames
        smaller.pop("--points", None)
    if name == "render" or program == "trainer":  # the shipped networks' radar, and that of datasets and captures
        smaller.pop("--radar", None)
    if program == "trainer":  # a dataset has its splits
        smaller.pop("--split", None)
    words = (word for pair in smaller.items() for word in pair if word)
    code, _, said = ended(program, name, *arguments, *words)
    assert code == 0, f"{text}: {said}"


OURS = {"shared", "datafactory", "trainer"}
COMMAND_LINE = {
    "typer", "rich", "click", "shellingham", "pygments", "markdown_it", "mdurl", "typing_extensions", "annotated_doc",
    "attr", "colorama", "pydantic", "pydantic_core", "annotated_types", "typing_inspection",
}  # fmt: skip
"""Typer, Rich, and what they import to print a page of help; Typer checks the limits of options by pydantic."""

ASK = """
import sys
def tops():
    return {name.partition(".")[0] for name in sys.modules}
before = tops()
program, *commands = sys.argv[1:]
from importlib import import_module
main = import_module(program + ".cli.entry").main
for command in commands:
    sys.argv = [program, *command.split()]
    try:
        main()
    except SystemExit as left:
        assert not left.code, left.code
    names = tops() - before - sys.stdlib_module_names
    print("IMPORTED", *sorted(name for name in names if not name.startswith("_")))
    before = tops()
"""
"""Asks for one page of help after the other; each names what no page before it imported."""


def name_of(command: CommandInfo) -> str:
    """As the user types it."""
    assert command.callback is not None
    return command.name or command.callback.__name__


@pytest.mark.parametrize(("program", "app"), [("datafactory", datafactory), ("trainer", trainer)])
def test_help_imports_nothing_that_computes(program: str, app: typer.Typer) -> None:
    pages = ["--help", *(f"{name_of(command)} --help" for command in app.registered_commands)]
    answer = python("-c", ASK, program, *pages)
    assert answer.count("Usage:") >= len(pages)
    imported = [line.split()[1:] for line in answer.splitlines() if line.startswith("IMPORTED")]
    for page, names in zip(pages, imported, strict=True):
        assert set(names) - OURS <= COMMAND_LINE, page


def test_what_computes_would_be_noticed() -> None:
    """The question finds numpy where something imports it."""
    assert "numpy" in python("-c", ASK.replace("main()", "import numpy"), "trainer", "--help").split()


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
