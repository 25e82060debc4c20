"""Generated pages come from models, commands and docstrings, links lead somewhere, notebooks run if they changed;
the examples of every command's help, run in their order on smaller scenes.
"""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
from inspect import signature
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from manual import DOCS, PAGES, ROOT, anchors, links, name_of, run_program
from notebooks import page_of, run
from pages import GUIDES, IDEAS, NOTEBOOKS, START, depth, navigation, without_links_out
from raw_files import write_two_lanes
from reference import commands_page, fit_page, materials_page, names_page, radar_page
from small_radar import write_small_radar
from typer.main import get_command
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
    for page in (*map(commands_page, ("datafactory", "trainer")), radar_page(), materials_page(), fit_page()):
        rows = [line for line in page.splitlines() if line.startswith("| `")]
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


SECTIONS = ["Guides", "Ideas", "Depth", "Notes", "Reference"]


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_links_lead_to_a_file_and_a_heading(page: Path) -> None:
    for link in links(page):
        path, _, heading = link.partition("#")
        target = (page.parent / path).resolve() if path else page
        assert target.exists(), f"{link} does not exist"
        assert ROOT in target.parents, f"{link} leads out of the repository"
        if heading:
            assert heading in anchors(target), f"{link}: no such heading"


def test_every_page_is_once_in_the_menu() -> None:
    """A page that is added is found by itself, under Depth."""
    listed = [START, *GUIDES, *IDEAS, *depth()]
    assert sorted(listed) == sorted(path.name for path in DOCS.glob("*.md"))
    menu = navigation(["radar.md"])
    assert [next(iter(section)) for section in menu] == ["Manual", "Examples", *SECTIONS]
    assert menu[-1] == {"Reference": ["reference/index.md", "reference/radar.md"]}


def test_the_first_page_names_every_guide_and_idea() -> None:
    text = (DOCS / START).read_text(encoding="utf-8")
    assert [name for name in (*GUIDES, *IDEAS) if f"({name})" not in text] == []


def test_a_new_page_appears_under_depth(tmp_path: Path) -> None:
    (tmp_path / "new.md").write_text("# New\n", encoding="utf-8")
    assert {"Depth": ["new.md"]} in navigation([], tmp_path)


def test_links_out_of_the_manual_become_text(tmp_path: Path) -> None:
    folder = tmp_path / "docs"
    folder.mkdir()
    (tmp_path / "README.md").touch()
    (tmp_path / "code.py").touch()
    page = folder / "page.md"
    text = "[`code.py`](../code.py), [start](../README.md#start), [here](other.md#x), ![p](p.png)\n"
    assert without_links_out(text, page, folder) == "`code.py`, [start](index.md), [here](other.md#x), ![p](p.png)\n"
    with pytest.raises(FileNotFoundError, match=r"page\.md: \.\./gone\.py"):
        without_links_out("[gone](../gone.py)", page, folder)
    notebooks = tmp_path / "examples"
    notebooks.mkdir()
    (notebooks / f"{NOTEBOOKS[0]}.py").touch()
    (folder / "notes").mkdir()
    for place, up in ((page, ""), (folder / "notes" / "page.md", "../")):
        link = f"[tour]({up}../examples/{NOTEBOOKS[0]}.py)"
        assert without_links_out(link, place, folder) == f"[tour]({up}examples/{NOTEBOOKS[0]}.md)"
    fenced = "```\n[gone](../gone.py)\n```\n"
    assert without_links_out(fenced, page, folder) == fenced


SCRIPT = """# %% [markdown]
# # A title
#
# Some words.

# %%
from __future__ import annotations

import os
from pathlib import Path

out = Path(os.environ["EXAMPLES_OUT"]) / "small"
out.mkdir(parents=True)
with (out.parent / "runs.txt").open("a") as file:
    file.write("run\\n")


# %%
def later(value: Undefined) -> None: ...


(out / "dot.png").write_bytes(b"a picture")
print("printed")
"""


@pytest.fixture
def script(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("EXAMPLES_OUT", str(tmp_path / "out"))
    path = tmp_path / "small.py"
    path.write_text(SCRIPT, encoding="utf-8")
    return path


def test_a_page_has_text_code_output_and_pictures_of_the_script_as_it_was_run(script: Path, tmp_path: Path) -> None:
    kept = tmp_path / "kept"
    run(script, kept)
    run(script, kept)
    assert (tmp_path / "out" / "runs.txt").read_text() == "run\n"
    page, pictures = page_of(script, kept)
    assert page.startswith("# A title\n\n*`examples/small.py` with its output")
    assert page.endswith("```text\nprinted\n```\n\n![dot](small/dot.png)\n")
    assert [picture.read_bytes() for picture in pictures] == [b"a picture"]
    script.write_text(SCRIPT.replace("printed", "another"), encoding="utf-8")
    page, pictures = page_of(script, kept)
    assert "which was not run" in page
    assert ("```text" in page, pictures) == (False, [])
    run(script, kept)
    assert "```text\nanother\n```" in page_of(script, kept)[0]


def test_a_script_that_fails_leaves_no_page(script: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    script.write_text(SCRIPT + "raise ValueError('no')\n", encoding="utf-8")
    with pytest.raises(RuntimeError, match=r"small\.py failed"):
        run(script, tmp_path / "kept")
    line = SCRIPT.count("\n") + 1
    assert f'small.py", line {line}' in capfd.readouterr().err
    assert "which was not run" in page_of(script, tmp_path / "kept")[0]


APPS = {"datafactory": datafactory, "trainer": trainer}
GROUPS: dict[str, Any] = {program: get_command(app) for program, app in APPS.items()}
NAMES = [("datafactory", name) for name in OF_DATAFACTORY] + [("trainer", name) for name in OF_TRAINER]
EVERY = [*sum(OF_DATAFACTORY.values(), ()), *sum(OF_TRAINER.values(), ())]

SMALLER = {
    "--radar": "small.toml", "--rays": "2000", "--effects": "diffuse", "--workers": "1", "--split": "1:1:1",
    "--steps": "2", "--rows": "16", "--points": "0", "--batch": "1", "--validate-every": "2", "--width": "4",
    "--hidden": "8", "--blocks": "1", "--quick": "", "--trials": "2", "--shown": "1", "--experiments": "street",
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
        _run(monkeypatch, f"datafactory points --frames 4 --out build/jobs --shard {job}/2")
    radar = load_radar("iwr1843")
    for name, (range_m, angle_deg) in CORNERS.items():
        place = range_m * np.exp(1j * np.deg2rad(angle_deg))
        cube = if_signal(radar, np.array([[place.real, place.imag, 0.0]]), np.zeros((1, 3)), np.ones(1))
        write_two_lanes(tmp_path / name, np.asarray(cube)[None], radar)
    for text in EVERY:
        _run(monkeypatch, text)
    for made in (
        "mine/manifest.json", "whole/manifest.json", "street.html", "run.onnx", "images", "images-of-run",
        "report/report.html", "accuracy/accuracy.png",
    ):  # fmt: skip
        assert (tmp_path / "build" / made).exists(), made


def _run(patch: pytest.MonkeyPatch, text: str) -> None:
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
    run_program(patch, program, [name, *arguments, *words])
