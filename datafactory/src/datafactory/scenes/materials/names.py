"""The words of a scene's material names, for look-up in the material table."""

from __future__ import annotations

import re
from collections.abc import Iterator

PREFIXES = frozenset({"mat", "mtl", "material", "itu", "m", "mi", "radio", "tex", "shader"})
"""Words that mark any material (Sionna ``mat-itu_``, Blender ``Material.``, Unreal ``M_``) and name none."""

SUFFIXES = frozenset({"mat", "mtl", "material", "shader", "inst", "instance", "sg"})


def words(name: str) -> tuple[str, ...]:
    """Lower-case words of a material name, without those that mark any material.

    A USD path counts by its last part; camel case and every sign that is no letter separate words; numbers such as
    ``.001`` or ``_2`` are no words. ``"/World/Looks/M_WetGround_01"`` gives ``("wet", "ground")``.
    """
    last = name.rstrip("/").rsplit("/", 1)[-1].rsplit(":", 1)[-1]
    split = re.sub(r"([a-z])([A-Z])", r"\1 \2", last)
    found = re.findall(r"[^\W\d_]+", split.lower().replace("ß", "ss"))
    while len(found) > 1 and found[0] in PREFIXES:
        found = found[1:]
    while len(found) > 1 and found[-1] in SUFFIXES:
        found = found[:-1]
    return tuple(found)


def phrases(name_words: tuple[str, ...]) -> Iterator[str]:
    """All runs of adjacent words, longest first and, among equals, last first: in "brick road" the road is the noun."""
    for length in range(len(name_words), 0, -1):
        for start in range(len(name_words) - length, -1, -1):
            yield " ".join(name_words[start : start + length])


def singular(phrase: str) -> str:
    """The phrase without a plural s: "windows" is looked up as "window" where "windows" is unknown."""
    return phrase[:-1] if phrase.endswith("s") and not phrase.endswith("ss") else phrase
