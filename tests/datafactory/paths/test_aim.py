"""Aimed rays: more resolution cells of the ground hold enough of them, and the power they collect stays what it was."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from sionna_scenes import FREQUENCY_HZ, plate

from datafactory.paths.aim import STRIPS, UNAIMED, aimed
from datafactory.paths.arrivals import Arrivals
from datafactory.paths.geometry import Geometry
from datafactory.paths.merged_scene import merge_scene
from datafactory.paths.rays import RayFan
from datafactory.paths.slabs import Slabs
from datafactory.paths.solver import Bundle, TraceSettings
from datafactory.paths.thinning import RANGE_CELL_M, U_CELL
from datafactory.paths.view import View
from datafactory.scenes.materials.table import Material, MaterialMapping
from datafactory.scenes.poses import Pose
from datafactory.scenes.scene import Scene, SceneObject

pytestmark = pytest.mark.usefixtures("variant")

CONCRETE = Material("concrete", 5.24, 1.38, 0.1, 0.6, "lambertian", "test", (77.0, 78.0), ())
MATERIALS = MaterialMapping(entries={"concrete": (CONCRETE, "test")}, unknown=())
POSE = Pose((0.0, 0.0, 0.5))
GROUND = plate("ground", (40.0, 0.0, 0.0), (60.0, 0.0, 0.0), (0.0, 60.0, 0.0), "concrete")
WALL = plate("wall", (20.0, 0.0, 0.0), (0.0, 60.0, 0.0), (0.0, 0.0, 60.0), "concrete")
POLE = plate("pole", (17.0, 2.0, 1.0), (0.0, 0.1, 0.0), (0.0, 0.0, 0.9), "concrete")


def seen(*objects: SceneObject) -> View:
    merged = merge_scene(Scene("test", objects), MATERIALS)
    slabs = Slabs(merged.slabs, FREQUENCY_HZ)
    settings = TraceSettings(depth=1, paths_a_cell=0)
    return View(Geometry(merged).place(merged, POSE).mi_scene, merged, slabs, POSE, settings)


def echoes(view: View, fan: RayFan) -> Bundle:
    return Arrivals.first(view, fan).echoes().thinned(1)


def powers(bundle: Bundle, fan: RayFan) -> NDArray[np.float64]:
    return np.abs(bundle.amplitude) ** 2 * fan.solid_angle_ratio(bundle.vertices[:, 0])


def rays_a_cell(bundle: Bundle) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Middles [c] of the lit cells in range [m], and the rays [c] in each."""
    point = bundle.vertices[:, 0]
    distance = np.linalg.norm(point, axis=1)
    cells = np.stack([distance / RANGE_CELL_M, (point[:, 1] / distance + 1.0) / U_CELL]).astype(int)
    cells, counts = np.unique(cells, axis=1, return_counts=True)
    return (cells[0] + 0.5) * RANGE_CELL_M, counts


def test_more_cells_of_the_ground_hold_enough_rays():
    view, fan = seen(GROUND), RayFan(100_000, (0.3, 0.6))
    plain, sent = rays_a_cell(echoes(view, fan)), rays_a_cell(echoes(view, aimed(fan, view)))
    enough = [int(((counts >= 5) & (middles < 30.0)).sum()) for middles, counts in (plain, sent)]
    assert enough[1] > 2.0 * enough[0], enough


def test_a_wall_asks_for_no_rays():
    view = seen(WALL)
    strips = np.array(aimed(RayFan(100_000), view).strips)
    horizon = strips[STRIPS // 2 - 20 : STRIPS // 2 + 20]
    assert strips.mean() == pytest.approx(1.0)
    assert horizon.max() < 1.2


def test_some_rays_stay_everywhere_and_factors_have_a_mean_of_one():
    strips = np.array(aimed(RayFan(50_000), seen(GROUND, WALL)).strips)
    assert strips.mean() == pytest.approx(1.0)
    assert strips.min() >= UNAIMED


def test_nothing_in_sight_keeps_the_fan():
    behind = plate("behind", (-20.0, 0.0, 0.0), (0.0, 5.0, 0.0), (0.0, 0.0, 5.0), "concrete")
    np.testing.assert_allclose(aimed(RayFan(1_000), seen(behind)).strips, 1.0, rtol=1e-12)


def test_the_same_fan_for_the_same_scene_whatever_the_offset():
    view = seen(GROUND, POLE)
    first, second = aimed(RayFan(30_000), view), aimed(RayFan(30_000, (0.4, 0.2)), view)
    assert first.strips == second.strips
    assert second.offset == (0.4, 0.2)


def test_the_expected_power_of_ground_and_of_a_thin_pole_stays():
    """A sampling whose density followed what its own rays met would lose what is thin."""
    view, generator = seen(GROUND, POLE), np.random.default_rng(3)
    fans = [RayFan(4_000, tuple(generator.random(2))) for _ in range(60)]
    totals = np.zeros((2, len(fans), 2))
    for column, fan in enumerate(fans):
        for row, sent in enumerate((fan, aimed(fan, view))):
            bundle = echoes(view, sent)
            pole = bundle.objects[:, 0] == 1
            power = powers(bundle, sent)
            totals[row, column] = power[~pole].sum(), power[pole].sum()
    means, errors = totals.mean(axis=1), totals.std(axis=1) / np.sqrt(len(fans))
    assert (means > 0.0).all()
    np.testing.assert_array_less(np.abs(means[1] - means[0]), 4.0 * np.hypot(*errors))
    assert means[1] == pytest.approx(means[0], rel=0.1)
