"""Cities of all styles: the same bytes, no body in another; parts closed, facing outwards, of planar convex faces."""

import hashlib
import re
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
import trimesh
from factory_command import refused, run
from processes import python
from pxr import Sdf, Usd
from scene_solids import city_solids, triangles_of
from solids import intersecting

from datafactory.scenes.city import furniture
from datafactory.scenes.city.buildings import (
    DEPTHS,
    FRAME_RECESS,
    PANE_RECESS,
    SIDES,
    Building,
    Opening,
    bays,
    building,
)
from datafactory.scenes.city.city import VERSION, city, models, write_city
from datafactory.scenes.city.rules import RULES, Style
from datafactory.scenes.city.shapes import Surface
from datafactory.scenes.city.site import Placement
from datafactory.scenes.ground import free_ground
from datafactory.scenes.readers.open import open_scene

LARGEST = 150_000
CLASSES = {"car", "truck", "bus", "motorcycle", "bicycle", "pedestrian", "pole", "sign", "tree", "other"}
WRITTEN = {
    ("old-town", 3): "0125ce9859df7b1c00a1dbedf83f3e9737132e5ced39b62d77bcc1b3eecb0ef7",
    ("old-town", 8): "6ca517c3b0bbac19170a866d90eb96a5c5dac7e0e14488a0002dc540c58cf6ac",
    ("suburb", 3): "df06244462248a89162812499c2bf9c037a21e122d91658f9b7015c99d4db979",
    ("suburb", 8): "63b92e863e1fedce3f65eb8d996646fed61610d5482ed0b7a75033adc5314530",
    ("motorway", 3): "c28ed3bd4b5c789e884d82db3670656c48d6ffa4c56e71c23857b933e10edcc9",
    ("motorway", 8): "99f8d33dcdf8e137e5e65229c0d399ea5413e31d8759f6393ea5a90656045f99",
    ("industrial", 3): "6b18f59743da2c8f13f48048efbf5f645353e51fde1f2aca2fa06a058700f76f",
    ("industrial", 8): "614a70c9ad2c1e5356f14387a8da60fb16f65f0bdb68f91a1ccbb18b6249a858",
    ("car-park", 3): "c9543aedbe77b5244386007f460c36c631a3f5448aa5eec5634cc4e787821bee",
    ("car-park", 8): "001e5314d474e3fb59dcaac8b837c5db2074ddc979c1847e2be4f4e65dc9ff59",
}
"""SHA-256 of cities of one block, as text. A change of the generator changes these, and ``city.VERSION``."""


@pytest.mark.parametrize(("style", "seed"), WRITTEN)
def test_a_city_is_the_same_file_on_every_machine(tmp_path: Path, style: str, seed: int) -> None:
    """Byte for byte; numbers end at the millimetre, so that the last digit of a library's sine cannot show."""
    path = tmp_path / "city.usda"
    write_city(path, seed=seed, blocks=1, style=Style(style))
    content = path.read_bytes()
    assert hashlib.sha256(content).hexdigest() == WRITTEN[style, seed]
    assert not re.search(rb"\d\.\d{4}|\de[-+]?\d", content)


def test_hashes_of_every_style_are_written_here() -> None:
    assert {style for style, _ in WRITTEN} == {style.value for style in Style}


def test_the_same_seed_gives_the_same_binary_file(tmp_path: Path) -> None:
    files = [tmp_path / f"{name}.usdc" for name in ("first", "again")]
    for path in files:
        write_city(path, seed=4, blocks=1)
    assert files[0].read_bytes() == files[1].read_bytes()


@lru_cache
def placements_of(style: Style, seed: int) -> tuple[Placement, ...]:
    return city(seed=seed, style=style)


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2, 3))])
@pytest.mark.parametrize("style", list(Style))
def test_no_body_is_in_another(style: Style, seed: int) -> None:
    """By the meshes themselves."""
    placements = placements_of(style, seed)
    assert intersecting(city_solids(placements)) == []
    triangles = sum(len(triangles_of(item.surface)) for item in placements if item.surface is not None)
    assert 15_000 < triangles < LARGEST
    assert {item.radar_class for item in placements} - {""} <= CLASSES


