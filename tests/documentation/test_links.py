"""The manual: links lead somewhere, the menu has every page, the chain has the code's steps, notebooks' pages."""

import re
from pathlib import Path

import pytest
from manual import DOCS, PAGES, ROOT, anchors, links, name_of
from notebooks import page_of, run
from pages import GUIDES, IDEAS, NOTEBOOKS, START, depth, navigation, without_links_out

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


FRAME = ROOT / "datafactory/src/datafactory/frame"
AROUND = {"deal", "shard"}
"""Of the chain as the page has it: what stands before and behind the steps that a hook sees."""


def test_the_chain_of_a_frame_has_the_steps_that_a_hook_sees() -> None:
    page = (DOCS / "architecture.md").read_text(encoding="utf-8")
    (chain,) = re.findall(r"^    deal -> .*?\n\n", page, re.MULTILINE | re.DOTALL)
    told = [step.strip() for step in " ".join(chain.split()).split("->")]
    code = "".join((FRAME / name).read_text(encoding="utf-8") for name in ("chain.py", "measurement.py"))
    taken = set(re.findall(r'\bat\(\s*"([^"]+)"', code)) - {"read"}
    assert set(told) - AROUND == taken


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
