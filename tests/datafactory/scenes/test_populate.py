"""Populated scenes: what is asked for stands on the ground, clear of everything, and moves as it says."""

import json
from dataclasses import replace

import numpy as np
import pytest
from factory_command import run
from prepared_scenes import STREET
from scene_solids import Thing, things_of
from town_scenes import SLOPE, block, two_blocks

from datafactory.api.asking import load_scene, order_of
from datafactory.api.options import OrderOptions
from datafactory.frame.deal import Deal, dealt
from datafactory.frame.remarks import remarks
from datafactory.run.preparation import prepare
from datafactory.scenes.boxes import Movers
from datafactory.scenes.ground import free_ground, sensor_ground
from datafactory.scenes.materials.table import load_materials
from datafactory.scenes.motion import Track
from datafactory.scenes.poses import Pose
from datafactory.scenes.readers.open import open_scene
from datafactory.scenes.scene import PointTarget, Scene, SceneObject
from datafactory.scenes.things import Population, Strip
from datafactory.scenes.traffic.arrange import REACH_M, Asked, parse_populate
from datafactory.scenes.traffic.population import populated, recorded
from datafactory.scenes.traffic.stretches import HORIZON_S, Course, plane_under, spaced
from shared.physics.errors import InputError

ASKED = parse_populate("cars=6,trucks=2,buses=1,cyclists=4,pedestrians=12,poles=12,signs=6,bins=3,benches=2,parked=0.6")


@pytest.fixture(scope="module")
def street() -> Scene:
    return open_scene(str(STREET))


@pytest.fixture(scope="module")
def hill() -> Scene:
    return populated(two_blocks(), ASKED, 3)


def population_of(scene: Scene) -> Population:
    assert scene.population is not None
    return scene.population


def parts_of(scene: Scene, thing: Thing) -> list[SceneObject]:
    return [item for item in scene.objects if item.name.startswith(f"{thing.name}/")]


def test_the_scenes_own_traffic_has_its_way(street: Scene) -> None:
    """By the boxes of both along the world's axes, from above; a lamp's arm may reach over others."""
    scene = populated(street, ASKED, 0)
    every: tuple[SceneObject | PointTarget, ...] = (*street.objects, *street.targets)
    own = [item for item in every if item.moves]
    assert len(own) > 10
    put_in = [item for item in scene.objects if item.name.startswith("populate/")]
    walkers = [item for item in scene.targets if item.name.startswith("populate/")]
    assert len(put_in) > 40
    assert len(walkers) > 5
    for time_s in (0.0, 3.0, 8.0, 20.0):
        places = [item.at(time_s).vertices for item in put_in]
        places += [np.array([item.at(time_s).position]) for item in walkers]
        below = [points[points[:, 2] <= REACH_M, :2] for points in places]
        low, high = (np.array([f(points, axis=0) for points in below if len(points)]) for f in (np.min, np.max))
        for item in own:
            points = item.at(time_s).vertices if isinstance(item, SceneObject) else np.array([item.at(time_s).position])
            first, last = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
            assert ((high < first) | (low > last)).any(axis=1).all(), (item.name, time_s)


def test_vehicles_and_posts_stand_on_the_hill(hill: Scene) -> None:
    for thing in things_of(hill):
        for time_s in (0.0, 33.0):
            points = [item.at(time_s).vertices for item in parts_of(hill, thing)]
            if not points:
                place = thing.at(time_s)[0]
                assert place[2] == pytest.approx(SLOPE * place[0], abs=0.02), thing.name
                continue
            every = np.concatenate(points)
            above = every[:, 2] - SLOPE * every[:, 0]
            assert above.min() == pytest.approx(0.0, abs=0.03), thing.name
            if max(thing.size_m[:2]) > 3.0:  # all wheels do, not only the lowest
                lowest = above < 0.03
                assert np.ptp(every[lowest] @ thing.axes[0]) > 0.4 * thing.size_m[0], thing.name


def test_a_course_is_gone_along_again_and_again() -> None:
    course = Course((1.0, 2.0, 0.0), (0.6, 0.8, 0.0), 50.0, 10.0)
    track = course.track(20.0)
    for time_s in (0.0, 2.999, 3.001, 77.0, 599.9):
        shift, velocity = track.at(time_s)
        at = (20.0 + 10.0 * time_s) % 50.0
        np.testing.assert_allclose(shift, (at - 20.0) * np.array(course.ahead), atol=1e-9)
        np.testing.assert_allclose(velocity, [6.0, 8.0, 0.0])
    assert not track.at(HORIZON_S)[1].any()
    gaps = spaced(4, 60.0, 12.0, np.random.default_rng(0))
    assert np.diff([*gaps, gaps[0] + 60.0]).min() >= 12.0 - 1e-9


