"""Cities of all styles: the same bytes, nothing in anything else, sizes, metadata, and one line for what is wrong."""

from __future__ import annotations

import hashlib
import re
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pxr import Sdf, Usd
from scene_solids import placed

from datafactory.scenes.city.city import city, write_city
from datafactory.scenes.city.footprints import Footprint, body_boxes, footprints_of
from datafactory.scenes.city.options import VERSION, CityOptions
from datafactory.scenes.city.placement import Placement
from datafactory.scenes.city.style import Style
from datafactory.scenes.ground import free_ground
from datafactory.scenes.poses import sample_pose
from datafactory.scenes.readers.open import open_scene
from shared.physics.errors import InputError

LARGEST = 150_000
TIMES_S = (0.0, 4.0, 9.0, 12.0, 16.0, 24.0)
CLASSES = {"car", "truck", "bus", "motorcycle", "bicycle", "pedestrian", "pole", "sign", "tree", "other"}
WRITTEN = {
    ("old-town", 3): "376ffc4234642cf3e87d035ff9f14c223064128baf138ed09d9e105a5e86d35d",
    ("old-town", 8): "afef05cbb6073e1cec353fb930d90a96db45aa774ff9cc2fd2dfc04e39f39be9",
    ("suburb", 3): "9b470dd3f76027503a5cc8f04b7f24475ceab361ef8a104414d6b52a58ddb670",
    ("suburb", 8): "255c1ca87341abd43f88f7a6f51cadd328f7fcb46126ee3ace5c69d5ba308ebf",
    ("motorway", 3): "7fb0cb49e23e96ea19ac69d21d1740e13daa20dcab06874642e671f78184c9e9",
    ("motorway", 8): "803d70e8b1836049a0a5ae8a5f6ad2f33cfa7b7ca7382f1198ac7c41664c7ade",
    ("industrial", 3): "60827d33f12538e56ff94b7867df4c122e182c87072c536b3834698bbbb5ae15",
    ("industrial", 8): "fd4e0a62b943be9dbfc0bcdf222dbd9ea85dff390625283a042e2c34f2e9002e",
    ("car-park", 3): "d0a18f6444166f98a3be293319d70f73e831dea5d0d0251bdae5bbc52addd771",
    ("car-park", 8): "92d64ade6f4d9aa1ebf28e4368bfd6266d6f5e14eb75f0a82d25759081eef869",
}
"""SHA-256 of cities of one block, as text. A change of the generator changes these, and ``options.VERSION``."""


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


@pytest.mark.parametrize("suffix", [".usda", ".usdc"])
def test_same_seed_same_bytes_and_another_seed_differs(tmp_path: Path, suffix: str) -> None:
    files = [tmp_path / f"{name}{suffix}" for name in ("first", "again", "other")]
    for path, seed in zip(files, (4, 4, 5), strict=True):
        write_city(path, seed=seed, blocks=1)
    first, again, other = (path.read_bytes() for path in files)
    assert first == again
    assert first != other


def overlaps(placements: Sequence[Placement], time_s: float) -> list[tuple[str, str]]:
    """Pairs of things whose bodies' boxes have more than a touch in common; pairs at rest are looked at at time 0."""
    boxes: dict[str, np.ndarray] = {}
    bodies: list[tuple[Placement, Footprint]] = []
    for item in placements:
        if item.surface is None or item.path.startswith(("Ground/", "Covers/")):
            continue
        key = item.model or item.path
        if key not in boxes:
            boxes[key] = body_boxes(item.surface)
        bodies += [(item, body) for body in footprints_of(boxes[key], *placed(item, time_s))]
    circles = np.array([(body.x, body.y, 0.5 * np.hypot(body.length, body.width)) for _, body in bodies])
    found = []
    for i, (item, body) in enumerate(bodies):
        if time_s and not item.keyframes:
            continue
        near = np.hypot(*(circles[:, :2] - circles[i, :2]).T) < circles[:, 2] + circles[i, 2]
        for j in np.flatnonzero(near):
            other, its = bodies[j]
            if other is not item and body.overlaps(its):
                found.append((item.path, other.path))
    return found


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("style", list(Style))
def test_nothing_stands_in_or_drives_into_anything_else(style: Style, seed: int) -> None:
    placements = city(CityOptions(seed=seed, style=style))
    assert [pair for time_s in TIMES_S for pair in overlaps(placements, time_s)] == []
    triangles = sum(len(item.surface.triangles()) for item in placements if item.surface is not None)
    assert 15_000 < triangles < LARGEST
    assert {item.radar_class for item in placements} - {""} <= CLASSES
    assert all(item.radar_class for item in placements if item.keyframes)


