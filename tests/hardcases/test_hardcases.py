"""Every case of the catalogue keeps its bound."""

from __future__ import annotations

import pytest
from hardcases.case import HardCase, catalogue, judge

CATALOGUE = catalogue()


@pytest.mark.parametrize(
    "case", [case for _, case in CATALOGUE], ids=[f"{theme}-{case.name}" for theme, case in CATALOGUE]
)
def test_hard_case(case: HardCase) -> None:
    verdict = judge(case)
    assert verdict.kept, f"{verdict.fault} (measured {verdict.measured:g} {case.unit}, bound {case.bound:g})"
