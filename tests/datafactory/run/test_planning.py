"""The plan of a run: from its own frames, and its evidence kept in the user's cache."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from prepared_scenes import a_sample

from datafactory.effects.plan import decide
from datafactory.frame.prepared import Sample
from datafactory.run import planning
from datafactory.run.order import Order
from datafactory.scenes.poses import Pose
from shared.radar import Radar

ORDER = Order(radar=Radar())


def test_evidence_is_measured_once_and_the_same_from_the_cache(variant: str, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(planning, "user_cache", lambda: tmp_path / "first")
    lines: list[str] = []
    sample = a_sample("target_80m")
    measured = planning.evidence_on(sample, ORDER, lines.append)

    def unexpected(*_: object) -> None:
        raise AssertionError("measured again")

    with monkeypatch.context() as patch:
        patch.setattr(planning, "gather", unexpected)
        kept = planning.evidence_on(sample, ORDER, lines.append)
        assert kept == measured
        assert decide("scene", kept) == decide("scene", measured)
        (frame,) = sample.frames
        changed_content = replace(sample.scene, content="other")
        for other in (
            Sample(sample.scene, (replace(frame, seed=1),)),
            Sample(sample.scene, (replace(frame, pose=Pose((0.0, 0.0, 0.6))),)),
            Sample(changed_content, (frame,)),
        ):
            with pytest.raises(AssertionError, match="measured again"):
                planning.evidence_on(other, ORDER, lines.append)
    monkeypatch.setattr(planning, "user_cache", lambda: tmp_path / "second")
    assert planning.evidence_on(sample, ORDER, lines.append) == measured
    assert lines == []


def test_damaged_evidence_is_measured_again(variant: str, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(planning, "user_cache", lambda: tmp_path)
    lines: list[str] = []
    measured = planning.evidence_on(a_sample("target_80m"), ORDER, lines.append)
    (file,) = (tmp_path / "effects").iterdir()
    file.write_text("{", encoding="utf-8")
    assert planning.evidence_on(a_sample("target_80m"), ORDER, lines.append) == measured
    assert len(lines) == 1
    assert file.name in lines[0]
