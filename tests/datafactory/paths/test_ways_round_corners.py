"""Targets behind an edge: knife-edge loss, exact lengths, all ways round; what is too far to be heard costs nothing."""

from dataclasses import fields, replace
from functools import partial

import numpy as np
import pytest
from edge_scenes import HOME, only_edge_at, shortest_over
from numpy.typing import NDArray
from oracles import path_length
from sionna_scenes import (
    WAVELENGTH_M,
    every_one,
    everything,
    plate,
    scene_of,
    sionna_scene,
    slabs,
    view_of,
    view_with,
)
from town_scenes import box

from datafactory.paths import diffraction
from datafactory.paths.diffraction import EdgeRays, rays_over_edges
from datafactory.paths.echo_points import EchoPoints
from datafactory.paths.edges import edges_of
from datafactory.paths.feet import NEAREST_M
from datafactory.paths.geometry import clear_between
from datafactory.paths.merged_scene import MergedScene
from datafactory.paths.solver import TraceSettings
from datafactory.paths.table import DIFFRACTED, TARGET, ScatteredPaths
from datafactory.paths.targets import FAINTEST, TARGETS_AT_ONCE, TargetEchoes, echoes_round_corners
from datafactory.paths.view import FADED, panes_between
from datafactory.scenes.poses import Pose
from datafactory.scenes.scene import PointTarget
from datafactory.scenes.targets.bodies import Sphere
from datafactory.scenes.targets.models import Pedestrian

pytestmark = pytest.mark.usefixtures("variant")

CORNER = box("house", (5.0, 0.5, -40.0), (30.0, 40.0, 40.0), "metal")
HIDDEN = np.array([[9.0, -1.0, 0.4]])
OFF_AXIS = Pose((0.0, 4.0, 0.0))


def points(position, velocity, rcs_m2, first: int = 0) -> EchoPoints:
    """One of each target, numbered from ``first`` on; in the radar frame."""
    target, place = np.arange(first, first + len(position), dtype=np.int32), np.zeros(len(position), dtype=np.intp)
    return EchoPoints(position, velocity, rcs_m2, target, place, 0, 0)


def round_corner(
    of: MergedScene, target=HIDDEN, pose=OFF_AXIS, velocity=(0.0, 0.0, 0.0), rcs_m2=10.0, sight=None, **options
):
    """Echoes of one target given in the world; metres and m/s."""
    position = (np.atleast_2d(target) - np.array(pose.position)) @ pose.rotation()
    relative = (np.array([velocity]) - np.array(pose.velocity)) @ pose.rotation()
    count = len(position)
    hidden = points(position, np.repeat(relative, count, axis=0), np.full(count, rcs_m2), 7)
    return echoes_round_corners(
        view_with(slabs(of), sight or everything, edges=edges_of(of).seen_from(pose)), hidden, **options
    )


def test_a_target_behind_a_screen_has_twice_the_knife_edge_loss():
    """ITU-R P.526-15 eq. (31), within 0.5 dB for the way out and back; a metal half plane, 30 m and 20 m from it."""
    for nu in (0.5, 1.0, 2.4):
        height = nu / np.sqrt(2.0 / WAVELENGTH_M * (1.0 / 30.0 + 1.0 / 20.0))
        screen = scene_of(plate("s", (30.0, -20.0 + height, 0.0), (0.0, 20.0, 0.0), (0.0, 0.0, 200.0), "metal"))
        paths, counts = round_corner(screen, (50.0, 0.0, 0.0), HOME, edges_per_target=1)
        direct = WAVELENGTH_M * np.sqrt(10.0) / ((4.0 * np.pi) ** 1.5 * 50.0**2)
        loss_db = -20.0 * np.log10(np.abs(paths.amplitude) / direct)
        formula_db = 6.9 + 20.0 * np.log10(np.sqrt((nu - 0.1) ** 2 + 1.0) + nu - 0.1)
        assert loss_db[0] == pytest.approx(2.0 * formula_db, abs=0.5)
        assert (len(paths), counts["targets_round_corners"], paths.object_index[0]) == (1, 1, 7)
        assert paths.kinds[0] == DIFFRACTED | TARGET


