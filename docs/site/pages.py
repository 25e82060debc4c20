"""The order of the manual's pages, and which of them are guides. It needs no site generator."""

from __future__ import annotations

import re
from os.path import relpath
from pathlib import Path

DOCS = Path(__file__).resolve().parents[1]

START = "index.md"
NOTEBOOKS = ("tour", "own_scene", "own_radar", "own_network", "cube_to_points", "accuracy_and_time")
"""Of the examples: scripts of cells, each a page under ``examples/``."""
GUIDES = (
    "start.md",
    "own-scene.md",
    "view.md",
    "own-radar.md",
    "own-network.md",
    "captures.md",
    "points.md",
    "measured.md",
    "dataset.md",
    "commands.md",
)
"""What a reader follows with own hands. The tests run their commands, or say why not."""
IDEAS = ("concepts.md", "glossary.md", "effects.md", "experiments.md")


def depth(folder: Path = DOCS) -> list[str]:
    """All other pages, by name: a page that is added appears by itself."""
    return sorted(path.name for path in folder.glob("*.md") if path.name not in {START, *GUIDES, *IDEAS})


def notes(folder: Path = DOCS) -> list[str]:
    """What was measured once and recorded."""
    return sorted(f"notes/{path.name}" for path in folder.glob("notes/*.md"))


def navigation(generated: list[str], folder: Path = DOCS) -> list[dict[str, object]]:
    """The menu: sections of pages, each page once.

    :param generated: names of the reference pages, see :mod:`reference`
    """
    return [
        {"Manual": START},
        {"Examples": [f"examples/{name}.md" for name in NOTEBOOKS]},
        {"Guides": list(GUIDES)},
        {"Ideas": list(IDEAS)},
        {"Depth": depth(folder)},
        {"Notes": notes(folder)},
        {"Reference": ["reference/index.md", *(f"reference/{name}" for name in generated)]},
    ]


_LINK = re.compile(r"(!?)\[([^\]]*)\]\(([^)\s]+)\)")
_FENCED = re.compile(r"(```.*?```)", re.DOTALL)


def without_links_out(markdown: str, page: Path, folder: Path = DOCS) -> str:
    """The page with links to files of the repository as plain text: the site holds the pages alone.

    A link to the repository's README becomes one to the manual's first page, a link to a notebook one to its page.

    :param page: the page's own path, under ``folder``
    :raises FileNotFoundError: a link to a file that does not exist
    """

    def replaced(found: re.Match[str]) -> str:
        _, label, target = found.groups()
        if re.match(r"[a-z]+:|#", target):
            return found[0]
        file = (page.parent / target.partition("#")[0]).resolve()
        if folder in file.parents:
            return found[0]
        if not file.exists():
            raise FileNotFoundError(f"{page.name}: {target}")
        if file == folder.parent / "README.md":
            return f"[{label}]({START})"
        if file.parent == folder.parent / "examples" and file.stem in NOTEBOOKS:
            return f"[{label}]({relpath(folder / 'examples' / file.stem, page.parent)}.md)"
        return label

    pieces = _FENCED.split(markdown)
    return "".join(piece if _FENCED.fullmatch(piece) else _LINK.sub(replaced, piece) for piece in pieces)
