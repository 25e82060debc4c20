"""Cities on road networks: lanes as the analytic reference line has them, roads over the land, traffic in lanes."""

import math
import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from factory_command import refused, run
from oracles import reference_file
from road_networks import ARC_M, GRADE, LANE_M, LINE_M, OSM, OTHER_M, RADIUS_M, opendrive
from scene_solids import triangles_of

from datafactory.scenes.city.rules import Style
from datafactory.scenes.city.site import Placement
from datafactory.scenes.drives import LATERAL_MPS2
from datafactory.scenes.ground import CELL_M, free_ground, height_map
from datafactory.scenes.network import conversion, speed_limits
from datafactory.scenes.network.conversion import Network, read_network
from datafactory.scenes.network.town import town, write_town
from datafactory.scenes.poses import sample_pose
from datafactory.scenes.readers.open import open_scene
from shared.physics.errors import InputError

BEND_MPS = math.sqrt(LATERAL_MPS2 * RADIUS_M)
SPEED = 'max="30" unit="km/h"'

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


@pytest.mark.parametrize(
    ("speed", "mps"),
    [
        ('max="30" unit="km/h"', 30.0 / 3.6),
        ('max="20" unit="mph"', 8.9408),
        ('max="8.33" unit="m/s"', 8.33),
        ('max="8.33"', 8.33),
        ('max="no limit"', speed_limits.UNLIMITED_MPS),
        ('max="undefined"', speed_limits.USUAL_MPS),
        ('max="-1" unit="km/h"', speed_limits.USUAL_MPS),
        ('max="5" unit="knots"', speed_limits.USUAL_MPS),
    ],
)
def test_a_road_has_the_speed_limit_that_it_states(tmp_path: Path, speed: str, mps: float) -> None:
    path = tmp_path / "own.xodr"
    path.write_text(opendrive().replace(SPEED, speed).replace("<OpenDRIVE>", '<OpenDRIVE xmlns="x">'), encoding="utf-8")
    expected = [mps] * 6 if mps < BEND_MPS else [*[BEND_MPS] * 2, *[mps] * 6]  # the arc is a piece of its own
    assert sorted(read_network(path, "opendrive", tmp_path).speeds.values()) == pytest.approx(expected, abs=1e-4)


@pytest.mark.parametrize(
    ("shape", "curvature"),
    [
        ("<line/>", 0.0),
        ('<arc curvature="-0.1"/><userData code="x" value="y"/>', 0.1),
        ('<spiral curvStart="0.02" curvEnd="-0.1"/>', 0.1),
        ('<poly3 a="0" b="0" c="0.05" d="0"/>', 0.1),
        ('<paramPoly3 pRange="arcLength" aU="0" bU="1" cU="0" dU="0" aV="0" bV="0" cV="0.05" dV="0"/>', 0.1),
        ('<paramPoly3 pRange="normalized" aU="0" bU="8" cU="0" dU="0" aV="0" bV="0" cV="3.2" dV="0"/>', 0.1),
    ],
)
def test_the_least_radius_of_a_piece_is_known(shape: str, curvature: float) -> None:
    geometry = ElementTree.fromstring(f'<geometry s="0" length="8">{shape}</geometry>')
    assert speed_limits._curvature(geometry) == pytest.approx(curvature)


def test_speed_limits_change_along_a_road_and_a_lane_has_its_own(tmp_path: Path) -> None:
    """In each direction of each road; repeated, at the end of a road and beyond it a limit changes nothing."""
    more = "".join(f'<type s="{s}" type="town"><speed max="14"/></type>' for s in (40, 70))
    text = opendrive()
    for length in (LINE_M + ARC_M, OTHER_M):
        beyond = f'<type s="{length}" type="town"><speed max="99"/></type><type s="900" type="town"/>'
        text = re.sub(rf'(<road name="" length="{length}".*?</type>)', rf"\1{more}{beyond}", text)
    path = tmp_path / "own.xodr"
    path.write_text(text, encoding="utf-8")
    speeds = read_network(path, "opendrive", tmp_path).speeds
    assert speeds["1#0"] == speeds["-1#0"] == pytest.approx(30.0 / 3.6, abs=1e-4)
    assert speeds["1#1"] == 14.0
    assert speeds["1#2"] == pytest.approx(BEND_MPS, abs=1e-4)
    assert sorted(speeds.values()) == pytest.approx([30.0 / 3.6] * 6 + [BEND_MPS] * 2 + [14.0] * 6, abs=1e-4)
    path.write_text(text.replace("</lane>", '<speed sOffset="20" max="6"/></lane>'), encoding="utf-8")
    assert {round(speed, 2) for speed in read_network(path, "opendrive", tmp_path).speeds.values()} == {8.33, 6.0}


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


