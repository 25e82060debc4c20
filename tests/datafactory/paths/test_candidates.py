"""Bounds before visibility: no echo exceeds its candidate's; chains by the image method, their lengths by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from prepared_scenes import EFFECT_SCENES, SCENES, prepared_scene
from sionna_scenes import MATERIALS, mesh

from datafactory.effects.catalogue import ALL
from datafactory.frame.chain import ChainSettings, SceneSource
from datafactory.frame.deal import Deal
from datafactory.paths.candidates import CHAIN, CORNER, EDGE, PANE, TARGET_MIRRORED, TARGET_SEEN, Candidates
from datafactory.paths.chains import chain_candidates
from datafactory.paths.corner_edges import corners_of
from datafactory.paths.merged_scene import merge_scene
from datafactory.paths.slabs import Slabs
from datafactory.paths.solver import TraceSettings
from datafactory.paths.table import REFRACTED, PathTable
from datafactory.paths.view import View
from datafactory.scenes.poses import Pose, read_poses
from datafactory.scenes.scene import Scene
from shared.physics.units import SPEED_OF_LIGHT
from shared.radar import Radar

EVERYTHING = ALL.settings(ChainSettings(trace=TraceSettings(rays=20_000)))
STREET = tuple(Pose((x, y, 0.6), yaw) for x, y, yaw in ((-30.0, -2.0, 0.0), (0.0, 2.0, 160.0), (15.0, -2.0, 75.0)))


def traced(path, *poses: Pose) -> list[PathTable]:
    scene, deal = prepared_scene(path), Deal(scenes=1, poses=poses)
    return [SceneSource(deal.frame(n), scene, EVERYTHING).traced(Radar()).table for n in range(len(deal))]


def scenes() -> list[tuple[str, list[PathTable]]]:
    found = [("street", traced(SCENES / "street.usda", *STREET)), ("tiny", traced(SCENES / "tiny.usda", *STREET[:1]))]
    for name in ("square_corner", "three_faces", "corner", "target_behind_pane", "reflector_behind_pane", "plate"):
        found.append(
            (name, traced(EFFECT_SCENES / f"{name}.usda", read_poses(EFFECT_SCENES / f"{name}.poses.json")[0]))
        )
    return found


@pytest.mark.usefixtures("variant")
def test_no_echo_exceeds_the_bound_of_its_candidate() -> None:
    """Edges, corners and targets by their own; what passed panes by the strongest pane."""
    met = dict.fromkeys((EDGE, CORNER, TARGET_SEEN, TARGET_MIRRORED), 0)
    beyond = 0
    for name, tables in scenes():
        for table in tables:
            candidates = table.candidates
            rows = table.scattered, table.specular
            candidate, kinds = (np.concatenate([getattr(part, of) for part in rows]) for of in ("candidate", "kinds"))
            power = np.concatenate([np.abs(part.amplitude) ** 2 for part in rows])
            passed = kinds & REFRACTED > 0
            own = (candidate >= 0) & ~passed
            total = np.bincount(candidate[own], power[own], len(candidates))
            for family in met:
                members = np.flatnonzero((candidates.family == family) & (total > 0.0))
                assert (total[members] <= candidates.power[members] * (1.0 + 1e-5)).all(), (name, family)
                met[family] += len(members)
            if passed.any():
                assert power[passed].max() <= candidates.power[candidates.family == PANE].max()
                beyond += int(passed.sum())
    assert all(met.values()), met
    assert beyond > 0


def two_walls(first: tuple[np.ndarray, np.ndarray], second: tuple[np.ndarray, np.ndarray]) -> Candidates:
    """The chains over two large triangles, each (a point of it, its normal)."""
    walls = []
    for name, (point, n) in zip("ab", (first, second), strict=True):
        one = np.cross(n, [0.0, 0.0, 1.0])
        corners = point + 20.0 * np.array([one, -0.5 * one + [0, 0, 1.0], -0.5 * one - [0, 0, 1.0]])
        walls.append(mesh(name, corners, [[0, 1, 2]], "metal"))
    of = merge_scene(Scene("two walls", tuple(walls)), MATERIALS)
    bare = replace(corners_of(merge_scene(Scene("none", ()), MATERIALS)), face_of_triangle=np.full(2, -1))
    slabs = Slabs(of.slabs, SPEED_OF_LIGHT / 0.004)
    view = View(None, of, slabs, Pose((0.0, 0.0, 0.0)), TraceSettings())
    return chain_candidates([np.array([[0, 1], [0, 1]])], view, bare)


X, Y = np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])


def test_a_chain_between_parallel_walls_is_as_long_as_its_legs() -> None:
    """10 m ahead, 15 m back to the wall behind, 5 m home: once, however often the sequence was met."""
    found = two_walls((10.0 * X, -X), (-5.0 * X, X))
    assert len(found) == 1
    assert found.family[0] == CHAIN
    assert found.range_m[0] == pytest.approx(15.0)
    assert found.power[0] == pytest.approx((0.004 / (4.0 * np.pi * 30.0)) ** 2, rel=1e-5)
    np.testing.assert_allclose(found.departure[0], 10.0 * X, atol=1e-5)
    np.testing.assert_allclose(found.arrival[0] / np.linalg.norm(found.arrival[0]), -X, atol=1e-5)


def test_walls_over_which_no_way_closes_have_no_chain() -> None:
    """A wall ahead and one beside it, behind the sensor's back: their images close only far outside both."""
    beside = np.array([200.0, 3.0, 0.0])
    assert len(two_walls((10.0 * X, -X), (beside, -Y))) == 0