def test_a_body_in_another_would_be_found() -> None:
    """A car in the middle of a house."""
    placements = placements_of(Style.OLD_TOWN, 0)
    car = next(item for item in placements if item.path.startswith("Cars/"))
    house = next(thing for thing in city_solids(placements) if thing.name.startswith("Houses/"))
    x, y, _ = (house.shape.corners.mean(axis=(0, 1)) @ house.turn.T + house.place).tolist()
    driven = [replace(item, position=(x, y, 0.5)) if item is car else item for item in placements]
    (pair,) = intersecting(city_solids(driven))
    assert set(pair[:2]) == {car.path, house.name}
    assert pair[2] > 0.1


def test_the_file_says_what_made_it_and_what_its_objects_are(tmp_path: Path) -> None:
    path = tmp_path / "city.usda"
    write_city(path, seed=2, blocks=1, style=Style.SUBURB)
    made = Sdf.Layer.FindOrOpen(str(path)).customLayerData["sparseradar:city"]
    assert dict(made) == {"style": "suburb", "seed": 2, "blocks": 1, "version": VERSION}
    stage = Usd.Stage.Open(str(path))
    for group, name in (("Cars", "car"), ("Trees", "tree"), ("Lamps", "pole")):
        prims = stage.GetPrimAtPath(f"/World/{group}").GetChildren()
        assert prims
        assert {prim.GetAttribute("radar:class").Get() for prim in prims} == {name} | (
            {"tree"} if group == "Trees" else set()
        )


def test_larger_cities_have_more_streets() -> None:
    for blocks in (1, 3):
        placements = city(seed=0, blocks=blocks, style=Style.SUBURB)
        roads = next(item.surface for item in placements if item.path == "Ground/Road_0")
        assert roads is not None
        spans = np.ptp(roads.vertices[:, 0])
        assert 60.0 * blocks < spans < 140.0 * blocks + 60.0


def test_drawn_poses_stand_on_the_motorway(tmp_path: Path) -> None:
    """Rails part it from the land, and bridges and gantries into pieces."""
    write_city(tmp_path / "city.usdc", seed=0, blocks=1, style=Style.MOTORWAY)
    ground = free_ground(open_scene(str(tmp_path / "city.usdc")))
    assert np.count_nonzero(ground.road) * ground.cell_m**2 > 2000.0
    assert (ground.street <= ground.road).all()


def test_the_command_writes_what_the_function_does_and_says_how_traffic_comes(tmp_path: Path) -> None:
    out = tmp_path / "new" / "folder" / "city.usda"
    asked = ("--seed", 3, "--blocks", 1, "--style", "suburb", "--out", out)
    assert "--populate" in run("city", *asked)
    assert hashlib.sha256(out.read_bytes()).hexdigest() == WRITTEN["suburb", 3]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--out", "city.obj"], ("city.obj", "'.obj'", ".usda")),
        (["--out", f"{__file__}/new/city.usda"], ("--out", f"{__file__} is a file")),
        (["--out", "missing/city.usda", "--opendrive", "gone.xodr"], ("; expected",)),
        (["--out", "x" * 300 + ".usda"], ("cannot be written",)),
        (["--centre", "1,2"], ("--centre and --extent without a network", "--opendrive FILE or --osm FILE")),
        (["--opendrive", "a.xodr", "--osm", "a.osm"], ("both given", "one of the two")),
        (["--opendrive", "a.xodr", "--blocks", "2"], ("--blocks", "--extent")),
        (["--opendrive", "a.xodr", "--centre", "here"], ("'here'", "two numbers")),
        (["--opendrive", "a.xodr", "--extent", "1"], ("--extent: 1;", "40 to 2000 m")),
    ],
)
def test_what_is_wrong_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, options: list[str], words: tuple[str, ...]
) -> None:
    monkeypatch.chdir(tmp_path)
    message = refused("city", "--out", "city.usda", *options)
    assert all(word in message for word in words), message
    assert not list(tmp_path.iterdir())