def test_kerbs_face_the_road_and_edges_the_land(built: tuple[list[Placement], int]) -> None:
    """Along outlines and along holes: what they face away from tells right angles that return from others."""
    surface = {item.path: item.surface for item in built[0] if item.path.startswith("Ground/")}
    road, pavement, edge = (surface[f"Ground/{name}"] for name in ("Road_0", "Pavement", "Edge"))
    assert road is not None
    assert pavement is not None
    assert edge is not None
    road_at, paved_at, sides = (item.vertices[triangles_of(item)] for item in (road, pavement, edge))
    upright = np.ptp(paved_at[:, :, 2], axis=1) > 0.1
    kerbs, flat = paved_at[upright], paved_at[~upright]
    assert len(kerbs) > 40
    assert share_over(kerbs, 0.2, road_at) > 0.9
    assert share_over(kerbs, -0.2, flat) > 0.8  # a road that ends has no pavement behind it
    assert share_over(sides, -0.2, np.concatenate([flat, road_at])) > 0.9
    assert share_over(sides, 0.2, np.concatenate([flat, road_at])) < 0.1


def share_over(faces: np.ndarray, metres: float, ground: np.ndarray) -> float:
    """Which share of upright faces [F, 3, 3] has ground [T, 3, 3] so far along their normals."""
    normal = np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0])
    places = faces.mean(axis=1) + metres * normal / np.linalg.norm(normal, axis=1, keepdims=True)
    return float(np.mean([np.isfinite(lowest_clearance(place[None], ground)) for place in places]))


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
            assert one.position[2] == pytest.approx(lanes[nearest, 2], abs=0.02)


def test_ways_over_junctions_begin_where_their_lanes_end(tmp_path: Path) -> None:
    """Traffic would jump aside. A way may be of two parts, one behind the other."""
    network = read_network(reference_file("opendrive", "Town07.xodr"), "opendrive", tmp_path)
    ends = np.array([lane.points[-1, :2] for lane in network.lanes])
    ways = [lane for lane in network.lanes if lane.junction]
    assert len(ways) > 200
    for way in ways:
        assert np.linalg.norm(ends - way.points[0, :2], axis=1).min() < 0.05


def test_no_vehicle_passes_through_what_stands_beside_the_road(tmp_path: Path) -> None:
    """Buses that cut corners did."""
    network = read_network(reference_file("opendrive", "Town07.xodr"), "opendrive", tmp_path)
    placements, moving = town(network, 5, Style.MOTORWAY, (-60.0, 60.0), 240.0, tmp_path)
    assert moving > 10
    still = {
        item.path: rotated(item.surface.vertices, math.radians(item.yaw_deg)) + item.position
        for item in placements
        if item.surface is not None and not item.keyframes and not item.path.startswith("Ground/")
    }
    assert len(still) > 50
    for item in placements:
        for key in item.keyframes[::3]:
            assert item.surface is not None
            size = item.surface.vertices
            turn = math.radians(-key.yaw_deg)
            for path, shape in still.items():
                if math.dist(shape[0, :2], key.position[:2]) < 20.0:
                    within = rotated(shape - key.position, turn)
                    inside = ((within > size.min(axis=0) + 0.02) & (within < size.max(axis=0) - 0.02)).all(axis=1)
                    assert not inside.any(), f"{item.path} at {key.time_s} s in {path}"


def rotated(points: np.ndarray, angle: float) -> np.ndarray:
    sine, cosine = math.sin(angle), math.cos(angle)
    return points @ np.array([(cosine, sine, 0.0), (-sine, cosine, 0.0), (0.0, 0.0, 1.0)])


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


@pytest.mark.parametrize("style", [Style.SUBURB, Style.INDUSTRIAL, Style.MOTORWAY])
def test_drawn_poses_stand_on_the_network_s_roads(folder: Path, style: Style) -> None:
    """Though the land around them lies lower by more than a step, and is larger."""
    path = folder / f"{style}.usdc"
    write_town(path, folder / "own.xodr", "opendrive", 1, style, extent=250.0)
    scene = open_scene(str(path))
    ground, seen = free_ground(scene), height_map(scene, CELL_M)
    (road,) = (number for number, item in enumerate(scene.objects) if "/Road_0/" in item.name)
    poses = [sample_pose(ground, "train", np.random.default_rng(seed)) for seed in range(20)]
    i, j = ground.cell_of(*np.array([pose.position[:2] for pose in poses]).T)
    assert np.mean(seen.owner[i, j] == road) > 0.6  # four of five
    assert ground.road[i, j].sum() == (seen.owner[i, j] == road).sum()


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
        (opendrive().replace('junction="100">', 'junction="100" rule="LHT">', 1), [], ("has rule LHT", "keeps right")),
    ],
)
def test_what_is_wrong_is_one_line(
    tmp_path: Path, text: str | None, options: list[str], words: tuple[str, ...]
) -> None:
    path, out = tmp_path / "network.xodr", tmp_path / "out.usda"
    if text is not None:
        path.write_text(text, encoding="utf-8")
    message = refused("city", "--opendrive", path, "--out", out, *options)
    assert all(word in message for word in words), message
    assert not out.exists()


def test_a_missing_package_is_one_line(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(__import__("sys").modules, "sumo", None)
    with pytest.raises(InputError, match=r"sumo is not installed.*\[opendrive\]"):
        write_town(tmp_path / "out.usda", tmp_path / "a.xodr", "opendrive")