def test_an_overlap_would_be_found() -> None:
    placements = list(city(CityOptions(seed=0, blocks=1)))
    cars = [item for item in placements if item.path.startswith("Cars/")]
    placements.append(Placement("Cars/Car_extra", cars[0].surface, cars[0].position, cars[0].yaw_deg + 30.0))
    assert ("Cars/Car_extra", cars[0].path) in overlaps(placements, 0.0)


@pytest.mark.parametrize("style", list(Style))
def test_without_traffic_what_stands_is_the_same(style: Style) -> None:
    whole, empty = (city(CityOptions(seed=1, blocks=1, style=style, traffic=traffic)) for traffic in (True, False))

    def standing(item: Placement) -> tuple[object, ...]:
        return item.path, item.position, item.yaw_deg, item.velocity, item.model, item.keyframes, item.target

    assert [standing(item) for item in empty] == [standing(item) for item in whole[: len(empty)]]
    assert len(whole) > len(empty)
    assert not any(item.keyframes for item in empty)
    assert any(item.keyframes for item in whole[len(empty) :])


@pytest.mark.parametrize("style", list(Style))
def test_sensors_stand_on_the_ground_outside_of_everything(tmp_path: Path, style: Style) -> None:
    path = tmp_path / "city.usda"
    write_city(path, seed=1, blocks=1, style=style)
    scene = open_scene(str(path))
    ground = free_ground(scene)
    placements = [
        item for item in city(CityOptions(seed=1, blocks=1, style=style)) if not item.path.startswith("Ground/")
    ]
    bodies = [
        body
        for item in placements
        if item.surface is not None
        for body in footprints_of(body_boxes(item.surface), *placed(item, 0.0))
    ]
    rng = np.random.default_rng(0)
    for split in ("train", "validation", "test"):
        for _ in range(5):
            x, y, z = sample_pose(ground, split, rng).position
            assert 0.4 < z < 0.9
            sensor = Footprint(x, y, 0.1, 0.1, 0.0, z - 0.05, z + 0.05)
            assert not any(sensor.overlaps(body) for body in bodies)


def test_the_file_says_what_made_it_and_what_its_objects_are(tmp_path: Path) -> None:
    path = tmp_path / "city.usda"
    write_city(path, seed=2, blocks=1, style=Style.SUBURB)
    made = Sdf.Layer.FindOrOpen(str(path)).customLayerData["sparseradar:city"]
    assert dict(made) == {"style": "suburb", "seed": 2, "blocks": 1, "version": VERSION}
    write_city(tmp_path / "empty.usda", seed=2, blocks=1, style=Style.SUBURB, traffic=False)
    of_empty = Sdf.Layer.FindOrOpen(str(tmp_path / "empty.usda")).customLayerData["sparseradar:city"]
    assert dict(of_empty) == {**made, "traffic": False}
    stage = Usd.Stage.Open(str(path))
    for group, name in (("Cars", "car"), ("Trees", "tree"), ("Lamps", "pole")):
        prims = stage.GetPrimAtPath(f"/World/{group}").GetChildren()
        assert prims
        assert {prim.GetAttribute("radar:class").Get() for prim in prims} == {name} | (
            {"tree"} if group == "Trees" else set()
        )


def test_larger_cities_have_more_streets() -> None:
    for blocks in (1, 3):
        placements = city(CityOptions(seed=0, blocks=blocks, style=Style.SUBURB))
        roads = next(item.surface for item in placements if item.path == "Ground/Road_0")
        assert roads is not None
        spans = np.ptp(roads.vertices[:, 0])
        assert 60.0 * blocks < spans < 140.0 * blocks + 60.0


@pytest.mark.parametrize(
    ("name", "arguments", "words"),
    [
        ("city.obj", {}, ("city.obj", "'.obj'", ".usda")),
        ("missing/city.usda", {}, ("missing", "does not exist")),
        ("city.usda", {"seed": -1}, ("seed = -1", "greater than or equal to 0")),
        ("city.usda", {"seed": 1.5}, ("seed = 1.5", "integer")),
        ("city.usda", {"blocks": 0}, ("blocks = 0", "greater than or equal to 1")),
        ("city.usda", {"style": "village"}, ("style = 'village'", "Style")),
        ("x" * 300 + ".usda", {}, ("cannot be written",)),
    ],
)
def test_bad_arguments_are_one_clear_line(
    tmp_path: Path, name: str, arguments: dict[str, Any], words: tuple[str, ...]
) -> None:
    with pytest.raises(InputError) as caught:
        write_city(tmp_path / name, **arguments)
    message = str(caught.value)
    assert "\n" not in message
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
    command = [sys.executable, "-c", FULL, str(path)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout.startswith(f"{path}: cannot be written (")
    assert len(done.stdout.splitlines()) == 1
    assert [entry.name for entry in tmp_path.iterdir()] == [path.name]
    assert path.read_text() == "before"
