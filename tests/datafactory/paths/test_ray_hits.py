"""The ray fan and what it meets first; aimed rays; the geometry kept by a process, whatever was traced before."""

import pickle
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from path_tables import different_columns
from prepared_scenes import EFFECT_SCENES, prepared_scene
from sionna_scenes import mapping, material, plate, scene_of, sionna_scene, slabs, turning
from sionna_scenes import traced as trace_of
from town_scenes import box

from datafactory.paths import geometry as geometry_module
from datafactory.paths import trace as trace_module
from datafactory.paths.aim import STRIPS, UNAIMED, aimed
from datafactory.paths.arrivals import Arrivals
from datafactory.paths.cells import RANGE_CELL_M, U_CELL
from datafactory.paths.corners import corners_of, points_of
from datafactory.paths.curved_surfaces import curved_surfaces_of
from datafactory.paths.edges import edges_of
from datafactory.paths.geometry import Geometry, aligned_rows, first_hits, mesh_of_shape
from datafactory.paths.merged_scene import MergedScene
from datafactory.paths.rays import UNIFORM_IN_U, RayFan, _azimuth_at
from datafactory.paths.solver import Bundle, TraceSettings
from datafactory.paths.table import PathTable
from datafactory.paths.trace import find_shapes
from datafactory.paths.view import View, Waves
from datafactory.scenes.poses import Pose
from datafactory.scenes.scene import SceneObject

pytestmark = pytest.mark.usefixtures("variant")


TWO_WALLS = scene_of(
    plate("near", (5.0, 1.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), "metal"),
    plate("far", (9.0, 0.0, 0.0), (0.0, 3.0, 0.0), (0.0, 0.0, 3.0), "glass"),
)


