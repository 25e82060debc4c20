"""Road networks: lanes against the analytic line, roads over land; nothing drives or stands in anything else."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from factory_command import run
from prepared_scenes import SCENES
from road_networks import ARC_M, GRADE, LANE_M, LINE_M, OSM, OTHER_M, RADIUS_M, opendrive
from scene_solids import PopulationSolids, Thing, city_solids, triangles_of
from solids import Shape, Standing, containing, intersecting
from town_scenes import two_blocks

from datafactory.frame.deal import Deal
from datafactory.scenes.boxes import CLEAR_M, Movers
from datafactory.scenes.city.city import city
from datafactory.scenes.city.rules import Style
from datafactory.scenes.city.site import Placement
from datafactory.scenes.city.usd import write_usd
from datafactory.scenes.drives import Drives, draw_drive
from datafactory.scenes.ground import sensor_ground
from datafactory.scenes.network import conversion
from datafactory.scenes.network.conversion import Network, read_network
from datafactory.scenes.network.town import town, write_town
from datafactory.scenes.readers.open import open_scene
from datafactory.scenes.scene import Scene
from datafactory.scenes.things import Population
from datafactory.scenes.traffic.arrange import parse_populate
from datafactory.scenes.traffic.population import populated
from datafactory.scenes.traffic.stretches import HORIZON_S
from shared.physics.errors import InputError

pytest.importorskip("sumo", reason="SUMO is not installed: pip install 'sparseradar-datafactory[opendrive]'")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("network")
    (folder / "own.xodr").write_text(opendrive(), encoding="utf-8")
    (folder / "own.osm").write_text(OSM, encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def own(folder: Path) -> Network:
    return read_network(folder / "own.xodr", "opendrive", folder)


@pytest.fixture(scope="module")
def built(own: Network, folder: Path) -> tuple[list[Placement], int]:
    return town(own, 1, Style.SUBURB, own.centre(), 600.0, folder)


def from_reference_line(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(s, t) of road 1: along its reference line and to the left of it [m]."""
    x, y = points[:, 0], points[:, 1]
    angle = np.arctan2(x - LINE_M, RADIUS_M - y)
    on_arc = x > LINE_M
    s = np.where(on_arc, LINE_M + RADIUS_M * angle, x)
    t = np.where(on_arc, RADIUS_M - np.hypot(x - LINE_M, y - RADIUS_M), y)
    return s, t


def test_lanes_lie_beside_the_analytic_reference_line(own: Network) -> None:
    found = set()
    for lane in own.lanes:
        s, t = from_reference_line(lane.points)
        if lane.junction or (lane.points[:, 0] < -1.0).any():
            continue
        rising = bool(s[-1] > s[0])
        found.add(rising)
        assert t == pytest.approx(np.full(len(t), -0.5 * LANE_M if rising else 0.5 * LANE_M), abs=0.02)
        assert lane.points[:, 2] == pytest.approx(GRADE * s, abs=0.02)
        assert lane.width == pytest.approx(LANE_M)
        assert s.max() == pytest.approx(LINE_M + ARC_M, abs=0.05)
        assert len(lane.points) > 20
    assert found == {True, False}


def test_roads_are_as_large_as_their_lanes_and_lie_above_the_land(built: tuple[list[Placement], int]) -> None:
    ground = {item.path: item.surface for item in built[0] if item.path.startswith("Ground/")}
    road, land = ground["Ground/Road_0"], ground["Ground/Land"]
    assert road is not None
    assert land is not None
    corners = road.vertices[triangles_of(road)]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (normal[:, 2] > 0.0).all()
    # Road 1, 2 and 3 with both lanes, and a junction of 20 m by about 14.
    area = 0.5 * normal[:, 2].sum()
    lanes = 2.0 * LANE_M * (LINE_M + ARC_M + 2.0 * OTHER_M)
    assert lanes + 100.0 < area < lanes + 350.0
    assert lowest_clearance(corners.mean(axis=1), land.vertices[triangles_of(land)]) > 0.05


