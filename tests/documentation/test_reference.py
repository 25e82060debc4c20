"""Generated pages come from models, commands and docstrings, links lead somewhere, notebooks run if they changed."""

from __future__ import annotations

import os
import subprocess
import sys
from inspect import signature
from pathlib import Path

import pytest
from manual import DOCS, PAGES, ROOT, anchors, links, name_of
from notebooks import page_of, run
from pages import GUIDES, IDEAS, NOTEBOOKS, START, depth, navigation, without_links_out
from reference import commands_page, fit_page, materials_page, names_page, radar_page
from typer.main import get_command

from datafactory import convert, merge, plan, render, trace
from datafactory.cli.app import app as datafactory
from datafactory.scenes.materials.table import MaterialEntry, load_materials
from shared.radar.front_end import FrontEnd
from shared.radar.radar import Radar
from shared.radar.waveform import Waveform
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