def rays(count: int, generator: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    towards = np.stack([np.full(count, 9.0), *generator.uniform(-4.0, 4.0, (2, count))], axis=1)
    return np.zeros((count, 3)), towards / np.linalg.norm(towards, axis=1, keepdims=True)


@pytest.mark.parametrize("count", [1, 15, 16, 17, 40])
def test_rays_lie_where_dr_jit_s_vectors_do(generator, count):
    values = generator.normal(size=(count, 3)).T
    rows = aligned_rows(values)
    assert rows.dtype == np.float32
    np.testing.assert_array_equal(rows, values.astype(np.float32))
    assert all(row.ctypes.data % 64 == 0 and row.flags.c_contiguous for row in rows)


def test_the_first_of_two_walls_is_met_within_reach(generator):
    start, direction = rays(500, generator)
    reach = generator.uniform(4.0, 14.0, 500)
    geometry = sionna_scene(TWO_WALLS).mi_scene
    hits = first_hits(geometry, start, direction, reach)
    expected = np.full(500, np.inf)
    names = np.full(500, -1)
    for index, (x, y, half) in enumerate(((5.0, 1.0, 1.0), (9.0, 0.0, 3.0))):
        distance = x / direction[:, 0]
        at = distance[:, None] * direction
        met = (np.abs(at[:, 1] - y) < half) & (np.abs(at[:, 2]) < half) & (distance < np.minimum(reach, expected))
        expected[met], names[met] = distance[met], index
    np.testing.assert_array_equal(hits.valid, names >= 0)
    assert 0.1 < hits.valid.mean() < 0.9
    np.testing.assert_allclose(hits.distance[hits.valid], expected[hits.valid], rtol=1e-6)
    material = [part.material for part in TWO_WALLS.meshes]
    of_shape = mesh_of_shape(geometry)
    for number, name in enumerate(("metal", "glass")):
        here = hits.valid & (names == number)
        assert {material[of_shape[int(shape)]] for shape in hits.shape[here]} == {name}
    assert set(hits.primitive[hits.valid].tolist()) == {0, 1}
    without = first_hits(geometry, start, direction, reach, normals=False)
    for name in ("valid", "distance", "shape", "primitive"):
        np.testing.assert_array_equal(getattr(without, name)[hits.valid], getattr(hits, name)[hits.valid])
    np.testing.assert_allclose(np.abs(hits.normal[hits.valid, 0]), 1.0, atol=1e-6)


SHARES = (0.5, 0.25, 2.25, 1.5, 1.0, 0.5)
AIMED = RayFan(60_000, (0.37, 0.81), strips=SHARES)


def directions_of(fan: RayFan) -> NDArray[np.float64]:
    """[count, 3] by the map that Mitsuba documents: azimuth 2 pi a, z = 1 - 2 b."""
    a, b = fan.unit_square().T
    z = 1.0 - 2.0 * b
    rho = np.sqrt(1.0 - z**2)
    return np.stack([rho * np.cos(2.0 * np.pi * a), rho * np.sin(2.0 * np.pi * a), z], axis=1)


def test_mitsuba_maps_the_square_as_claimed():
    import mitsuba as mi

    fan = RayFan(5_000, (0.2, 0.7))
    a, b = fan.unit_square().T.astype(np.float32)
    mapped = mi.warp.square_to_uniform_sphere(mi.Point2f(a, b)).numpy().T
    np.testing.assert_allclose(mapped, directions_of(fan), atol=3e-6)


def test_azimuths_are_where_the_law_has_their_share():
    """By bisection of the law, 60 halvings of the half circle each."""
    share = np.concatenate([[0.0, 1.0, 1e-12, 0.5], np.random.default_rng(6).random(2000)])
    low, high = np.full(len(share), -0.5 * np.pi), np.full(len(share), 0.5 * np.pi)
    for _ in range(60):
        middle = 0.5 * (low + high)
        below = UNIFORM_IN_U * 0.5 * (np.sin(middle) + 1.0) + (1.0 - UNIFORM_IN_U) * (middle / np.pi + 0.5) < share
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    np.testing.assert_allclose(_azimuth_at(share), 0.5 * (low + high), atol=1e-14)


@pytest.mark.parametrize("fan", [RayFan(20_000, (0.37, 0.81), 0.05), RayFan(20_000, beam=0.2), AIMED], ids=str)
def test_solid_angles_fill_the_front_half_space(fan):
    directions = directions_of(fan)
    solid_angle = 4.0 * np.pi / fan.count * fan.solid_angle_ratio(directions)
    assert solid_angle.sum() == pytest.approx(2.0 * np.pi, rel=5e-3)
    # ... and any part of it: here the cap within 60 deg of boresight, 2 pi (1 - cos 60 deg).
    assert solid_angle[directions[:, 0] > 0.5].sum() == pytest.approx(np.pi, rel=2e-2)


def test_offsets_move_the_lattice_and_nothing_else():
    first, second = RayFan(1_000).unit_square(), RayFan(1_000, (0.5, 0.25)).unit_square()
    assert not np.allclose(first, second)
    np.testing.assert_allclose(first, RayFan(1_000, (1.0, 0.0)).unit_square(), atol=1e-12)
    assert first.tobytes() == RayFan(1_000).unit_square().tobytes()
    for square in (first, second):
        assert square.shape == (1_000, 2)
        assert square.min() >= 0.0
        assert square.max() <= 1.0


@pytest.mark.parametrize("strips", [(), SHARES])
def test_the_density_of_elevations_is_what_the_rays_show(strips):
    fan = RayFan(200_000, strips=strips)
    edges = np.linspace(-0.3, 0.3, 25)
    counts, _ = np.histogram(directions_of(fan)[:, 2], edges)
    fine = np.linspace(-0.3, 0.3, 24 * 20_000 + 1)
    middles = 0.5 * (fine[1:] + fine[:-1])
    expected = (fan.elevation_density(middles).reshape(24, 20_000)).mean(axis=1) * (edges[1] - edges[0])
    np.testing.assert_allclose(counts / 200_000, expected, atol=2e-5)


MATERIALS = mapping(material("concrete", 5.24, 1.38, 0.1, 0.6), material("metal", 1.0, 1e7, 0.1, 0.5))
POSE = Pose((0.0, 0.0, 0.5))
GROUND = plate("ground", (40.0, 0.0, 0.0), (60.0, 0.0, 0.0), (0.0, 60.0, 0.0), "concrete")
WALL = plate("wall", (20.0, 0.0, 0.0), (0.0, 60.0, 0.0), (0.0, 0.0, 60.0), "concrete")
POLE = plate("pole", (17.0, 2.0, 1.0), (0.0, 0.1, 0.0), (0.0, 0.0, 0.9), "concrete")


def seen(*objects: SceneObject) -> View:
    merged = scene_of(*objects, materials=MATERIALS)
    settings = TraceSettings(depth=1, paths_a_cell=0)
    return View(Geometry(merged).place(merged, POSE).mi_scene, merged, slabs(merged), POSE, settings)


def echoes(view: View, fan: RayFan) -> Bundle:
    return Arrivals.first(view, fan).echoes().thinned(1)


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
            pole = view.merged.owner[bundle.triangles[:, 0]] == 1
            power = np.abs(bundle.amplitude) ** 2 * sent.solid_angle_ratio(bundle.vertices[:, 0])
            totals[row, column] = power[~pole].sum(), power[pole].sum()
    means, errors = totals.mean(axis=1), totals.std(axis=1) / np.sqrt(len(fans))
    assert (means > 0.0).all()
    np.testing.assert_array_less(np.abs(means[1] - means[0]), 4.0 * np.hypot(*errors))
    assert means[1] == pytest.approx(means[0], rel=0.1, abs=0.0)


def test_a_short_leg_ends_on_its_plane() -> None:
    """2 cm, begun half a millimetre off the surface that the wave left: 1 % of the leg is less than that."""
    view = seen(WALL)
    waves = Waves.departing(np.array([[1.0, 0.0, 0.0], [0.6, 0.8, 0.0]]), np.ones((2, 3), dtype=np.complex128))
    start = np.array([[19.98, 0.1, 0.2], [19.988, 0.1, 0.2]])
    waves = replace(waves, start=start, lifted=start + np.array([5e-4, 0.0, 0.0]))
    index, hits = view.hit_by(waves)
    np.testing.assert_array_equal(index, [0, 1])
    np.testing.assert_allclose(hits.point[:, 0], 20.0, atol=1e-9)
    np.testing.assert_allclose(hits.distance, 0.02, atol=1e-9)


POSES = tuple(
    Pose((0.4 * n, 0.1 * n, 0.2), yaw_deg=5.0 * n, velocity=(2.0, 0.0, 0.0), time_s=0.1 * n) for n in range(3)
)


def scene() -> MergedScene:
    """What stands, what drives and what turns."""
    return scene_of(
        turning(box("car", (7.0, -2.0, -1.0), (9.0, 2.0, 1.0), "metal")),
        box("house", (20.0, -9.0, -1.0), (25.0, 9.0, 8.0), "concrete"),
        plate("ground", (15.0, 0.0, -1.5), (15.0, 0.0, 0.0), (0.0, 12.0, 0.0), "concrete"),
        materials=MATERIALS,
    )


def traced(merged: MergedScene, pose: Pose, **settings: Any) -> PathTable:
    every: dict[str, Any] = {"rays": 3_000, "depth": 2, "refraction": True, "diffraction": True, "corners": True}
    return trace_of(merged, pose, **{**every, **settings})


def same(one: PathTable, other: PathTable) -> None:
    assert min(len(one.scattered), len(one.specular)) > 0
    assert different_columns(one, other) == []
    assert one.counts == other.counts


def test_a_frame_is_the_same_first_or_third():
    merged = scene()
    kept = [traced(merged, pose) for pose in POSES]
    backwards = [traced(merged, pose) for pose in reversed(POSES)]
    for pose, one, other in zip(POSES, kept, reversed(backwards), strict=True):
        same(one, other)
        geometry_module._KEPT.clear()
        same(one, traced(merged, pose))


def test_one_scene_is_kept_and_another_is_another():
    geometry_module._KEPT.clear()
    merged = scene()
    one, other = (geometry_module.placed(merged.at(pose.time_s), pose) for pose in POSES[:2])
    assert one is other
    assert geometry_module.placed(scene().at(0.0), POSES[0]) is not one


def test_a_frame_without_chains_makes_no_scene_of_sionnas(monkeypatch):
    def never(*arguments):
        raise AssertionError("called")

    monkeypatch.setattr(trace_module, "radio_scene", never)
    assert len(traced(scene(), POSES[0], rays=1_000, depth=1).scattered) > 300


def test_shapes_are_named_by_their_meshes():
    merged = scene()
    geometry = Geometry(merged).place(merged, POSES[0])
    assert sorted(mesh_of_shape(geometry.mi_scene).values()) == list(range(len(merged.meshes)))
    empty = Geometry(MergedScene((), ())).place(MergedScene((), ()), POSES[0])
    assert mesh_of_shape(empty.mi_scene) == {}


def test_what_was_found_goes_along_and_is_the_same():
    scene = prepared_scene(EFFECT_SCENES / "three_faces.usda").merged
    find_shapes(scene, TraceSettings(corners=True, diffraction=True))
    copy = pickle.loads(pickle.dumps(scene))
    found = set(copy.found)
    pairs = [(find(copy), find(scene)) for find in (edges_of, corners_of, points_of, curved_surfaces_of)]
    assert set(copy.found) == found, "something was found again"
    assert min(len(points_of(scene)), len(corners_of(scene)), len(edges_of(scene))) > 0
    for own, other in pairs:
        for name, values in vars(other).items():
            assert np.array_equal(getattr(own, name), values), name


def test_another_time_of_a_scene_begins_with_nothing_found():
    scene = prepared_scene(EFFECT_SCENES / "moving_car.usda").merged
    find_shapes(scene, TraceSettings())
    assert scene.found
    assert scene.at(0.5).found == {}
