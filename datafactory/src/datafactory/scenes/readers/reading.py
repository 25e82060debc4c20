"""How a scene file is to be read, where that is not settled by the file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from shared.physics.errors import InputError


@dataclass(frozen=True)
class Reading:
    """How a scene is read.

    :param variants: (variant set, variant) of USD, selected on every prim that has the set, over what the file selects
    :param allow_missing: go on without geometry that cannot be opened
    """

    variants: tuple[tuple[str, str], ...] = ()
    allow_missing: bool = False


AS_WRITTEN = Reading()
"""What the file says, and nothing missing."""


def parse_variants(given: Sequence[str]) -> tuple[tuple[str, str], ...]:
    """The ``--variant`` options, ``set=name`` each.

    :raises InputError: one that is not of this form, or a set that is given twice
    """
    found: dict[str, str] = {}
    for item in given:
        name, equals, variant = item.partition("=")
        if not (name and equals and variant):
            raise InputError("--variant", repr(item), "set=name, e.g. color=red")
        if found.setdefault(name, variant) != variant:
            raise InputError("--variant", f"{name!r} is given as {found[name]!r} and as {variant!r}", "one of the two")
    return tuple(found.items())
