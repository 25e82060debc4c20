"""What is too far away to be heard of targets, or behind too much, costs nothing and is counted."""

from __future__ import annotations

import numpy as np
import pytest
from sionna_scenes import MATERIALS, plate, view_of

from datafactory.paths.backend import select_variant
from datafactory.paths.merged_scene import MergedScene, merge_scene
from datafactory.paths.panes import FADED, panes_between
from datafactory.paths.solver import TraceSettings
from datafactory.paths.table import ScatteredPaths
from datafactory.paths.targets import FAINTEST, TargetEchoes
from datafactory.scenes.poses import Pose
from datafactory.scenes.scene import PointTarget, Scene, SceneObject
from datafactory.scenes.targets.road_users import Pedestrian

HOME = Pose((0.0, 0.0, 0.0))
DIRECT = TraceSettings(specular=False, diffraction=True)


def merged(*targets: PointTarget, objects: tuple[SceneObject, ...]) -> MergedScene:
    return merge_scene(Scene("test", objects, targets), MATERIALS)


def walker(name: str, x: float, y: float = 0.0) -> PointTarget:
    model = Pedestrian(1.75)
    return PointTarget(name, (x, y, -1.0), model.nominal_rcs_dbsm, (0.0, 1.4, 0.0), model)


def echoes_of(scene: MergedScene) -> tuple[ScatteredPaths, dict[str, int]]:
    view = view_of(scene, HOME, DIRECT)
    found, _, counts = TargetEchoes(view).seen(view.sight)
    return found, counts


def test_far_targets_are_left_out_and_counted() -> None:
    select_variant()
    behind = (plate("away", (-5.0, 0.0, 0.0), (0.0, 0.2, 0.0), (0.0, 0.0, 0.2), "metal"),)
    both = merged(walker("far", 700.0), walker("near", 30.0), objects=behind)
    alone = merged(walker("near", 30.0), objects=behind)
    found = []
    for scene in (both, alone):
        found.append(echoes_of(scene))
    (echoes, counts), (reference, counts_alone) = found
    assert (counts["targets_faint"], counts_alone["targets_faint"]) == (1, 0)
    assert {both.objects[index] for index in echoes.object_index} == {"near"}
    assert len(echoes) == len(reference) == 16
    # Another gait, for it has another number in the scene; the same cross section together, spread over a metre.
    for table in (echoes, reference):
        level = np.sum(np.abs(table.amplitude) ** 2 * table.range_m() ** 4)
        assert level == pytest.approx(np.sum(np.abs(reference.amplitude) ** 2 * reference.range_m() ** 4), rel=1e-6)


def test_what_hides_round_a_corner_is_not_looked_for_where_it_could_not_be_heard() -> None:
    select_variant()
    wall = (plate("wall", (10.0, 0.0, 0.0), (0.0, 4.0, 0.0), (0.0, 0.0, 4.0), "metal"),)
    for x, looked_for in ((40.0, True), (400.0, False)):  # in plain sight both would be heard
        scene = merged(walker("hidden", x), objects=wall)
        _, counts = echoes_of(scene)
        assert counts["targets_faint"] == 0
        assert counts["point_targets_hidden"] == 16
        assert ("targets_round_corners" in counts) == looked_for


def test_a_ray_ends_where_nothing_is_left_of_its_field() -> None:
    select_variant()
    walls = tuple(
        plate(f"wall{n}", (5.0 + n, 0.0, 0.0), (0.0, 4.0, 0.0), (0.0, 0.0, 4.0), "metal" if n == 1 else "glass")
        for n in range(4)
    )
    scene = merged(objects=walls)
    crossings = panes_between(view_of(scene, HOME), np.array([[5.5, 0.3, 0.0], [20.0, 0.3, 0.0]]))
    assert crossings.count.tolist() == [1, 2]  # the second ends at the metal
    assert abs(crossings.factor[0]) > 0.3
    assert abs(crossings.factor[1]) < FADED < FAINTEST
