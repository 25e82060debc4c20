"""Byte for byte the run in one piece: jobs of an array, merged; traced now and rendered later.

Datasets of code before this one are read as they are, too; columns that came later say that nothing is known. Each of
tests/old_datasets was made by the commit of its name; the first had no columns time, sequence and boxes:

    datafactory render scenes/tiny.usda --radar tests/old_datasets/radar.toml --frames 1 --points 1 --split 1:0:0 \
        --seed 1 --rays 2000 --out DIR
"""

import json
from pathlib import Path

import numpy as np
import pytest
from factory_command import but_made, frames_of, run, shards
from prepared_scenes import TINY
from small_radar import SMALL_RADAR, write_radar

from datafactory.frame.draws import frame_seed
from shared.dataset.folder import open_dataset
from shared.dataset.reading import read_frame
from shared.physics.errors import InputError
from shared.radar import load_radar
from trainer.data.dataset import RadarDataset


def test_rendered_traced_and_rendered_from_traces(radar_file: Path, tmp_path: Path) -> None:
    """The plan is the first job's work; the second finds it in the user's cache."""
    scene = (TINY, "--radar", radar_file, "--rays", 500, "--frames", 9, "--seed", 3, "--workers", 1)
    kinds = {
        "render": ("render", *scene, "--points", 3),
        "trace": ("trace", *scene, "--effects", "specular,diffuse"),
        "paths": ("render", "--paths", tmp_path / "trace-whole", "--radar", radar_file, "--workers", 1),
    }
    for name, arguments in kinds.items():
        run(*arguments, "--out", tmp_path / f"{name}-whole")
        for job in ("0/2", "1/2"):
            assert "datafactory merge" in run(*arguments, "--out", tmp_path / f"{name}-jobs", "--shard", job)
        run("merge", tmp_path / f"{name}-jobs", "--out", tmp_path / name)
        merged, whole = tmp_path / name, tmp_path / f"{name}-whole"
        assert shards(merged) == shards(whole)
        assert json.dumps(but_made(merged)) == json.dumps(but_made(whole))


def test_paths_of_a_job_are_not_rendered(radar_file: Path, tmp_path: Path) -> None:
    traced = ("--radar", radar_file, "--rays", 100, "--frames", 9, "--out", tmp_path)
    run("trace", TINY, *traced, "--shard", "0/2")
    with pytest.raises(InputError, match="is a job of an array; expected the folder that datafactory merge makes"):
        run("render", "--paths", tmp_path / "job-0-of-2", "--radar", radar_file, "--out", tmp_path / "frames")


def test_the_error_budget_of_stored_paths_is_that_of_effects(radar_file: Path, tmp_path: Path) -> None:
    run("trace", TINY, "--radar", radar_file, "--rays", 100, "--frames", 1, "--out", tmp_path / "traced")
    stored = ("render", "--paths", tmp_path / "traced", "--radar", radar_file)
    run(*stored, "--error-budget", -40, "--out", tmp_path / "frames")
    manifest = but_made(tmp_path / "frames")
    assert manifest["arguments"]["budget_db"] == -40.0
    assert "error_budget" not in manifest
    with pytest.raises(InputError, match="--error-budget: beside --paths and chosen effects"):
        run(*stored, "--effects", "diffuse", "--error-budget", -40, "--out", tmp_path / "chosen")


def test_another_seed_draws_other_noise_of_the_same_paths(tmp_path: Path) -> None:
    """Of one chirp: a row of the truth holds besides what other rows of its Doppler cell ask for
    (:mod:`datafactory.synthesis.mid_frame`), and which rows share one the noise chooses."""
    radar_file = write_radar(tmp_path, SMALL_RADAR.replace("chirps = 8", "chirps = 1"))
    run("trace", TINY, "--radar", radar_file, "--rays", 500, "--frames", 2, "--seed", 3, "--out", tmp_path / "traced")
    stored = ("render", "--paths", tmp_path / "traced", "--radar", radar_file)
    run(*stored, "--out", tmp_path / "its-own")
    run(*stored, "--seed", 4, "--out", tmp_path / "another")
    others = frames_of(tmp_path / "another")
    for number, (_, one) in frames_of(tmp_path / "its-own").items():
        _, other = others[number]
        assert (one.seed, other.seed) == (frame_seed(3, one.frame_id), frame_seed(4, one.frame_id))
        assert one.sensor_position == other.sensor_position
        assert not np.array_equal(one.range_channel, other.range_channel)
        alike = one.velocity[0] == other.velocity[0]  # rows in other Doppler cells show other echoes
        assert alike.sum() > 10
        level, again = (frame.image[alike] * np.float32(frame.image_peak) for frame in (one, other))
        np.testing.assert_allclose(level, again, rtol=0.0, atol=1e-5 * one.image_peak)


def test_camera_pictures_wait_for_the_merge(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="--camera: beside --shard; expected datafactory inspect --camera"):
        run("render", TINY, "--out", tmp_path / "jobs", "--shard", "0/2", "--camera")
    assert not (tmp_path / "jobs").exists()