def lowest_clearance(points: np.ndarray, triangles: np.ndarray) -> float:
    """How far [m] the lowest of points [n, 3] lies above a surface of triangles [T, 3, 3], straight down."""
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    least = math.inf
    for x, y, z in points:
        area = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (c[:, 0] - a[:, 0]) * (b[:, 1] - a[:, 1])
        u = ((x - a[:, 0]) * (c[:, 1] - a[:, 1]) - (c[:, 0] - a[:, 0]) * (y - a[:, 1])) / area
        v = ((b[:, 0] - a[:, 0]) * (y - a[:, 1]) - (x - a[:, 0]) * (b[:, 1] - a[:, 1])) / area
        inside = (u >= -1e-9) & (v >= -1e-9) & (u + v <= 1.0 + 1e-9)
        below = a[:, 2] + u * (b[:, 2] - a[:, 2]) + v * (c[:, 2] - a[:, 2])
        least = min(least, float((z - below[inside]).min(initial=math.inf)))
    return least


def test_vehicles_drive_on_lanes_the_way_they_face(own: Network, built: tuple[list[Placement], int]) -> None:
    placements, count = built
    moving = [item for item in placements if item.keyframes]
    assert len(moving) == count > 0
    lanes = np.concatenate([conversion.along(lane.points, 0.25)[0] for lane in own.lanes])
    middle = own.centre()
    for item in moving:
        assert item.radar_class in ("car", "truck", "bus")
        for one, two in zip(item.keyframes[:-1], item.keyframes[1:], strict=True):
            step = np.subtract(two.position[:2], one.position[:2])
            yaw = math.radians(0.5 * (one.yaw_deg + two.yaw_deg))
            if np.linalg.norm(step) > 1.0 and abs(one.yaw_deg - two.yaw_deg) < 5.0:
                assert step @ (math.cos(yaw), math.sin(yaw)) > 0.95 * np.linalg.norm(step)
            place = np.add(one.position[:2], middle)
            nearest = np.argmin(np.linalg.norm(lanes[:, :2] - place, axis=1))
            assert np.linalg.norm(lanes[nearest, :2] - place) < 1.5
            assert one.position[2] == pytest.approx(lanes[nearest, 2], abs=0.1)


@pytest.mark.parametrize("style", [Style.OLD_TOWN, Style.SUBURB, Style.INDUSTRIAL, Style.MOTORWAY])
def test_nothing_stands_on_a_road(own: Network, folder: Path, style: Style) -> None:
    import shapely

    placements, _ = town(own, 2, style, own.centre(), 600.0, folder)
    middle = np.array(own.centre())
    asphalt = shapely.union_all(
        [shapely.LineString(lane.points[:, :2]).buffer(0.45 * lane.width) for lane in own.lanes]
    )
    shapely.prepare(asphalt)
    standing = [item for item in placements if not item.keyframes and not item.path.startswith("Ground/")]
    assert len(standing) > 10
    assert any(item.path.startswith("Houses/") for item in standing) == (style is not Style.MOTORWAY)
    for item in standing:
        assert item.surface is not None
        yaw = math.radians(item.yaw_deg)
        turn = np.array([(math.cos(yaw), -math.sin(yaw)), (math.sin(yaw), math.cos(yaw))])
        low = item.surface.vertices[item.surface.vertices[:, 2] < 2.0, :2] @ turn.T + item.position[:2] + middle
        assert not asphalt.contains(shapely.points(low)).any(), item.path


def test_the_same_network_and_seed_give_the_same_file(folder: Path) -> None:
    files = [folder / f"{name}.usda" for name in ("one", "two", "other")]
    for path, seed in zip(files, (1, 1, 2), strict=True):
        write_town(path, folder / "own.xodr", "opendrive", seed, Style.INDUSTRIAL, extent=250.0)
    one, two, other = (path.read_bytes() for path in files)
    assert one == two
    assert one != other
    scene = open_scene(str(files[0]))
    assert scene.triangle_count > 1000
    assert any(item.moves for item in scene.objects)


def test_openstreetmap_goes_the_same_way(folder: Path) -> None:
    out = folder / "osm.usda"
    run("city", "--osm", folder / "own.osm", "--extent", 260, "--out", out)
    lower, upper = open_scene(str(out)).bounds()
    assert (upper - lower)[:2].max() > 250.0


@pytest.mark.parametrize(
    ("text", "options", "words"),
    [
        ("no XML", [], ("netconvert: Error", "an OpenDRIVE file")),
        ("<OpenDRIVE><header/></OpenDRIVE>", [], ("netconvert: Error", "with roads")),
        (None, [], ("no such file",)),
        (opendrive(), ["--centre", "5000,0"], ("no road within", "--centre")),
    ],
)
def test_what_is_wrong_is_one_line(
    tmp_path: Path, text: str | None, options: list[str], words: tuple[str, ...]
) -> None:
    path, out = tmp_path / "network.xodr", tmp_path / "out.usda"
    if text is not None:
        path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as caught:
        run("city", "--opendrive", path, "--out", out, *options)
    message = str(caught.value)
    assert "\n" not in message
    assert all(word in message for word in words), message
    assert not out.exists()