@pytest.mark.parametrize(
    ("low", "on_edge", "target", "error_m"),
    [
        ((5.0, 0.5, -40.0), (5.0, 0.5, 0.0), (9.0, -1.0, 0.0), 1e-9),
        ((5.0, 0.5, -40.0), (5.0, 0.5, 0.0), (9.0, -1.0, 0.6), 2e-6),
        ((5.0, -40.0, 1.0), (5.0, 0.0, 1.0), (9.0, 1.5, -2.0), 1e-9),
    ],
    ids=["upright", "upright, the target higher", "level"],
)
def test_the_way_round_is_as_long_as_it_is_for_every_element(low, on_edge, target, error_m):
    """Elements up to 0.25 m from the centre. A level edge is exact for all targets, an upright one for level rays."""
    of = scene_of(box("house", low, (30.0, 40.0, 40.0), "metal"))
    edge = only_edge_at(edges_of(of), on_edge)
    position = np.array([target])
    hidden = points(position, np.zeros((1, 3)), np.ones(1))
    path, _ = echoes_round_corners(view_with(slabs(of), everything, edges=edge), hidden)
    for y_tx, y_rx in ((0.0, 0.0), (0.0, 0.25), (-0.005, -0.25)):
        tx, rx = np.array([0.0, y_tx, 0.0]), np.array([0.0, y_rx, 0.0])
        exact = shortest_over(edge, tx, position[0]) + shortest_over(edge, rx, position[0])
        assert path_length(path, tx, rx) == pytest.approx(exact, abs=error_m)


def test_the_delay_changes_as_radar_and_target_move():
    """The path table's rates against the shortest way a millisecond later; the edge point slides meanwhile."""
    step = 1e-3
    for radar, target in (((4.0, -2.0, 0.5), (1.0, -3.0, 0.0)), ((0.0, 0.0, 0.0), (0.0, 2.0, 5.0))):
        paths, _ = round_corner(
            scene_of(CORNER), pose=replace(OFF_AXIS, velocity=radar), velocity=target, edges_per_target=1
        )
        edge = only_edge_at(edges_of(scene_of(CORNER)), (5.0, 0.5, 0.0))
        later, first = (
            2.0
            * shortest_over(edge, np.array(OFF_AXIS.position) + np.array(radar) * t, HIDDEN[0] + np.array(target) * t)
            for t in (step, -step)
        )
        inward = paths.tx_point[0] / np.linalg.norm(paths.tx_point[0])
        rate = inward @ (paths.tx_velocity[0] + paths.rx_velocity[0]) + paths.between_rate_mps[0]
        assert rate == pytest.approx((later - first) / (2.0 * step), abs=1e-5)


def test_two_ways_round_make_four_paths_and_a_wall_leaves_one():
    pillar = plate("pillar", (8.0, -0.025, 0.0), (0.0, 0.275, 0.0), (0.0, 0.0, 40.0), "metal")
    wall = plate("wall", (12.0, 5.0, 0.0), (0.0, 4.9, 0.0), (0.0, 0.0, 40.0), "metal")
    target = (16.0, 0.0, 0.0)

    def found(*objects):
        of = scene_of(*objects)
        rims = edges_of(of)
        rims = rims.take((rims.start[:, 0] < 10.0) & (np.abs(rims.direction[:, 2]) > 0.5))  # the pillar's upright ones
        sight = partial(clear_between, sionna_scene(of).mi_scene)
        hidden = points(np.array([target]), np.zeros((1, 3)), np.ones(1))
        return echoes_round_corners(view_with(slabs(of), sight, edges=rims), hidden)

    both, counts = found(pillar)
    assert len(both) == 4
    # Out by one and back by the other, and the reverse: of the same amplitude and length.
    mixed = np.linalg.norm(both.tx_point - both.rx_point, axis=1) > 0.0
    assert mixed.sum() == 2
    np.testing.assert_allclose(both.amplitude[mixed][0], both.amplitude[mixed][1], rtol=1e-12)
    assert counts == {"targets_round_corners": 1, "targets_unreached": 0, "edges_round_corners_left_out": 0}
    one, _ = found(pillar, wall)
    assert len(one) == 1
    assert one.tx_point[0, 1] < 0.0


