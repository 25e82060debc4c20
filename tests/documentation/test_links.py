"""Links lead somewhere, and the menu has every page: what can be known without the site's generator."""

from __future__ import annotations

from pathlib import Path

import pytest
from manual import DOCS, PAGES, ROOT, anchors, links, name_of
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
