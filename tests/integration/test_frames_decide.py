"""Of frames those have an effect that call for it, the others do not, and the bytes hang on nothing else."""

import json
from pathlib import Path

import numpy as np
import pytest
from factory_command import run
from prepared_scenes import EFFECT_SCENES

from datafactory.defaults import DEFAULT_BUDGET_DB
from shared.dataset.folder import open_dataset, read_manifest
from shared.dataset.schema import Frame
from shared.radar import load_radar

RADAR = """
[waveform]
chirps = 16
samples = 512
range_bins = 400
[grid]
bins = 40
"""
FRAMES, ODD = 20, 13
SCENE = EFFECT_SCENES / "parked_car.usda"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("frames")


def made(folder: Path, out: str, poses: list[dict], *more: object, scene: Path = SCENE) -> Path:
    """A run of these poses in ``folder``."""
    (folder / "radar.toml").write_text(RADAR, encoding="utf-8")
    (folder / f"{out}.json").write_text(json.dumps(poses), encoding="utf-8")
    run("render", "--scene", scene, "--poses", folder / f"{out}.json", "--radar", folder / "radar.toml",
        "--rays", 20_000, "--split", "1:0:0", "--out", folder / out, *more)  # fmt: skip
    return folder / out


def counts(out: Path) -> dict[str, int]:
    return read_manifest(out)["counts"]


def frames(out: Path) -> list[Frame]:
    return sorted(open_dataset(out).frames("train"), key=lambda frame: frame.frame_id)


def standing_but_one() -> list[dict]:
    """Twenty frames at one place; in the odd one the radar drives at 5 m/s."""
    poses = [{"position": [0.0, 0.0, 0.5]} for _ in range(FRAMES)]
    poses[ODD] = {**poses[ODD], "velocity": [5.0, 0.0, 0.0]}
    return poses


@pytest.fixture(scope="module")
def driving(folder: Path) -> Path:
    return made(folder, "driving", standing_but_one(), "--workers", 1, "--no-noise")


def test_one_moving_frame_of_twenty_has_doppler_and_the_others_have_none(driving: Path) -> None:
    found = counts(driving)
    arguments = read_manifest(driving)["arguments"]
    assert (arguments["effects"], arguments["budget_db"]) == ("auto", DEFAULT_BUDGET_DB)
    assert found["frames"] == FRAMES
    assert found["frames_with_doppler"] == 1
    assert found["frames_with_diffraction"] == found["frames_with_diffuse"] == FRAMES
    assert found["frames_with_range_migration"] == found["frames_with_intra_chirp_motion"] == 1
    assert found["frames_with_specular"] == found["frames_with_refraction"] == found["frames_with_noise"] == 0
    assert found["frames_with_near_field"] == FRAMES
    assert all(frame.image_peak > 0.0 for frame in frames(driving))
    row = int(np.abs(frames(driving)[0].range_channel[0]).sum(axis=1).argmax())
    velocity = [float(frame.velocity[0, row]) for frame in frames(driving)]
    step = load_radar(str(driving.parent / "radar.toml")).waveform.velocity_step_mps
    assert velocity[ODD] == pytest.approx(-5.0, abs=step)
    assert velocity[:ODD] + velocity[ODD + 1 :] == [0.0] * (FRAMES - 1)


def test_a_frame_decides_alone(driving: Path, folder: Path) -> None:
    """The moving frame in a run in which all others move too, and faster, is the same frame."""
    poses = [{**pose, "velocity": [11.0, 0.0, 0.0]} for pose in standing_but_one()]
    poses[ODD] = standing_but_one()[ODD]
    others = made(folder, "others", poses, "--workers", 1, "--no-noise")
    other, ours = frames(others)[ODD], frames(driving)[ODD]
    np.testing.assert_array_equal(other.range_channel, ours.range_channel)
    np.testing.assert_array_equal(other.image, ours.image)


def test_frames_that_look_away_leave_out_what_they_do_not_see(folder: Path) -> None:
    """Nineteen frames look away from the car, with only its edges behind them: no pose speaks for another."""
    poses = [{"position": [0.0, 0.0, 0.5], "yaw_deg": 180.0} for _ in range(FRAMES)]
    poses[ODD] = {"position": [0.0, 0.0, 0.5]}
    out = made(folder, "away", poses, "--workers", 1)
    found = counts(out)
    assert found["frames_with_diffuse"] == 1
    assert found["frames_with_diffraction"] == FRAMES  # where there is no first hit nothing may be left out
    assert found["frames_with_refraction"] == 0  # there is no pane
    levels = [frame.image_peak for frame in frames(out)]
    assert levels[ODD] > max(levels[:ODD] + levels[ODD + 1 :])


def test_of_eight_frames_at_a_pane_the_two_that_look_through_it_have_refraction(folder: Path) -> None:
    """Five look away, and one stands behind the pane, before the wall that the two see through it."""
    position = [40.0, 0.0, 0.5]
    poses = [{"position": position, "yaw_deg": yaw} for yaw in (180.0, 0.0, 120.0, -120.0, 2.0, 150.0, -150.0)]
    poses.append({"position": [79.0, 1.0, 0.5]})
    out = made(folder, "pane", poses, "--workers", 1, scene=EFFECT_SCENES / "reflector_behind_pane.usda")
    assert counts(out)["frames"] == len(poses)
    assert counts(out)["frames_with_refraction"] == 2
    behind = [any(39.0 < target.range_m < 41.0 for target in frame.targets) for frame in frames(out)]
    assert behind == [False, True, False, False, True, False, False, False]
