"""``datafactory view`` and cameras beside radar images: what pages are told, pictures, the frames they look at."""

import json
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from factory_command import refused, run
from matplotlib.image import imread
from prepared_scenes import EFFECT_SCENES, STREET, TINY, prepared_scene
from small_radar import SMALL_RADAR
from usd_files import cube, write_usda

from datafactory.api.asking import load_scene
from datafactory.api.making import render, trace
from datafactory.api.viewing import view
from datafactory.frame.deal import PreparedScene
from datafactory.paths.merged_scene import MergedMesh, MergedScene
from datafactory.scenes.materials.table import load_materials
from datafactory.scenes.poses import Pose, read_poses
from datafactory.view.camera import (
    ABOVE_M,
    ABOVE_PIXELS_A_METRE,
    FIELD_DEG,
    HEIGHT,
    WIDTH,
    Cameras,
    above_picture,
    camera_picture,
)
from datafactory.view.page import page_data, view_page
from datafactory.view.subject import Subject
from shared.dataset.folder import open_dataset, verify
from shared.physics.errors import InputError
from shared.radar import load_radar

RAYS = 2000


def told(page: Path) -> dict:
    """The JSON that a page holds."""
    (data,) = re.findall(r"const data = (\{.*\});\n", page.read_text(encoding="utf-8"))
    return json.loads(data)


def subject(scene: Path, pose: Pose) -> Subject:
    return Subject("it", prepared_scene(scene), pose, load_radar("avr-qdm-110"))


def test_the_page_is_whole_and_asks_for_nothing(tmp_path: Path) -> None:
    poses = EFFECT_SCENES / "moving_car.poses.json"
    arguments = ["view", "--scene", EFFECT_SCENES / "moving_car.usda", "--poses", poses, "--rays", RAYS]
    run(*arguments, "--out", tmp_path / "page.html")
    text = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "Three.js Authors" in text
    assert not re.search(r'(?:src|href)\s*=\s*["\']?\s*(?:https?:)?//', text)
    data = told(tmp_path / "page.html")
    pose, *_ = read_poses(poses)
    assert f"({', '.join(f'{value:.1f}' for value in pose.position)}) m" in data["pose"]
    assert {kind["name"]: kind["found"] for kind in data["kinds"]}["direct scatter"] > 0
    drawn = [path for kind in data["kinds"] for path in kind["paths"]]
    assert 0 < len(drawn) <= 200
    for path in drawn:
        assert path["points"][0] == [0.0, 0.0, 0.0]
        np.testing.assert_allclose(path["points"][-1], 0.0, atol=0.2)
    assert data["movers"], "the car moves"
    assert all(mover["speed"] > 0.0 for mover in data["movers"])


def test_a_hostile_name_stays_a_name(tmp_path: Path) -> None:
    looked_at = subject(TINY, Pose((0.0, 0.0, 0.5)))
    name = "</script><script>alert(1)</script>"
    page = tmp_path / "page.html"
    page.write_text(view_page(Subject(name, looked_at.scene, looked_at.pose, looked_at.radar)), encoding="utf-8")
    assert told(page)["title"] == name
    assert name not in page.read_text(encoding="utf-8")


def test_places_are_those_of_the_radar_frame_at_the_frames_time() -> None:
    """A car of the moving scene, seen two seconds later by a sensor that looks the other way."""
    now, later = (subject(EFFECT_SCENES / "moving_car.usda", Pose((0.0, 0.0, 0.5), time_s=t)) for t in (0.0, 2.0))
    turned = subject(EFFECT_SCENES / "moving_car.usda", Pose((0.0, 0.0, 0.5), yaw_deg=180.0))
    for one, other, back in zip(now.movers(), later.movers(), turned.movers(), strict=True):
        position, velocity = np.array(one[1:])
        np.testing.assert_allclose(other[1] - position, 2.0 * velocity, atol=1e-9)
        np.testing.assert_allclose(back[1:], [position, velocity] * np.array([-1, -1, 1]), atol=1e-9)
    assert page_data(now, None)["kinds"] == []