def test_what_was_asked_for_is_placed_and_said(hill: Scene) -> None:
    population, things = population_of(hill), things_of(hill)
    assert population.asked == ASKED.counts
    assert population.placed["cars"] == 6
    assert population.placed["parked"] > 10
    labels = [thing.label for thing in things]
    assert labels.count("bicycle") == population.placed["cyclists"]
    assert labels.count("pedestrian") == population.placed["pedestrians"]
    assert len(things) == sum(population.placed.values())
    assert "6 cars" in population.line()
    slots = 2 * sum(int((road.length_m - 13.0) / 6.2) for road in population.roads)
    assert population.placed["parked"] == pytest.approx(0.6 * slots, abs=2)


def test_what_does_not_fit_is_said() -> None:
    yard = Scene("yard", (block("ground", (-9.0, -9.0, -1.0), (9.0, 9.0, 0.0), 0.0),))
    scene = populated(yard, Asked({"cars": 5, "poles": 2}), 0)
    assert scene.objects == yard.objects
    assert "0 of 5 cars placed: there is no more room on its free ground" in scene.warnings
    assert population_of(scene).placed == {"cars": 0, "poles": 0}
    crowded = populated(two_blocks(), Asked({"trucks": 500}), 0)
    (line,) = crowded.warnings
    assert line.startswith(f"{population_of(crowded).placed['trucks']} of 500 trucks placed")


def test_a_density_asks_for_what_the_road_holds() -> None:
    """Numbers follow from the metres of road, and what has no room is nobody's disappointment."""
    dense = populated(two_blocks(), parse_populate("cars=4/100m,poles=3"), 0)
    population = population_of(dense)
    road_m = sum(road.length_m for road in population.roads)
    assert population.placed == {"cars": round(0.04 * road_m), "poles": 3}
    assert population.placed["cars"] > 0
    assert population.asked == {"poles": 3}
    assert population.text == "cars=4/100m,poles=3"
    crowded = populated(two_blocks(), parse_populate("trucks=100/100m"), 0)
    assert 0 < population_of(crowded).placed["trucks"] < sum(road.length_m for road in population_of(crowded).roads)
    assert crowded.warnings == ()


def test_same_seed_same_scene(hill: Scene) -> None:
    again = populated(two_blocks(), ASKED, 3)
    assert again.content_hash() == hill.content_hash()
    assert again.population == hill.population
    assert populated(two_blocks(), ASKED, 4).content_hash() != hill.content_hash()
    elsewhere = populated(two_blocks(0.03), ASKED, 3)  # the arrangement is the scene's own
    assert things_of(elsewhere)[0].at(0.0)[0].tolist() != things_of(hill)[0].at(0.0)[0].tolist()


def test_the_scene_of_a_manifest_is_populated_as_it_was(street: Scene) -> None:
    scene = populated(street, ASKED, 5)
    again = recorded({"population": population_of(scene).to_json()}, str(STREET))
    assert again.content_hash() == scene.content_hash()
    assert recorded({}, str(STREET)).content_hash() == street.content_hash()


def test_sensors_stand_on_the_populated_road(hill: Scene) -> None:
    ground, bare = sensor_ground(hill), free_ground(two_blocks())
    assert ground.road.any()
    assert not bare.road.any()
    things = things_of(hill)
    moving = [thing for thing in things if thing.moves and thing.label == "car"]
    cells = [ground.cell_of(*thing.at(0.0)[0][:2, None]) for thing in moving]
    assert any(ground.road[i, j].any() for i, j in cells)  # what drives is no obstacle of the map