def test_the_strongest_edges_are_kept_and_the_rest_is_counted():
    of = scene_of(CORNER, plate("post", (6.0, -4.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 40.0), "glass"))
    everyone, all_counts = round_corner(of)
    few, counts = round_corner(of, edges_per_target=1)
    assert len(everyone) > 1
    assert len(few) == 1
    assert np.abs(few.amplitude[0]) == np.abs(everyone.amplitude).max()
    assert counts["edges_round_corners_left_out"] == all_counts["edges_round_corners_left_out"] + (
        int(np.sqrt(len(everyone))) - 1
    )


STREET = scene_of(
    box("house", (5.0, 0.5, -1.0), (30.0, 40.0, 9.0), "metal"),
    box("kiosk", (9.0, -4.0, -1.0), (11.0, -2.0, 2.0), "glass"),
    plate("sign", (6.0, -1.5, 1.5), (0.0, 0.4, 0.0), (0.0, 0.0, 0.4), "metal"),
)
EDGES = edges_of(STREET).seen_from(Pose((0.0, 2.0, 0.0), velocity=(3.0, 0.0, 0.0)))
COUNT = 2 * TARGETS_AT_ONCE + 5


def targets(generator: np.random.Generator) -> NDArray[np.float64]:
    """Behind the house's corner and around the kiosk, and some upon an edge and at its end."""
    position = generator.uniform((6.0, -8.0, -1.0), (25.0, 0.0, 2.0), (COUNT, 3))
    position[5], position[6] = EDGES.start[3], EDGES.start[3] + 0.5 * EDGES.direction[3]
    return position


def half_of_all(start: NDArray[np.float64], end: NDArray[np.float64]) -> NDArray[np.bool_]:
    """A sight that hides about half of what there is, the same for the same line."""
    return np.sin(1e3 * (start + 2.0 * end)).sum(axis=1) > 0.0


def echoes(position: NDArray[np.float64], first: int, polarization=("V", "V")) -> tuple[ScatteredPaths, dict[str, int]]:
    velocity = np.stack([position[:, 1], 0.1 * position[:, 0], 0.0 * position[:, 0]], axis=1)
    hidden = points(position, velocity, 0.1 + position[:, 0], first)
    return echoes_round_corners(
        view_with(slabs(STREET), half_of_all, TraceSettings(polarization=polarization), edges=EDGES), hidden
    )


def same_bytes(one: object, other: object) -> None:
    for item in fields(one):  # type: ignore[arg-type]
        if item.name not in ("geometry", "candidate"):  # a target's number is its place among those asked for
            np.testing.assert_array_equal(getattr(one, item.name), getattr(other, item.name), err_msg=item.name)


@pytest.mark.parametrize("polarization", [("V", "V"), ("V", "H")])
def test_all_targets_together_have_the_echoes_that_each_has_alone(generator, polarization) -> None:
    position = targets(generator)
    together, counts = echoes(position, 100, polarization)
    alone = [echoes(position[n : n + 1], 100 + n, polarization) for n in range(COUNT)]
    assert len(together) > COUNT
    same_bytes(together, ScatteredPaths.joined([paths for paths, _ in alone]))
    assert counts == {name: sum(one[name] for _, one in alone) for name in counts}
    assert 0 < counts["targets_unreached"] < COUNT


@pytest.mark.parametrize("source", [(0.0, 0.0, 0.0), (4.0, -2.0, 0.5)])
def test_the_first_look_at_edges_drops_none_that_has_a_ray(generator, monkeypatch, source) -> None:
    """Against all edges for all targets, which is what the first look saves."""
    position = targets(generator)
    fast = rays_over_edges(EDGES, np.array(source), position, WAVELENGTH_M)

    def every(start, direction, length, z_source, rho_source, observers, wavelength_m):
        return tuple(index.reshape(-1) for index in np.indices((len(observers), len(start))))

    looked_at = len(diffraction._worth_a_look(*first_look(np.array(source), position))[0])
    monkeypatch.setattr(diffraction, "_worth_a_look", every)
    with np.errstate(divide="ignore", invalid="ignore"):  # targets upon edges, which the first look leaves out
        slow = rays_over_edges(EDGES, np.array(source), position, WAVELENGTH_M)
    assert isinstance(slow, EdgeRays)
    same_bytes(fast, slow)
    same_bytes(fast.geometry, slow.geometry)
    assert 0 < len(fast) <= looked_at < 0.8 * len(EDGES) * COUNT


