"""Every case of the catalogue keeps its bound, and a wrong attitude breaks that of phases."""

from collections.abc import Callable
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from hardcases.case import HardCase
from hardcases.phase_fidelity import FLOOR_DB, PHASE_DEG, YAW_DEG, fidelity

from datafactory.scenes.poses import Pose

THEMES = sorted(path.stem for path in Path(__file__).parent.glob("*.py") if not path.stem.startswith("test_"))
CATALOGUE: list[tuple[str, HardCase]] = [
    (theme, case) for theme in THEMES for case in getattr(import_module(f"hardcases.{theme}"), "CASES", ())
]


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize(
    "case", [case for _, case in CATALOGUE], ids=[f"{theme}-{case.name}" for theme, case in CATALOGUE]
)
def test_hard_case(case: HardCase, record_property: Callable[[str, object], None]) -> None:
    measured = float(case.measure())
    record_property("row", f"| {case.name} | {case.hazard} | {case.bound:.3g} {case.unit} | {measured:.3g} |")
    assert -np.inf < measured <= case.bound


def test_no_two_cases_share_a_name() -> None:
    names = [case.name for _, case in CATALOGUE]
    assert len(set(names)) == len(names)


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
