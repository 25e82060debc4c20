"""README is short, and says what a word means before it uses it."""

from __future__ import annotations

import pytest
from manual import DOCS, ROOT, sentences
from pages import GUIDES, IDEAS, START

README = ROOT / "README.md"
LONGEST_README = 130
LONGEST_MEAN = 18.0
"""Words a sentence, on average."""
EXPLAINED = {
    "sparse6": "of its 16 receivers",
    "NMSE": "squared error",
    "IAA": "iterative adaptive approach",
    "MUSIC": "multiple signal classification",
    "FMCW": "frequency-modulated",
    "RCS": "radar cross section",
}
"""What must stand before or with the abbreviation."""


def test_readme_is_short() -> None:
    assert len(README.read_text(encoding="utf-8").splitlines()) <= LONGEST_README


@pytest.mark.parametrize("abbreviation", EXPLAINED)
def test_readme_explains_before_it_abbreviates(abbreviation: str) -> None:
    text = " ".join(README.read_text(encoding="utf-8").split())
    if abbreviation in text:
        meaning = text.find(EXPLAINED[abbreviation])
        assert meaning >= 0, f"{abbreviation} is not explained"
        assert meaning < text.index(abbreviation) + 80


@pytest.mark.parametrize(
    "page",
    ["README.md", *(f"docs/{name}" for name in (START, "start.md", "own-scene.md", "own-radar.md", "own-network.md"))],
)
def test_sentences_are_short(page: str) -> None:
    counts = [len(sentence.split()) for sentence in sentences(ROOT / page)]
    assert sum(counts) / len(counts) < LONGEST_MEAN


def test_the_first_page_names_every_guide_and_idea() -> None:
    text = (DOCS / START).read_text(encoding="utf-8")
    assert [name for name in (*GUIDES, *IDEAS) if f"({name})" not in text] == []
