"""The frames' decisions proven right on ``scenes/effects``: what is on was needed, and what is left out was not.

Of each scene the set is written down beforehand. Then every effect is toggled in that set, and the result is simulated
again: it changes by more than the frame's limit where the effect was on, and by less where it was off. What "changes"
means is said in ``expected.json`` (``rules``): the power in a resolution cell. This is for effects that add paths; how
echoes are formed is decided by formulas, which ``tests/datafactory/frame/test_changes.py`` holds against slow sums.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
from prepared_scenes import EFFECT_SCENES as EFFECTS
from prepared_scenes import prepared_scene

from datafactory.defaults import DEFAULT_BUDGET_DB
from datafactory.effects.catalogue import ALL, EffectSet
from datafactory.frame.chain import ChainSettings, SceneSource, illuminated
from datafactory.frame.deal import Deal, DealtFrame
from datafactory.frame.prepared import PreparedScene
from datafactory.paths.density import cell_power
from datafactory.paths.notice import Notice
from datafactory.paths.solver import TraceSettings
from datafactory.paths.table import DIFFUSE, SPECULAR, PathTable, ScatteredPaths
from datafactory.scenes.poses import Pose, read_poses
from shared.radar import Radar

pytestmark = pytest.mark.usefixtures("one_thread")

EXPECTED = json.loads((Path(__file__).parent / "expected.json").read_text(encoding="utf-8"))["scenes"]

RAYS = 200_000
EVERYTHING = ALL.settings(ChainSettings(trace=TraceSettings(rays=RAYS)))
WINDOW = "taylor-30"
"""Of the truth, by default."""


@dataclass(frozen=True, eq=False)
class Case:
    """One scene at its first pose."""

    scene: PreparedScene
    pose: Pose
    planned: EffectSet

    @property
    def frame(self) -> DealtFrame:
        """At this pose."""
        return Deal(scenes=1, poses=(self.pose,)).frame(0)

    def toggled(self, name: str) -> EffectSet:
        return self.planned.without(name) if getattr(self.planned, name) else self.planned.with_also(name)

    def paths(self, effects: EffectSet, realisation: int = 0) -> PathTable:
        """Illuminated paths with these effects; the same rays for the same ``realisation``."""
        settings = effects.settings(ChainSettings(trace=TraceSettings(rays=RAYS)))
        frame = self.frame.with_rays(realisation)
        return illuminated(SceneSource(frame, self.scene, settings).traced(Radar()), settings, Radar())


def first_pose(name: str) -> Pose:
    return read_poses(EFFECTS / f"{name}.poses.json")[0]


@lru_cache(maxsize=1)
def case(name: str) -> Case:
    planned = EffectSet.of(set(EXPECTED[name]["effects"]))
    return Case(prepared_scene(EFFECTS / f"{name}.usda"), first_pose(name), planned)


# Paths: power in a resolution cell of the truth


def power_changed(now: Case, name: str) -> float:
    """The largest power of a cell that toggling an effect changes [W].

    The rays and the draws of directions are the same, and what the effect does not touch cancels.
    """
    before, after = (cell_power(now.paths(effects), Radar(), WINDOW) for effects in (now.planned, now.toggled(name)))
    return float(np.abs(after - before).max())


def limit_w(now: Case) -> float:
    """What the frame may leave out of a cell [W]."""
    complete = SceneSource(now.frame, now.scene, EVERYTHING).traced(Radar())
    return Notice(Radar(), DEFAULT_BUDGET_DB).limit_w(complete.table)


@pytest.mark.parametrize("effect", ["multi_bounce", "refraction", "diffraction", "corners", "rcs_targets"])
@pytest.mark.parametrize("name", EXPECTED)
def test_an_effect_on_paths_is_on_where_its_change_exceeds_the_limit(name: str, effect: str) -> None:
    now = case(name)
    changed = power_changed(now, effect)
    assert getattr(now.planned, effect) == (changed > limit_w(now)), f"{changed:.2g} W, limit {limit_w(now):.2g} W"


@pytest.mark.parametrize(("effect", "kind"), [("specular", SPECULAR), ("diffuse", DIFFUSE)])
@pytest.mark.parametrize("name", EXPECTED)
def test_first_hits_and_single_mirrors_are_there_wherever_the_scene_has_them(name: str, effect: str, kind: int) -> None:
    now = case(name)
    paths = now.paths(now.planned)
    there = bool((np.concatenate([paths.scattered.kinds, paths.specular.kinds]) & kind).any())
    assert getattr(now.planned, effect) == there


def by_place(paths: ScatteredPaths) -> dict[tuple[float, ...], float]:
    """Power of purely diffuse single bounces by their point, in micrometres."""
    singles = paths.take((paths.kinds == DIFFUSE) & (paths.depth == 1))
    places = np.rint(singles.rx_point * 1e6)
    return {tuple(place): float(power) for place, power in zip(places, np.abs(singles.amplitude) ** 2, strict=True)}


@pytest.mark.parametrize("name", ["parked_car", "corner", "empty_field"])
def test_mirrors_leave_diffuse_power_as_it_is(name: str) -> None:
    """Every ray scatters where it arrives, with mirrors and without: the same paths, each of the same power."""
    now = case(name)
    rough = EffectSet.of({"diffuse"})
    alone, beside = (by_place(now.paths(effects).scattered) for effects in (rough, rough.with_also("specular")))
    assert beside
    assert beside.keys() == alone.keys()
    np.testing.assert_allclose([beside[place] / alone[place] for place in alone], 1.0, rtol=1e-4)
