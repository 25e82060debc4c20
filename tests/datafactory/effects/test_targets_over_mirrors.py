"""Targets over mirrors, and walking ones, through evidence, plan and chain."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from prepared_scenes import prepared_scene

from datafactory.defaults import DEFAULT_BUDGET_DB
from datafactory.effects.catalogue import ALL, EffectSet
from datafactory.effects.plan import plan_of_frame
from datafactory.frame.chain import ChainSettings, SceneSource, make_frames
from datafactory.frame.deal import Deal, PreparedScene
from datafactory.paths.solver import TraceSettings
from datafactory.paths.table import SPECULAR, TARGET
from datafactory.scenes.poses import Pose
from shared.dataset import Frame
from shared.radar import Radar

pytestmark = pytest.mark.usefixtures("variant")

SHEET = """def Mesh "sheet" {{
    custom token radar:material = "metal"
    point3f[] points = [({near}, -3, 0), ({far}, -3, 0), ({far}, 3, 0), ({near}, 3, 0)]
    int[] faceVertexCounts = [4]
    int[] faceVertexIndices = [0, 1, 2, 3]
}}
"""
POST = """def Xform "post" {
    custom double radar:rcs_dbsm = 5
    double3 xformOp:translate = (30, 0, 0.7)
    uniform token[] xformOpOrder = ["xformOp:translate"]
}
"""
WALKER = """def Xform "walker" {
    custom string radar:target = "pedestrian"
    custom float radar:stature_m = 1.75
    custom double3 radar:velocity = (1.4, 0, 0)
    double3 xformOp:translate = (6, 0, 0)
    uniform token[] xformOpOrder = ["xformOp:translate"]
}
"""
POSE = Pose((0.0, 0.0, 0.5))


def scene(tmp_path: Path, *prims: str) -> PreparedScene:
    path = tmp_path / "scene.usda"
    path.write_text('#usda 1.0\n(\n metersPerUnit = 1\n upAxis = "Z"\n)\n' + "".join(prims), encoding="utf-8")
    return prepared_scene(path)


def planned(prepared: PreparedScene) -> set[str]:
    frame = Deal(seed=0, scenes=1, poses=(POSE,)).frame(0)
    settings = replace(ALL.settings(ChainSettings()), budget_db=DEFAULT_BUDGET_DB)
    return {name for name, on in plan_of_frame(frame, prepared, Radar(), settings).effects.items() if on}


def test_a_bounce_is_planned_where_there_is_one(tmp_path: Path) -> None:
    """The wave is reflected at 12.5 m: on the sheet that is there, beside the one that ends before."""
    below = planned(scene(tmp_path, POST, SHEET.format(near=9, far=20)))
    assert {"rcs_targets", "multi_bounce", "specular"} <= below
    before = planned(scene(tmp_path, POST, SHEET.format(near=2, far=11)))
    assert "rcs_targets" in before
    assert "multi_bounce" not in before


@pytest.mark.parametrize("missing", ["specular", "multi_bounce", "rcs_targets"])
def test_without_any_of_its_effects_there_is_no_bounce(tmp_path: Path, missing: str) -> None:
    prepared = scene(tmp_path, POST, SHEET.format(near=9, far=20))
    frame = Deal(seed=0, scenes=1, poses=(POSE,)).frame(0)

    def bounces(effects: EffectSet) -> int:
        settings = effects.settings(ChainSettings(trace=TraceSettings(rays=1000)))
        traced = SceneSource(frame, prepared, settings).traced(Radar())
        paths = traced.table.scattered
        return int((paths.kinds & (TARGET | SPECULAR) == TARGET | SPECULAR).sum())

    assert bounces(ALL) == 3
    assert bounces(ALL.without(missing)) == 0


def test_a_walker_is_the_same_for_one_seed_and_another_for_the_next(
    tmp_path: Path, small_radar: Callable[..., Radar]
) -> None:
    prepared, radar = scene(tmp_path, WALKER), small_radar(chirps=32, samples=128)
    settings = ALL.settings(ChainSettings(trace=TraceSettings(rays=1000)))

    def made(seed: int) -> tuple[Frame, dict[str, int]]:
        frame = Deal(seed=seed, scenes=1, poses=(POSE,)).frame(0)
        return next(make_frames([SceneSource(frame, prepared, settings)], radar))

    (first, counts), (again, _), (other, _) = made(1), made(1), made(2)
    assert counts["point_targets_hidden"] == 0
    assert first.range_channel.tobytes() == again.range_channel.tobytes()
    assert first.image.tobytes() == again.image.tobytes()
    assert not np.allclose(first.range_channel, other.range_channel)
    assert len([target for target in first.targets if target.object == "/walker"]) == 16
    rates = [target.velocity_mps for target in first.targets if target.object == "/walker"]
    assert max(rates) - min(rates) > 1.0
    # Other rays of the same frame see the same walker.
    frame = Deal(seed=1, scenes=1, poses=(POSE,)).frame(0)
    assert frame.target_seed() == replace(frame, realisation=3).target_seed()
