"""Every case of the catalogue keeps its bound, and the catalogue's own machinery can tell when one does not."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hardcases.case import HardCase, judge
from hardcases.catalogue import catalogue
from hardcases.run import markdown_of, records_of

CATALOGUE = catalogue()


@pytest.mark.parametrize(("theme", "case"), CATALOGUE, ids=[f"{theme}-{case.name}" for theme, case in CATALOGUE])
def test_hard_case(theme: str, case: HardCase) -> None:
    verdict = judge(theme, case)
    assert verdict.kept, f"{verdict.fault} (measured {verdict.measured:g} {case.unit}, bound {case.bound:g})"


def case_of(measure) -> HardCase:
    return HardCase("example", "none", 1.0, "m", measure)


@pytest.mark.parametrize(
    ("measure", "fault"),
    [
        (lambda: 2.0, "above the bound"),
        (lambda: math.nan, "not finite"),
        (lambda: -math.inf, "not finite"),
        (lambda: 1 // 0, "ZeroDivisionError"),
        (lambda: np.log10(np.zeros(1))[0], "RuntimeWarning"),
    ],
)
def test_a_broken_bound_is_said(measure, fault: str) -> None:
    verdict = judge("theme", case_of(measure))
    assert not verdict.kept
    assert fault in verdict.fault
    assert records_of([verdict])[0]["kept"] is False
    assert "**broken**" in markdown_of([verdict])


def test_a_kept_bound_is_said() -> None:
    verdict = judge("theme", case_of(lambda: 1.0))
    assert verdict.kept
    assert records_of([verdict])[0]["measured"] == 1.0