def test_a_dry_run_tells_of_the_job_alone(radar_file: Path, tmp_path: Path) -> None:
    arguments = ("render", TINY, "--radar", radar_file, "--frames", 18, "--points", 6, "--out", tmp_path, "--dry-run")
    assert run(*arguments).startswith("24 frames (train 18, validation 3, test 3) in 5 shards")
    assert run(*arguments, "--shard", "2/3").startswith("2 frames (train 2) in 1 shards")


MADE_OF = ("brick", "glass", "wood", "plasterboard", "marble")
"""What stands for the bricks of each scene, by its number; some let waves through."""


@pytest.fixture
def scenes(tmp_path: Path) -> list[Path]:
    """Five scenes: a file each, all of one shape."""
    text = TINY.read_text(encoding="utf-8")
    paths = [tmp_path / f"scene{number}.usda" for number in range(len(MADE_OF))]
    for path, material in zip(paths, MADE_OF, strict=True):
        path.write_text(text.replace("brick", material), encoding="utf-8")
    return paths


@pytest.mark.parametrize(
    ("count", "more"),
    [
        (2, ("--frames", 10, "--seed", 3)),  # the turn begins one scene later from frame 8 on
        (5, ("--frames", 6, "--split", "2:1:1")),
        pytest.param(3, ("--poses",), marks=pytest.mark.slow),
    ],
)
def test_traced_now_and_rendered_later_is_rendered_at_once(
    count: int, more: tuple[object, ...], scenes: list[Path], radar_file: Path, tmp_path: Path
) -> None:
    if more == ("--poses",):
        poses = [{"position": [-10.0 + 0.5 * number, 0.2 * number, 0.5]} for number in range(7)]
        (tmp_path / "poses.json").write_text(json.dumps(poses), encoding="utf-8")
        more = ("--poses", tmp_path / "poses.json")
    given = [item for path in scenes[:count] for item in ("--scene", path)]
    common = ("--radar", radar_file, "--rays", 500, *more, "--workers", 1)
    run("render", *given, *common, "--points", 2, "--out", tmp_path / "once")
    run("trace", *given, *common, "--out", tmp_path / "traced")
    run("render", "--paths", tmp_path / "traced", "--radar", radar_file, *more[2:], "--points", 2, "--workers", 1,
        "--out", tmp_path / "later")  # fmt: skip
    once = shards(tmp_path / "once")
    assert shards(tmp_path / "later") == once
    frames = frames_of(tmp_path / "once").values()
    assert len({frame.scene for _, frame in frames if frame.kind == "scene"}) == count


DATASETS = Path(__file__).parents[1] / "old_datasets"
SCENE = {
    "8f2282a7": (np.nan, 4.6608857928731595e-07, 21, (10.192943572, 0.765, 0.0, -126.63063077178234), 6.558604e-07),
    "b697f09c": (0.0, 1.106573563447455e-05, 25, (8.394188824, -0.17, 0.0, -99.12039418986615), 1.2298891e-05),
}
"""Of the frame of the scene: time, peak of the truth, how many targets and the first of them, largest input."""


@pytest.mark.parametrize("commit", SCENE)
def test_a_dataset_made_before_is_read_whole(commit: str, tmp_path: Path) -> None:
    folder, shard = DATASETS / commit, DATASETS / commit / "train/part-00000.parquet"
    assert "1 shards are as they were written" in run("inspect", folder, "--verify", "--out", tmp_path)
    assert len(list(tmp_path.glob("*.png"))) == 2
    data, frames = RadarDataset(folder, boxes=True), list(open_dataset(folder).frames("train"))
    assert str(data.radar) == str(load_radar(str(DATASETS / "radar.toml")))
    for example, frame in zip(data, frames, strict=True):
        np.testing.assert_array_equal(example.input, frame.range_channel)
        np.testing.assert_array_equal(example.image, frame.image)
        assert (example.metadata["boxes"], frame.boxes) == ([], ())
        assert (example.metadata["sequence"], frame.sequence) == (-1, -1)
        np.testing.assert_equal(example.metadata["time"], frame.time)
    scene, points = frames
    time, peak, targets, first, largest = SCENE[commit]
    np.testing.assert_equal(scene.time, time)
    assert (scene.scene, scene.seed, len(scene.targets)) == ("tiny", 4215923173971654960, targets)
    found = scene.targets[0]
    assert (found.range_m, found.u, found.velocity_mps, found.amplitude_db) == pytest.approx(first, rel=1e-12)
    assert (scene.image_peak, np.abs(scene.range_channel).max()) == pytest.approx((peak, largest), rel=1e-6)
    assert (points.kind, points.seed, len(points.targets)) == ("points", 2021340933837429789, 50)
    assert points.noise_power == scene.noise_power == pytest.approx(4.4286235540758504e-16, rel=1e-12)
    assert points.velocity[0, :2] == pytest.approx([-6.0283785, 0.0])
    assert points.image.argmax() == 168
    assert read_frame(shard, 0, columns=["image", "boxes"]).boxes == ()