FULL = """
import resource, signal, sys
from pathlib import Path
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (5000, 5000))
from datafactory.scenes.city.city import write_city
from shared.physics.errors import InputError
try:
    write_city(Path(sys.argv[1]), 0, 1)
except InputError as error:
    print(error)
"""


@pytest.mark.parametrize("suffix", ["usda", "usdc"])
def test_a_disk_that_is_full_leaves_the_file_that_was_there(tmp_path: Path, suffix: str) -> None:
    """The limit on the size of files stands for the full disk."""
    path = tmp_path / f"city.{suffix}"
    path.write_text("before")
    said = python("-c", FULL, path)
    assert said.startswith(f"{path}: cannot be written (")
    assert len(said.splitlines()) == 1
    assert [entry.name for entry in tmp_path.iterdir()] == [path.name]
    assert path.read_text() == "before"


RNG = np.random.default_rng(3)


def as_mesh(surface: Surface) -> trimesh.Trimesh:
    return trimesh.Trimesh(surface.vertices, triangles_of(surface), process=False)


def house(shape: str, glazed: tuple[str, ...], **fields: object) -> Building:
    ground = ("door", "shop", "gate", "wall") if "front" in glazed else ()
    return Building(11.3, 9.7, 3, shape=shape, glazed=frozenset(glazed), ground=ground, **fields)  # type: ignore[arg-type]


PARTS = {
    **{f"house {shape} {len(glazed)}": building(house(shape, glazed, bands=True, cornice=True))
       for shape in ("flat", "gable", "hip") for glazed in (("front",), SIDES, (), ("front", "left"))},
    "house balconies": building(house("flat", ("front",), balconies=((1, 0), (2, 2)))),
    **models(RNG, RULES[Style.OLD_TOWN]), "tank": furniture.tank(3.0, 8.0),
}  # fmt: skip


@pytest.mark.parametrize("name", PARTS)
def test_every_body_of_a_part_is_closed_and_faces_outwards(name: str) -> None:
    mesh = as_mesh(PARTS[name])
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.area_faces.min() > 1e-6
    for body in mesh.split(repair=False):
        assert body.volume > 0


@pytest.mark.parametrize("name", PARTS)
def test_fans_are_right_because_every_face_is_planar_and_convex(name: str) -> None:
    surface = PARTS[name]
    for face in surface.faces:
        corners = surface.vertices[list(face)]
        edges = np.roll(corners, -1, axis=0) - corners
        turns = np.cross(np.roll(edges, 1, axis=0), edges)
        normal = turns.sum(axis=0) / np.linalg.norm(turns.sum(axis=0))
        assert np.all(turns @ normal > 0)
        # Vertices are kept to the millimetre, which bends a face by about as much.
        assert np.abs((corners - corners[0]) @ normal).max() < 2e-3


@pytest.mark.parametrize("shape", ["flat", "gable", "hip"])
def test_a_building_holds_its_walls_and_roof_less_its_recesses(shape: str) -> None:
    style = Building(12.0, 10.0, 2, shape=shape, glazed=frozenset({"front", "back"}), ground=("door",))
    opening, count = style.opening, style.bays
    assert count == bays(12.0, Opening()) == 4
    window = opening.width * (opening.head - opening.sill)
    pane = (opening.width - 0.14) * (opening.head - opening.sill - 0.14)
    recesses = (4 * count - 1) * (window * FRAME_RECESS + pane * PANE_RECESS)
    door = opening.width * (opening.head - style.base_m) * DEPTHS["door"]
    rise = 0.5 * style.depth * style.pitch
    roofs = {"flat": 0.0, "gable": 0.5 * style.depth * rise * style.width}
    # A hip roof: a prism between the ends of its ridge, and at each end a pyramid of half the depth.
    ridge = style.width - style.depth
    roofs["hip"] = 0.5 * style.depth * rise * ridge + style.depth * style.depth * rise / 3.0
    expected = style.width * style.depth * style.eaves + roofs[shape] - recesses - door
    assert as_mesh(building(style)).volume == pytest.approx(expected, abs=0.05)
