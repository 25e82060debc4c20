"""Every case of the catalogue keeps its bound, and the catalogue's own machinery can tell when one does not."""

import math

import numpy as np
import pytest
from hardcases.case import HardCase, catalogue, judge
from hardcases.phase_fidelity import FLOOR_DB, PHASE_DEG, YAW_DEG, fidelity
from hardcases.run import row_of

from datafactory.scenes.poses import Pose

CATALOGUE = catalogue()


@pytest.mark.parametrize(
    "case", [case for _, case in CATALOGUE], ids=[f"{theme}-{case.name}" for theme, case in CATALOGUE]
)
def test_hard_case(case: HardCase) -> None:
    verdict = judge(case)
    assert verdict.kept, f"{verdict.fault} (measured {verdict.measured:g} {case.unit}, bound {case.bound:g})"


@pytest.mark.parametrize(
    ("measure", "fault"),
    [
        (lambda: 2.0, "above the bound"),
        (lambda: math.nan, "not finite"),
        (lambda: -math.inf, "not finite"),
        (lambda: 1 // 0, "ZeroDivisionError"),
        (lambda: np.log10(np.zeros(1))[0], "RuntimeWarning"),
        (lambda: 1.0, ""),
    ],
)
def test_a_broken_bound_is_said(measure, fault: str) -> None:
    verdict = judge(HardCase("example", "none", 1.0, "m", measure))
    assert verdict.kept == (not fault)
    assert fault in verdict.fault
    assert ("**broken**" in row_of(verdict)) == bool(fault)


@pytest.mark.usefixtures("variant")
def test_the_figure_of_phases_can_fail(monkeypatch: pytest.MonkeyPatch) -> None:
    """An attitude that is 1e-3 deg off breaks the bound: a quarter of a degree between the ends of 0.5 m."""
    good = fidelity("point target", 50.0, 0.0)
    assert good.array_deg < PHASE_DEG
    assert good.floor_db < FLOOR_DB
    fidelity.cache_clear()
    elsewhere = Pose((0.0, 0.0, 0.0), YAW_DEG + 1e-3).rotation().astype(np.longdouble)
    monkeypatch.setattr("hardcases.phase_fidelity._turn", lambda: elsewhere)
    assert fidelity("point target", 50.0, 0.0).array_deg > PHASE_DEG
    fidelity.cache_clear()
