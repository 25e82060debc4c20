"""One hard case: what would go wrong, the bound that must be kept, and the measurement that tells.

A measurement returns one number, smaller is better, that must be finite and at most ``bound``: an error against a slow
reference, or the count of things that went wrong (crashes, silent losses, wrong answers), whose bound is 0. While it
runs, every RuntimeWarning is an error: a logarithm of zero or a division by zero is a broken bound whatever comes out.

A theme is a module of this folder with a tuple ``CASES``; it is found by itself, its cases are run by
``test_hardcases.py`` and printed by ``run.py``. Keep its name off the standard library's (``run.py`` starts with this
folder first on the path), import heavy libraries inside the measurements, and write temporary files to a
``tempfile.TemporaryDirectory``. A measurement must not depend on the clock or on other cases.
"""

from collections.abc import Callable
from dataclasses import dataclass


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
