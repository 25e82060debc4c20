"""The catalogue: every case of every theme.

A theme is a module of this folder with a tuple ``CASES`` of :class:`hardcases.case.HardCase`. To add a theme, put such
a module here, importing ``from hardcases.case import HardCase``; it is found by itself, its cases are run by
``test_hardcases.py`` and printed by ``run.py``. Keep its name off the standard library's (``run.py`` starts with this
folder first on the path), import heavy libraries inside the measurements, and write temporary files to a
``tempfile.TemporaryDirectory``. A measurement must not depend on the clock or on other cases.
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

from hardcases.case import HardCase


def catalogue() -> tuple[tuple[str, HardCase], ...]:
    """(theme, case) of every case, themes by name, cases in their module's order.

    :raises ValueError: two cases share a name
    """
    cases: list[tuple[str, HardCase]] = []
    for path in sorted(Path(__file__).parent.glob("*.py")):
        if path.stem in ("case", "catalogue", "run") or path.stem.startswith("test_"):
            continue
        theme = import_module(f"hardcases.{path.stem}")
        cases += [(path.stem, case) for case in getattr(theme, "CASES", ())]
    names = [case.name for _, case in cases]
    if len(set(names)) < len(names):
        raise ValueError(f"cases share a name: {sorted({name for name in names if names.count(name) > 1})}")
    return tuple(cases)
