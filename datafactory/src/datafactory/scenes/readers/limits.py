"""What a scene may hold: counts are compared with these limits before anything is expanded.

A file of a few lines can ask for millions of objects by nesting instances, references or includes. Readers count by
multiplication first, and refuse with the figure what would not fit into memory or time.
"""

from __future__ import annotations

from shared.physics.errors import InputError

MAXIMUM_OBJECTS = 250_000
"""Objects and point targets: reading them takes about two minutes and 1 GB."""
MAXIMUM_TRIANGLES = 20_000_000
"""Merged and in the ray tracer they take about 8 GB."""
MAXIMUM_PRIMS = 1_000_000
"""USD composes about 40 000 prims a second, and keeps 2 kB of each."""
MAXIMUM_SAMPLED = 100_000_000
"""Coordinates of all samples of one mesh's moving points: 400 MB."""
MAXIMUM_NESTING = 64
"""Levels of instances within instances, and of prims, references and includes within one another."""
LONGEST_VALUE = 100_000
"""Characters of an XML attribute after substitution."""


def check_counts(source: object, what: str, objects: int, triangles: int) -> None:
    """Refuse more objects or triangles than a scene may hold.

    :param what: the part of the scene that they belong to, e.g. ``"point instancer /World/Trees"``
    :raises InputError: naming the part, the figure and the limit
    """
    for count, kind, limit in ((objects, "objects", MAXIMUM_OBJECTS), (triangles, "triangles", MAXIMUM_TRIANGLES)):
        if count > limit:
            raise InputError(source, f"{what} makes {figure(count)} {kind}", f"at most {limit}")


def figure(count: int) -> str:
    """A count in digits, rounded where it has more than fifteen of them."""
    return str(count) if count < 10**15 else f"{float(min(count, 10**300)):.1e}"