def test_drawn_frames_are_of_times_at_which_the_scene_s_own_traffic_moves() -> None:
    bare = two_blocks()
    samples = Track((0.0, 24.0), ((0.0, 0.0, 0.0), (48.0, 0.0, 0.0)), ((2.0, 0.0, 0.0), (0.0, 0.0, 0.0)))
    driven = replace(block("driven", (-24.0, -7.0, 0.0), (-20.0, -5.0, 1.5), SLOPE), motion=samples).as_it_moves()
    scene = populated(replace(bare, objects=(*bare.objects, driven)), Asked({"cars": 2, "pedestrians": 2}), 0)
    assert scene.population is not None
    assert scene.population.placed["pedestrians"] == 2
    deal = dealt(order_of(OrderOptions(scene, radar="avr-qdm-110", frames=16, rays=100)), (scene,))
    times = [deal.frame(number).where.time_s for number in range(16)]
    assert len(set(times)) == 16
    assert 0.0 <= min(times) < 12.0 < max(times) < 24.0
    late = Deal(scenes=1, poses=(Pose((0.0, 0.0, 9.0), time_s=30.0),), traffic=(Movers(scene),))
    assert remarks(late) == ["two_blocks: 1 of 1 poses are not before 24 s, from when on what has samples rests"]


def test_drawn_frames_see_what_goes_straight_on_before_it_has_left_the_scene() -> None:
    """The blocks end 4 s ahead of the walker's middle. Of several, until half of them have left."""
    bare = two_blocks()
    ends_m = max(float(item.vertices[:, 0].max()) for item in bare.objects)
    walker = PointTarget("walker", (ends_m - 6.0, 0.0, 1.0), 0.0, velocity=(1.5, 0.0, 0.0))
    scene = populated(replace(bare, targets=(walker,)), Asked({"cars": 2}), 0)
    assert Movers(scene).populated_s == pytest.approx(4.0)
    deal = dealt(order_of(OrderOptions(scene, radar="avr-qdm-110", frames=16, rays=100)), (scene,))
    times = [deal.frame(number).where.time_s for number in range(16)]
    assert 0.0 <= min(times) < 2.0 < max(times) < 4.0
    more = (
        replace(walker, name="slower", velocity=(0.5, 0.0, 0.0)),
        replace(walker, name="back", velocity=(-9e9, 0.0, 0.0)),
    )
    assert Movers(replace(scene, targets=(walker, *more))).populated_s == pytest.approx(4.0)


def gardens(*beside: SceneObject) -> Scene:
    """A road 8 m wide along x over open land, with houses 20 m away, and what stands beside it."""
    land = block("land", (-70.0, -50.0, -1.0), (70.0, 50.0, -0.02), 0.0)
    road = block("/World/Road_0", (-70.0, -4.0, -1.0), (70.0, 4.0, 0.0), 0.0)
    houses = [block(f"house{y}", (-60.0, y, -1.0), (60.0, y + 8.0, 6.0), 0.0) for y in (-32.0, 24.0)]
    return Scene("gardens", (land, road, *houses, *beside))


def test_traffic_keeps_to_roads_that_are_named() -> None:
    for seed in range(3):
        scene = populated(gardens(), Asked({"cars": 6, "trucks": 1}), seed)
        assert population_of(scene).placed["cars"] == 6
        for thing in things_of(scene):
            assert abs(thing.at(0.0)[0][1]) + 0.5 * thing.size_m[1] < 4.0, thing.name


def test_a_street_between_trees_has_a_lane_under_their_crowns() -> None:
    """Trunks 0.6 m behind the kerbs leave no room for what a road has beside its lanes; crowns reach over it."""
    trees = []
    for n, x in enumerate(np.arange(-66.0, 67.0, 12.0)):
        for side in (-1.0, 1.0):
            y, reach = side * 4.6, (x - 2.5, x + 2.5)
            trees.append(block(f"trunk{n}{side}", (x - 0.1, y - 0.1, -1.0), (x + 0.1, y + 0.1, 4.2), 0.0))
            trees.append(block(f"crown{n}{side}", (reach[0], y - 2.5, 4.2), (reach[1], y + 2.5, 7.0), 0.0))
    scene = populated(gardens(*trees), Asked({"cars": 3, "poles": 4}), 0)
    assert population_of(scene).placed == {"cars": 3, "poles": 0}
    for thing in things_of(scene):
        assert abs(thing.at(0.0)[0][1]) + 0.5 * thing.size_m[1] < 2.1, thing.name
        assert min(item.vertices[:, 2].min() for item in parts_of(scene, thing)) == pytest.approx(0.0, abs=0.03)
    assert scene.warnings == ("0 of 4 poles placed: there is no more room on its free ground",)


