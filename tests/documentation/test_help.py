"""What ``--help`` ends with: two examples of each command, run here; it answers without what computes."""

from __future__ import annotations

import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer
from command_line import ended
from raw_files import write_two_lanes
from small_radar import write_small_radar
from typer.main import get_command
from typer.models import CommandInfo
from typer.testing import CliRunner

from datafactory.cli.app import EXAMPLES as OF_DATAFACTORY
from datafactory.cli.app import app as datafactory
from shared.radar import load_radar
from shared.signal.signal import if_signal
from trainer.cli.app import EXAMPLES as OF_TRAINER
from trainer.cli.app import app as trainer

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


def asked(program: str, *pages: str, ask: str = ASK) -> str:
    """What a fresh interpreter prints."""
    command = [sys.executable, "-c", ask, program, *pages]
    return subprocess.run(command, capture_output=True, text=True, check=True, encoding="utf-8").stdout


@pytest.mark.parametrize(("program", "app"), [("datafactory", datafactory), ("trainer", trainer)])
def test_help_imports_nothing_that_computes(program: str, app: typer.Typer) -> None:
    pages = ["--help", *(f"{name_of(command)} --help" for command in app.registered_commands)]
    answer = asked(program, *pages)
    assert answer.count("Usage:") >= len(pages)
    imported = [line.split()[1:] for line in answer.splitlines() if line.startswith("IMPORTED")]
    for page, names in zip(pages, imported, strict=True):
        assert set(names) - OURS <= COMMAND_LINE, page


def test_what_computes_would_be_noticed() -> None:
    """The question finds numpy where something imports it."""
    assert "numpy" in asked("trainer", "--help", ask=ASK.replace("main()", "import numpy")).split()