def first_look(source: NDArray[np.float64], position: NDArray[np.float64]):
    z, rho = diffraction._cylindrical(EDGES.start, EDGES.direction, source)
    length = np.linalg.norm(EDGES.end - EDGES.start, axis=1)
    return EDGES.start, EDGES.direction, length, z, rho, position, WAVELENGTH_M


DIRECT = TraceSettings(specular=False, diffraction=True)


def walker(name: str, x: float, y: float = 0.0) -> PointTarget:
    model = Pedestrian(1.75)
    return PointTarget(name, (x, y, -1.0), model.nominal_rcs_dbsm, (0.0, 1.4, 0.0), model)


def echoes_of(scene: MergedScene) -> tuple[ScatteredPaths, dict[str, int]]:
    view = view_of(scene, HOME, DIRECT)
    found, _, counts = every_one(TargetEchoes(view))
    return found, counts


def test_far_targets_are_left_out_and_counted() -> None:
    behind = (plate("away", (-5.0, 0.0, 0.0), (0.0, 0.2, 0.0), (0.0, 0.0, 0.2), "metal"),)
    both = scene_of(*behind, targets=[walker("far", 700.0), walker("near", 30.0)])
    alone = scene_of(*behind, targets=[walker("near", 30.0)])
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
        assert level == pytest.approx(
            np.sum(np.abs(reference.amplitude) ** 2 * reference.range_m() ** 4), rel=1e-6, abs=0.0
        )


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("distance_m", [0.0, 1e-80, 0.9 * NEAREST_M])
def test_what_stands_at_the_sensor_is_left_out_and_counted(distance_m: float) -> None:
    """Its bound would be infinite, and by it others would seem too faint to be noticed."""
    post = PointTarget("post", (10.0, 0.0, 0.0), 10.0)
    here = PointTarget("here", (distance_m, 0.0, 0.0), 10.0)
    ball = PointTarget("ball", (0.0, distance_m, 0.0), 0.0, model=Sphere(0.1))
    near = PointTarget("near", (1.1 * NEAREST_M, 0.0, 0.0), 10.0)
    wall = plate("wall", (0.0, 3.0, 0.0), (20.0, 0.0, 0.0), (0.0, 0.0, 4.0), "metal")
    scene = scene_of(wall, targets=[post, here, ball, near])
    source = TargetEchoes(view_of(scene, HOME, TraceSettings()))
    echoes, _, counts = every_one(source)
    assert {scene.objects[index] for index in echoes.object_index} == {"post", "near"}
    assert (counts["target_echoes_at_sensor"], counts["targets_faint"]) == (2, 0)
    assert np.isfinite(source.candidates.power).all()
    assert np.isfinite(echoes.amplitude).all()


def test_what_hides_round_a_corner_is_not_looked_for_where_it_could_not_be_heard() -> None:
    wall = (plate("wall", (10.0, 0.0, 0.0), (0.0, 4.0, 0.0), (0.0, 0.0, 4.0), "metal"),)
    for x, looked_for in ((40.0, True), (400.0, False)):  # in plain sight both would be heard
        scene = scene_of(*wall, targets=[walker("hidden", x)])
        _, counts = echoes_of(scene)
        assert counts["targets_faint"] == 0
        assert counts["point_targets_hidden"] == 16
        assert ("targets_round_corners" in counts) == looked_for


def test_a_ray_ends_where_nothing_is_left_of_its_field() -> None:
    walls = tuple(
        plate(f"wall{n}", (5.0 + n, 0.0, 0.0), (0.0, 4.0, 0.0), (0.0, 0.0, 4.0), "metal" if n == 1 else "glass")
        for n in range(4)
    )
    scene = scene_of(*walls)
    crossings = panes_between(view_of(scene, HOME), np.array([[5.5, 0.3, 0.0], [20.0, 0.3, 0.0]]))
    assert abs(crossings[0]) > 0.3
    assert abs(crossings[1]) < FADED < FAINTEST