def test_a_missing_package_is_one_line(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(__import__("sys").modules, "sumo", None)
    with pytest.raises(InputError, match=r"sumo is not installed.*\[opendrive\]"):
        write_town(tmp_path / "out.usda", tmp_path / "a.xodr", "opendrive")


ASKED = parse_populate("cars=8,trucks=2,buses=1,cyclists=4,pedestrians=12,poles=12,signs=6,bins=3,benches=2,parked=0.6")
EVERYWHERE = {"poles": 12, "pedestrians": 12, "cyclists": 4}
"""Of these, what a city of any style has room for: all."""
DRIVE_S = np.arange(0.0, 12.0, 0.5)
"""Times of a long drive. Everything of one stream has one speed."""
WHOLE_S = np.linspace(0.0, HORIZON_S - 0.01, 61)
LATER_S = (60.0, 133.3, 377.7, 599.0)
VEHICLES = ("car", "truck", "bus")
CANYON = "sionna:simple_street_canyon"
SLOW = [style for style in Style if style is not Style.OLD_TOWN]
"""All styles are populated alike: what one shows, the others seldom break."""
SEEDS = range(2)
TWO_SECONDS = Drives(seconds=2.0, rate_hz=5.0)
ASIDE_M = 3.5
"""From the middle of a road of two lanes to the outer end of either."""
NARROWEST_KERB_M = 2.4
OPEN_M = 1.0
"""So far the boresight is open: further than anything that would blind the radar."""


@dataclass(frozen=True, eq=False)
class Populated:
    """A populated scene, the solids of what was put into it, and those of what stood there before."""

    scene: Scene
    population: Population
    solids: PopulationSolids
    walls: list[Standing]

    @staticmethod
    def of(bare: Scene, walls: list[Standing], seed: int) -> Populated:
        scene = populated(bare, ASKED, seed)
        assert scene.population is not None
        return Populated(scene, scene.population, PopulationSolids(scene), walls)

    @property
    def moving(self) -> list[Thing]:
        return [thing for thing in self.solids.things if thing.moves]

    def standing(self, time_s: float) -> list[Standing]:
        return [*self.walls, *self.solids.at(time_s)]


def street_solids(street: Scene) -> list[Standing]:
    """What stands still on the shipped street; test_populate.py says that its own traffic has its way."""
    parts: dict[str, list[tuple[np.ndarray, np.ndarray]]] = {}
    for item in street.objects:
        if not item.moves and not item.name.startswith("/World/Ground/"):
            parts.setdefault(item.name.partition("/Geometry")[0], []).append((item.vertices, item.triangles))
    return [Standing(name, Shape.around(meshes)) for name, meshes in parts.items()]


def bare_scene(which: str, folder: Path) -> tuple[Scene, list[Standing]]:
    """A scene without traffic, and the solids in it: of a city the parked cars too."""
    if which == "street":
        bare = open_scene(str(SCENES / "street.usda"))
        return bare, street_solids(bare)
    if which in ("hill", CANYON):
        bare = two_blocks() if which == "hill" else open_scene(which)
        houses = [item for item in bare.objects if item.name not in ("ground", "mesh-floor")]
        return bare, [Standing(item.name, Shape.around([(item.vertices, item.triangles)])) for item in houses]
    standing = city(seed=0, blocks=2, style=Style(which))
    write_usd(folder / "city.usdc", standing, "what stands")
    return open_scene(str(folder / "city.usdc")), city_solids(standing)


@pytest.mark.parametrize(
    "which",
    ["hill", "street", CANYON, Style.OLD_TOWN, *(pytest.param(style, marks=pytest.mark.slow) for style in SLOW)],
)
def test_populated_scenes_are_sound_at_all_times(which: str, tmp_path: Path) -> None:
    bare, walls = bare_scene(which, tmp_path)
    for seed in SEEDS:
        item = Populated.of(bare, walls, seed)
        assert len(item.solids.things) > 30
        if which in list(Style):  # every style has room
            placed = item.population.placed
            assert placed["cars"] + placed["trucks"] >= 2
            assert {kind: placed[kind] for kind in EVERYWHERE} == EVERYWHERE
        nothing_is_in_anything_else(item)
        sensors_are_within_nothing(item)
        lanes_are_kept(item)
        assert nobody_catches_up_with_anybody(item) > 0


def nothing_is_in_anything_else(item: Populated) -> None:
    assert intersecting(item.standing(0.0)) == []
    for time_s in (*DRIVE_S, *LATER_S):
        assert intersecting(item.standing(time_s), moving_only=True) == [], (item.population.seed, time_s)


def sensors_are_within_nothing(item: Populated) -> None:
    """Poses drawn with a time each, and a drive of ten poses, against everything as it stands at that time."""
    ground = sensor_ground(item.scene)
    deal = Deal(seed=3, scenes=1, frames=16, grounds=(ground,), traffic=(Movers(item.scene),))
    drawn = [deal.frame(number).where for number in range(16)]
    assert len({pose.time_s for pose in drawn}) == 16
    assert all(0.0 <= pose.time_s < HORIZON_S for pose in drawn)
    assert Movers(item.scene).clear_of(drawn, CLEAR_M)
    drive = draw_drive(ground, Movers(item.scene), "train", TWO_SECONDS, np.random.default_rng(4))
    assert len(drive) == 10
    for pose in (*drawn, *drive):
        standing, ahead = item.standing(pose.time_s), pose.rotation()[:, 0]
        for metres in np.linspace(0.0, OPEN_M, 5):
            assert containing(standing, np.asarray(pose.position) + metres * ahead) == [], pose


def of_its_road(population: Population, thing: Thing, time_s: float) -> tuple[float, float, float]:
    """How far to the left of its road's middle a thing is [m], and its velocity along the road and to its left."""
    place, velocity = thing.at(time_s)
    (road,) = [road for road in population.roads if road.holds(place[0], place[1])]
    _, left = road.coordinates(place[0], place[1])
    cosine, sine = np.cos(road.heading_rad), np.sin(road.heading_rad)
    return float(left), cosine * velocity[0] + sine * velocity[1], cosine * velocity[1] - sine * velocity[0]


def lanes_are_kept(item: Populated) -> None:
    """Who moves stays on its own line across the road, all of it on its own side, with one speed, straight ahead."""
    for thing in item.moving:
        left, ahead, aside = np.transpose([of_its_road(item.population, thing, time_s) for time_s in WHOLE_S])
        assert np.ptp(left) < 0.01, thing.name
        assert np.ptp(ahead) < 1e-6, thing.name
        assert np.abs(aside).max() < 1e-6, thing.name
        speed = thing.at(12.0)[1]
        assert thing.axes[0] @ speed == pytest.approx(np.linalg.norm(speed), rel=1e-6)  # it looks where it goes
        near, far = abs(left[0]) - 0.5 * thing.size_m[1], abs(left[0]) + 0.5 * thing.size_m[1]
        if thing.label == "pedestrian":
            assert near > NARROWEST_KERB_M, thing.name
            continue
        if abs(left[0]) > 0.1:  # else the road has one lane, in its middle
            assert near > 0.0, thing.name
            assert left[0] * ahead[0] < 0.0 or thing.label == "bicycle", thing.name
        if thing.label in VEHICLES:
            assert far < ASIDE_M, thing.name
            assert 8.0 <= abs(ahead[0]) <= 14.0, thing.name


def nobody_catches_up_with_anybody(item: Populated) -> int:
    """Who shares a line keeps its distance, round the line's end too; how many lines are shared."""
    lines: dict[tuple[int, float], list[Thing]] = {}
    for thing in item.moving:
        x, y = thing.at(0.0)[0][:2, None]
        (number,) = [n for n, road in enumerate(item.population.roads) if road.holds(x, y)]
        left = float(item.population.roads[number].coordinates(x, y)[1][0])
        lines.setdefault((number, round(left, 1)), []).append(thing)
    shared = [line for line in lines.values() if len(line) > 1]
    for line in shared:
        longest = max(thing.size_m[0] for thing in line)
        for time_s in WHOLE_S:
            places = np.array([thing.at(time_s)[0] for thing in line])
            apart = np.linalg.norm(places[:, None] - places[None], axis=-1)[np.triu_indices(len(line), 1)]
            assert apart.min() > longest, (line[0].name, time_s)
    return len(shared)
