"""One hard case: what would go wrong, the bound that must be kept, and the measurement that tells.

A measurement returns one number, smaller is better, that must be finite and at most ``bound``: an error against a slow
reference, or the count of things that went wrong (crashes, silent losses, wrong answers), whose bound is 0. While it
runs, every RuntimeWarning is an error: a logarithm of zero or a division by zero is a broken bound whatever comes out.

A theme is a module of this folder with a tuple ``CASES``; it is found by itself, its cases are run by
``test_hardcases.py`` and printed by ``run.py``. Keep its name off the standard library's (``run.py`` starts with this
folder first on the path), import heavy libraries inside the measurements, and write temporary files to a
``tempfile.TemporaryDirectory``. A measurement must not depend on the clock or on other cases.
"""

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path


@dataclass(frozen=True)
class HardCase:
    """A case that breaks radar simulators.

    :param name: unique in the catalogue, in a few words
    :param hazard: what would go wrong
    :param bound: the largest measurement that is right
    :param unit: of bound and measurement, e.g. ``"dB"``, ``"relative"``, ``"wrong answers"``
    :param measure: the measurement; may raise, which breaks the bound
    """

    name: str
    hazard: str
    bound: float
    unit: str
    measure: Callable[[], float]


@dataclass(frozen=True)
class Verdict:
    """What came of a case.

    :param measured: NaN where the measurement raised
    :param fault: why the bound is broken, in one line; "" where it is kept
    """

    case: HardCase
    measured: float
    fault: str

    @property
    def kept(self) -> bool:
        return not self.fault


def judge(case: HardCase) -> Verdict:
    """Measure a case; whatever it raises breaks its bound, and is said."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", RuntimeWarning)
            measured = float(case.measure())
    except Exception as error:  # a case may fail in any way: the table must still be printed
        return Verdict(case, math.nan, " ".join(f"{type(error).__name__}: {error}".split()))
    if not math.isfinite(measured):
        return Verdict(case, measured, "not finite")
    return Verdict(case, measured, "" if measured <= case.bound else "above the bound")


def catalogue() -> tuple[tuple[str, HardCase], ...]:
    """(theme, case) of every case, themes by name, cases in their module's order.

    :raises ValueError: two cases share a name
    """
    cases: list[tuple[str, HardCase]] = []
    for path in sorted(Path(__file__).parent.glob("*.py")):
        if path.stem in ("case", "run") or path.stem.startswith("test_"):
            continue
        theme = import_module(f"hardcases.{path.stem}")
        cases += [(path.stem, case) for case in getattr(theme, "CASES", ())]
    names = [case.name for _, case in cases]
    if len(set(names)) < len(names):
        raise ValueError(f"cases share a name: {sorted({name for name in names if names.count(name) > 1})}")
    return tuple(cases)
