"""What all readers share: how a file is to be read, their counted remarks, what a scene may hold, a plausible size."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

from datafactory.scenes.scene import Scene
from shared.physics.errors import InputError

MAXIMUM_OBJECTS = 250_000
"""Objects and point targets: reading them takes about three minutes and 1 GB."""
MAXIMUM_TRIANGLES = 20_000_000
"""Merged and in the ray tracer they take about 8 GB."""
MAXIMUM_SAMPLED = 100_000_000
"""Coordinates of all samples of one mesh's moving points: 400 MB."""
MAXIMUM_NESTING = 64
"""Levels of instances within instances."""
PLAUSIBLE_METRES = (0.1, 50e3)
"""Of a scene's longest side: a tin can, a city."""


@dataclass(frozen=True)
class Reading:
    """How a scene is read, where that is not settled by the file.

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


class Notes:
    """Counted remarks of one reading, what a file holds and the scene does not, in the order in which they came up."""

    def __init__(self) -> None:
        self._counts: Counter[str] = Counter()

    def count(self, remark: str, number: int = 1) -> None:
        """Add ``number`` to the count of one kind of remark.

        :param remark: the sentence, with ``#`` where the count goes, e.g. ``"# prims of type Points ignored"``
        """
        if number:
            self._counts[remark] += number

    def say(self, remark: str) -> None:
        """Add a remark that has no count; saying it twice changes nothing."""
        self._counts[remark] = 1

    def repeat(self, other: Notes) -> None:
        """Add the counts of other notes once more."""
        self._counts.update(other._counts)

    def sentences(self) -> tuple[str, ...]:
        """The remarks with their counts filled in."""
        return tuple(remark.replace("#", str(number), 1) for remark, number in self._counts.items())


def check_counts(source: object, what: str, objects: int, triangles: int) -> None:
    """Refuse more objects or triangles than a scene may hold: a few lines of nested instances can ask for millions.

    :param what: the part of the scene that they belong to, e.g. ``"point instancer /World/Trees"``
    :raises InputError: naming the part, the figure and the limit
    """
    for count, kind, limit in ((objects, "objects", MAXIMUM_OBJECTS), (triangles, "triangles", MAXIMUM_TRIANGLES)):
        if count > limit:
            raise InputError(source, f"{what} makes {count} {kind}", f"at most {limit}")


def with_remarks(scene: Scene, notes: Notes, remedy: str, always: bool = False) -> Scene:
    """The scene with the remarks of its reading, among them one on its size where that is implausible.

    :param remedy: what the user should check then
    :param always: say the size, whatever it is
    """
    if scene.objects or scene.targets:
        lower, upper = scene.bounds()
        sides = upper - lower
        low, high = PLAUSIBLE_METRES
        if always or sides.max() > high or (scene.objects and sides.max() < low):
            text = " x ".join(f"{side:.3g}" for side in sides)
            notes.say(f"the scene measures {text} m (x, y, z): check {remedy}")
    return replace(scene, warnings=notes.sentences())
