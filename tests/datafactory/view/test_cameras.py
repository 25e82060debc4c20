"""``render --camera`` and ``inspect --camera``: the camera's picture beside the radar's images."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread
from prepared_scenes import SCENES
from typer.testing import CliRunner

from datafactory import Pose, render, trace
from datafactory.api.asking import load_scene
from datafactory.cli.app import app
from datafactory.view.camera import HEIGHT, WIDTH, Cameras
from shared.dataset.folder import open_dataset, verify
from shared.physics.errors import InputError

POSES = (Pose((0.0, 0.0, 0.5)), Pose((0.5, 0.0, 0.6), 30.0, -10.0, 5.0, (1.0, 0.0, 0.0), 0.5))
SHORT = "[waveform]\nsamples = 128\nchirps = 16\nrange_bins = 64\n"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two frames of a copy of the tiny scene, and one of point targets."""
    folder = tmp_path_factory.mktemp("cameras")
    (folder / "radar.toml").write_text(SHORT, encoding="utf-8")
    shutil.copy(SCENES / "tiny.usda", folder / "tiny.usda")
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
        arguments = ["inspect", str(folder / "with"), "--frames", "3", "--out", str(folder / name), *more]
        assert CliRunner().invoke(app, arguments, catch_exceptions=False).exit_code == 0
        drawn[name] = [path.read_bytes() for path in sorted((folder / name).glob("frame-*.png"))]
    (folder / "put-away").rename(folder / "with" / "camera")
    assert drawn["stored"] == drawn["made"]
    assert drawn["none"][0] != drawn["stored"][0]
    assert drawn["none"][2] == drawn["stored"][2]  # point targets have no scene to look at


def test_a_scene_that_has_changed_is_not_shown(folder: Path) -> None:
    before = (folder / "tiny.usda").read_text(encoding="utf-8")
    (folder / "tiny.usda").write_text((SCENES / "street.usda").read_text(encoding="utf-8"), encoding="utf-8")
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
