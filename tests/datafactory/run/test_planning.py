"""The plan of a run: from its own frames, and its evidence kept in the user's cache."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from prepared_scenes import SCENES, a_sample, prepared_scene

from datafactory.effects.plan import decide
from datafactory.frame.deal import Deal
from datafactory.frame.prepared import Sample
from datafactory.run import planning
from datafactory.run.order import Order
from datafactory.scenes.ground import free_ground
from datafactory.scenes.poses import Pose
from datafactory.scenes.readers.open import open_scene
from shared.radar import Radar

ORDER = Order(radar=Radar())


def test_evidence_is_measured_once_and_the_same_from_the_cache(variant: str, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(planning, "user_cache", lambda: tmp_path / "first")
    lines: list[str] = []
    sample = a_sample("target_80m")
    steps: list[tuple[int, int]] = []
    looking = planning.Looking(1, lambda *step: steps.append(step))
    measured = planning.evidence_on(sample, ORDER, lines.append, looking)
    assert steps == [(0, 1), (1, 1)]

    def unexpected(*_: object) -> None:
        raise AssertionError("measured again")

    with monkeypatch.context() as patch:
        patch.setattr(planning, "gather", unexpected)
        kept = planning.evidence_on(sample, ORDER, lines.append, looking)
        assert kept == measured
        assert decide("scene", kept.evidence) == decide("scene", measured.evidence)
        (frame,) = sample.frames
        changed_content = replace(sample.scene, content="other")
        for other in (
            Sample(sample.scene, (replace(frame, seed=1),)),
            Sample(sample.scene, (replace(frame, pose=Pose((0.0, 0.0, 0.6))),)),
            Sample(changed_content, (frame,)),
        ):
            with pytest.raises(AssertionError, match="measured again"):
                planning.evidence_on(other, ORDER, lines.append, looking)
    monkeypatch.setattr(planning, "user_cache", lambda: tmp_path / "second")
    assert planning.evidence_on(sample, ORDER, lines.append, looking) == measured
    assert lines == []


def test_damaged_evidence_is_measured_again(variant: str, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(planning, "user_cache", lambda: tmp_path)
    lines: list[str] = []
    looking = planning.Looking(1)
    measured = planning.evidence_on(a_sample("target_80m"), ORDER, lines.append, looking)
    (file,) = (tmp_path / "effects").iterdir()
    file.write_text("{", encoding="utf-8")
    assert planning.evidence_on(a_sample("target_80m"), ORDER, lines.append, looking) == measured
    assert len(lines) == 1
    assert file.name in lines[0]


def test_of_drawn_poses_the_first_is_looked_at_however_many_there_are() -> None:
    """So that a frame's effects do not depend on how many are rendered."""
    scene = prepared_scene(SCENES / "tiny.usda")
    ground = free_ground(open_scene(str(SCENES / "tiny.usda")))
    samples = [planning.sample_of(Deal(scenes=1, frames=count, grounds=(ground,)), 0, scene) for count in (1, 20)]
    assert [[frame.frame_id for frame in sample.frames] for sample in samples] == [[0], [0]]
    assert samples[0].frames == samples[1].frames