def test_traced_paths_are_looked_at_in_their_own_scene(tmp_path: Path) -> None:
    trace(TINY, tmp_path / "paths", frames=2, rays=RAYS, effects="all")
    written = view(None, tmp_path / "page.html", paths=tmp_path / "paths", frame=1)
    assert written == (tmp_path / "page.html",)
    assert told(written[0])["title"] == "tiny, frame 1"
    assert sum(len(kind["paths"]) for kind in told(written[0])["kinds"]) > 0
    with pytest.raises(InputError, match="is not the scene in which the paths of"):
        view(STREET, tmp_path / "other.html", paths=tmp_path / "paths")
    with pytest.raises(InputError, match="--frame: 2; expected 0 to 1"):
        view(None, tmp_path / "other.html", paths=tmp_path / "paths", frame=2)
    with pytest.raises(InputError, match="--rays: beside --paths: the trace has settled it"):
        view(None, tmp_path / "other.html", paths=tmp_path / "paths", rays=RAYS)
    assert not (tmp_path / "other.html").exists()


def test_a_frame_of_a_track_is_looked_at(tmp_path: Path) -> None:
    track = [Pose((0.0, 0.0, 0.5)), Pose((0.5, 0.0, 0.5), time_s=0.1)]
    page = tmp_path / "new" / "page.html"
    view(TINY, page, trajectory=[track], frame=1, rays=RAYS)
    assert "(0.5, 0.0, 0.5) m" in told(page)["pose"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--scene", TINY, "--out", "OUT/page.htm"], "expected a file that ends in .html"),
        (["--scene", TINY, "--out", f"{__file__}/page.html"], f"{__file__} is a file; expected a file in a folder"),
        (["--scene", TINY, "--frame", 8, "--out", "OUT/new/page.html"], "--frame: 8; expected 0 to 7"),
        (["--out", "OUT/page.html"], "--scene: missing; expected a scene file or sionna:NAME, or --paths"),
        (["--paths", "OUT", "--out", "OUT/page.html"], "manifest.json"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(tmp_path: Path, arguments: list[object], message: str) -> None:
    words = [str(word).replace("OUT", str(tmp_path)) for word in arguments]
    assert message in refused("view", *words)
    assert list(tmp_path.iterdir()) == []


def test_pictures_show_things_where_they_are() -> None:
    """A plate 10 m ahead, 2 to 4 m to the left, 0 to 2 m up: a pinhole's columns and rows, and a map's."""
    corners = np.array([[10.0, 2.0, 0.0], [10.0, 4.0, 0.0], [10.0, 4.0, 2.0], [10.0, 2.0, 2.0],
                        [10.5, 2.0, 2.0], [10.5, 4.0, 2.0]])  # fmt: skip
    triangles = np.array([[0, 1, 2], [0, 2, 3], [3, 2, 5], [3, 5, 4]], dtype=np.int32)
    materials = load_materials().map_materials(["metal"])
    plate = MergedMesh(materials["metal"], np.zeros(3), corners, triangles, np.zeros(4, dtype=np.int32))
    scene = PreparedScene("plate", "", MergedScene((plate,), ("plate",)), materials)
    looked_at = Subject("plate", scene, Pose((0.0, 0.0, 0.0)), load_radar("avr-qdm-110"))
    width, height = 400, 200
    dark = (camera_picture(looked_at, width, height).astype(int).sum(axis=-1) < 450).nonzero()
    half = np.tan(np.radians(FIELD_DEG) / 2.0)
    # The edge at x = 10.5 m is seen past the plate, from below.
    left, right = (0.5 * width * (1.0 - share / half) for share in (0.4, 2.0 / 10.5))
    top, bottom = (0.5 * height - 0.5 * width * share / half for share in (0.2, 0.0))
    for axis, first, last in ((0, top, bottom), (1, left, right)):
        assert dark[axis].min() == pytest.approx(first, abs=1.5)
        assert dark[axis].max() + 1 == pytest.approx(last, abs=1.5)
    _, farthest, aside = ABOVE_M
    rows, columns = (above_picture(looked_at).astype(int).sum(axis=-1) < 450).nonzero()
    scale = ABOVE_PIXELS_A_METRE
    assert rows.min() == pytest.approx((farthest - 10.5) * scale, abs=1.5)
    assert rows.max() + 1 == pytest.approx((farthest - 10.0) * scale, abs=1.5)
    assert columns.min() == pytest.approx((aside - 4.0) * scale, abs=1.5)
    assert columns.max() + 1 == pytest.approx((aside - 2.0) * scale, abs=1.5)


def test_the_pictures_are_written_beside_the_page(tmp_path: Path) -> None:
    run("view", "--scene", TINY, "--rays", RAYS, "--png", "--out", tmp_path / "tiny.html")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["tiny-above.png", "tiny-camera.png", "tiny.html"]
    for name in ("camera", "above"):
        picture = imread(tmp_path / f"tiny-{name}.png")
        assert np.ptp(picture[..., :3]) > 0.5


def test_each_thing_that_moves_has_one_arrow() -> None:
    """Each car of the street is several prims; the sensor has an arrow too."""
    movers = subject(STREET, Pose((0.0, 0.0, 0.5), velocity=(3.0, 4.0, 0.0))).movers()
    names = [name for name, _, _ in movers]
    assert len(names) == len(set(names)) < 25
    assert names[-1] == "sensor"
    assert movers[-1][2] == pytest.approx((3.0, 4.0, 0.0))


POSES = (Pose((0.0, 0.0, 0.5)), Pose((0.5, 0.0, 0.6), 30.0, -10.0, 5.0, (1.0, 0.0, 0.0), 0.5))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two frames of a copy of the tiny scene, and one of point targets."""
    folder = tmp_path_factory.mktemp("cameras")
    (folder / "radar.toml").write_text(SMALL_RADAR, encoding="utf-8")
    shutil.copy(TINY, folder / "tiny.usda")
    steps: list[tuple[str, int, int]] = []
    render(
        folder / "tiny.usda", folder / "with", radar=folder / "radar.toml", poses=POSES, points=1, rays=2000,
        effects="all", split="1:0:0", camera=True, progress=lambda *step: steps.append(step),
    )  # fmt: skip
    assert steps[-3:] == [("camera pictures", done, 2) for done in range(3)]
    return folder


def test_every_scene_frame_has_a_picture_and_the_shards_are_the_same(folder: Path) -> None:
    pictures = sorted((folder / "with" / "camera").iterdir())
    assert [path.name for path in pictures] == ["frame-000000.png", "frame-000001.png"]
    seen = [imread(path)[..., :3] for path in pictures]
    assert all(picture.shape == (HEIGHT, WIDTH, 3) for picture in seen)
    assert np.abs(seen[0] - seen[1]).mean() > 0.01
    scene = load_scene(folder / "tiny.usda")
    render(
        scene, folder / "without", radar=str(folder / "radar.toml"), poses=POSES, points=1, rays=2000, effects="all",
        split="1:0:0",
    )  # fmt: skip
    part = Path("train/part-00000.parquet")
    assert (folder / "with" / part).read_bytes() == (folder / "without" / part).read_bytes()
    assert verify(open_dataset(folder / "with")) == []


def test_a_frame_is_seen_from_its_pose_at_its_time(folder: Path) -> None:
    dataset = open_dataset(folder / "with")
    cameras = Cameras(dataset)
    frames = list(dataset.frames("train", columns=()))
    for frame, pose in zip(frames, POSES, strict=False):
        subject = cameras.subject(frame)
        assert subject is not None
        assert subject.pose.position == pose.position
        assert subject.pose.time_s == pose.time_s
        np.testing.assert_allclose(subject.pose.rotation(), pose.rotation(), atol=1e-12)
    assert cameras.subject(frames[2]) is None  # of point targets


def test_inspect_draws_what_was_written_or_makes_it(folder: Path) -> None:
    drawn = {}
    for name, more in (("stored", []), ("made", ["--camera"]), ("none", [])):
        if name == "made":
            (folder / "with" / "camera").rename(folder / "put-away")
        run("inspect", folder / "with", "--frames", 3, "--out", folder / name, *more)
        drawn[name] = [path.read_bytes() for path in sorted((folder / name).glob("frame-*.png"))]
    (folder / "put-away").rename(folder / "with" / "camera")
    assert drawn["stored"] == drawn["made"]
    assert drawn["none"][0] != drawn["stored"][0]
    assert drawn["none"][2] == drawn["stored"][2]  # point targets have no scene to look at


def test_a_scene_that_has_changed_is_not_shown(folder: Path) -> None:
    before = (folder / "tiny.usda").read_text(encoding="utf-8")
    (folder / "tiny.usda").write_text(STREET.read_text(encoding="utf-8"), encoding="utf-8")
    dataset = open_dataset(folder / "with")
    frame = next(iter(dataset.frames("train", columns=())))
    with pytest.raises(InputError, match="is not the scene that was rendered"):
        Cameras(dataset).subject(frame)
    (folder / "tiny.usda").write_text(before, encoding="utf-8")


def test_frames_of_traced_paths_have_the_pictures_of_frames_of_the_scene(folder: Path, tmp_path: Path) -> None:
    radar = folder / "radar.toml"
    trace(folder / "tiny.usda", tmp_path / "paths", radar=radar, poses=POSES, rays=2000, effects="all", split="1:0:0")
    steps: list[tuple[str, int, int]] = []
    render(
        None, tmp_path / "data", paths=tmp_path / "paths", radar=radar, camera=True,
        progress=lambda *step: steps.append(step),
    )  # fmt: skip
    assert steps[-3:] == [("camera pictures", done, 2) for done in range(3)]
    for name in ("frame-000000.png", "frame-000001.png"):
        assert (tmp_path / "data/camera" / name).read_bytes() == (folder / "with/camera" / name).read_bytes()


def test_one_file_given_twice_is_one_scene(folder: Path, tmp_path: Path) -> None:
    twice = [folder / "tiny.usda"] * 2
    render(twice, tmp_path / "two", radar=folder / "radar.toml", frames=2, rays=100, effects="diffuse", camera=True)
    assert len(list((tmp_path / "two/camera").iterdir())) == 2


def test_a_scene_is_read_again_as_it_was_read(folder: Path, tmp_path: Path) -> None:
    looks = "".join(f'"{look}" {{\n{cube(look)}\n}}\n' for look in "ab")
    stage = f"""def "set" (
  variants = {{
    string look = "a"
  }}
  prepend variantSets = "look"
) {{
  variantSet "look" = {{
{looks}  }}
}}
def "lost" (references = @gone.usd@) {{
}}"""
    path = write_usda(tmp_path, stage)
    reading: dict[str, Any] = {"variant": ["look=b"], "allow_missing": True}
    asked: dict[str, Any] = {"radar": folder / "radar.toml", "poses": [Pose((-5.0, 0.0, 0.0))], "rays": 100, **reading}
    asked |= {"effects": "diffuse", "split": "1:0:0"}
    render(path, tmp_path / "frames", **asked)
    dataset = open_dataset(tmp_path / "frames")
    (frame,) = dataset.frames("train", columns=())
    seen = Cameras(dataset).subject(frame)
    assert seen is not None
    assert seen.scene.merged.objects == ("/set/b",)
    trace(path, tmp_path / "paths", **asked)
    for given in ({}, reading):
        view(None, tmp_path / "page.html", paths=tmp_path / "paths", **given)
    with pytest.raises(InputError, match="is not the scene in which the paths of"):
        view(None, tmp_path / "page.html", paths=tmp_path / "paths", variant=["look=a"], allow_missing=True)


def test_pictures_show_the_materials_that_were_simulated(folder: Path, tmp_path: Path) -> None:
    leaves = "[material.wet_leaves]\nrelative_permittivity = 3\nconductivity = 1\n[map]\nasphalt = 'wet_leaves'\n"
    (tmp_path / "materials.toml").write_text(leaves, encoding="utf-8")
    asked: dict[str, Any] = {"radar": folder / "radar.toml", "poses": POSES[:1], "rays": 100, "effects": "diffuse"}
    asked |= {"split": "1:0:0", "materials": tmp_path / "materials.toml"}
    render(folder / "tiny.usda", tmp_path / "frames", **asked, camera=True)
    trace(folder / "tiny.usda", tmp_path / "paths", **asked)
    render(None, tmp_path / "later", paths=tmp_path / "paths", radar=folder / "radar.toml", camera=True)
    dataset = open_dataset(tmp_path / "frames")
    (frame,) = dataset.frames("train", columns=())
    made = Cameras(dataset).subject(frame)
    assert made is not None
    assert "wet_leaves" in [mesh.material for mesh in made.scene.merged.meshes]
    for name in ("frames", "later"):
        stored = imread(tmp_path / name / "camera/frame-000000.png")[..., :3]
        np.testing.assert_array_equal(np.rint(255.0 * stored), camera_picture(made))
    view(None, tmp_path / "page.html", paths=tmp_path / "paths")
    assert "wet_leaves" in [material["name"] for material in told(tmp_path / "page.html")["materials"]]