def test_a_request_is_read_back_as_it_is_told() -> None:
    assert parse_populate(ASKED.text) == ASKED
    assert parse_populate(" cars = 3 , parked=0.25") == Asked({"cars": 3}, parked=0.25)
    dense = Asked({"poles": 2}, densities={"cars": 0.4})
    assert parse_populate(dense.text) == dense


def test_check_tells_what_was_put_in() -> None:
    told = json.loads(run("check", STREET, "--populate", "signs=4", "--json"))
    assert any("populated with 4 signs" in line for line in told["remarks"])
    with pytest.raises(InputError, match="--populate: given without a scene"):
        order_of(OrderOptions([], populate="cars=1"))


def test_a_scene_that_was_read_is_populated_and_not_read_in_another_way() -> None:
    (street,) = order_of(OrderOptions(load_scene(STREET), populate="signs=4")).scenes
    assert isinstance(street, Scene)
    assert street.content_hash() == load_scene(STREET, populate="signs=4").content_hash()
    with pytest.raises(InputError, match="has been read; expected --variant and --allow-missing of a file"):
        order_of(OrderOptions(street, variant=["lod=far"]))


def test_a_populated_scene_is_not_populated_again(hill: Scene) -> None:
    """Its things would have the names of the new ones, and two of one name have one box around them."""
    with pytest.raises(InputError, match=r"--populate: .* is populated, with cars=6.*; expected all of it at once"):
        order_of(OrderOptions(hill, populate="cars=1"))


def test_the_manifest_counts_what_was_put_in(hill: Scene) -> None:
    order = order_of(OrderOptions(hill, radar="avr-qdm-110", frames=1, rays=100, effects="diffuse"))
    said: list[str] = []
    recipe = prepare(order, load_materials(), said.append)
    population = population_of(hill)
    assert recipe.manifest["scenes"][0]["population"] == population.to_json()
    assert recipe.manifest["scenes"][0]["population"]["placed"] == population.placed
    assert any("populated with 6 cars" in line for line in said)
    moving = [thing.at(5.0)[0].tolist() for thing in things_of(hill) if thing.moves][:2]
    given = tuple(Pose((x, y, 0.5), time_s=5.0) for x, y, _ in moving)
    said.clear()
    prepare(
        order_of(OrderOptions(hill, radar="avr-qdm-110", poses=given, rays=100, effects="diffuse")),
        load_materials(),
        said.append,
    )
    assert "2 of 2 poses are within 3 m of what drives or walks by" in said


def test_rectangles_meet_where_no_side_of_either_separates_them() -> None:
    """Squares of side 2: side by side, corner to corner, and with one turned by 45 deg, whose corner reaches 1.41 m."""
    square = Strip((0.0, 0.0), 0.0, 2.0, 1.0)
    for other, apart_m in (
        (Strip((2.0, 0.0), 0.0, 2.0, 1.0), 0.0),
        (Strip((2.0, 2.0), 0.0, 2.0, 1.0), 0.0),
        (Strip((2.5, 0.0), np.pi / 4.0, 2.0, 1.0), 2.5 - 1.0 - np.sqrt(2.0)),
        (Strip((2.0, 2.0), np.pi / 4.0, 2.0, 1.0), 2.0 * np.sqrt(2.0) - 1.0 - np.sqrt(2.0)),
    ):
        assert square.overlaps(other, apart_m + 1e-9)
        assert other.overlaps(square, apart_m + 1e-9)
        assert not square.overlaps(other, apart_m - 1e-9)
        assert not other.overlaps(square, apart_m - 1e-9)


def test_a_plane_under_a_strip_is_that_of_least_squares() -> None:
    ground = free_ground(two_blocks())
    strip = Strip((20.0, 0.4), 0.3, 9.0, 1.7)
    along, left = (axis.ravel() for axis in np.meshgrid(np.linspace(-4.5, 4.5, 9), np.linspace(-1.7, 1.7, 5)))
    z = ground.heights_at(*strip.places(along, left))
    assert np.ptp(z) > 0.1
    reference = np.linalg.lstsq(np.stack([np.ones(45), along, left], axis=1), z, rcond=None)[0]
    found = plane_under(ground, strip, (9, 5), 0.5)
    assert found == pytest.approx(tuple(reference), abs=1e-12)
    off = np.abs(np.stack([np.ones(45), along, left], axis=1) @ reference - z).max()
    assert plane_under(ground, strip, (9, 5), 0.999 * off - 1e-12) is None
