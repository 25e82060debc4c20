"""Twenty cities, four of each style: nothing is in anything else, no sensor is within anything, each renders."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scene_solids import city_solids
from solids import Standing, containing, intersecting

import datafactory
from datafactory.scenes.boxes import Movers
from datafactory.scenes.city.city import city
from datafactory.scenes.city.rules import Style
from datafactory.scenes.city.usd import write_usd
from datafactory.scenes.drives import Drives, draw_drive
from datafactory.scenes.ground import free_ground
from datafactory.scenes.poses import Pose, sample_pose
from datafactory.scenes.readers.open import open_scene
from datafactory.scenes.scene import Scene
from shared.dataset.folder import SPLITS, open_dataset

SEEDS = range(4)
RAYS = 2000
CLEAR_M = 1.0
"""So far the boresight is open: further than anything that would blind the radar."""
RADAR = """
[waveform]
chirps = 8
samples = 128
range_bins = 100
[grid]
bins = 40
"""


def poses_of(scene: Scene) -> list[Pose]:
    """Three drawn ones, and a drive of ten."""
    ground, rng = free_ground(scene), np.random.default_rng(1)
    drive = draw_drive(ground, Movers(scene), "train", Drives(seconds=2.0, rate_hz=5.0), rng)
    assert len(drive) == 10
    return [*(sample_pose(ground, split, rng) for split in SPLITS), *drive]


def hold_outside_and_open(standing: list[Standing], pose: Pose) -> None:
    """No point of the first metre ahead is within anything."""
    for point in np.asarray(pose.position) + np.linspace(0.0, CLEAR_M, 11)[:, None] * pose.rotation()[:, 0]:
        assert containing(standing, point) == [], pose


@pytest.mark.slow
@pytest.mark.parametrize("style", list(Style))
def test_cities_are_solid_and_render(style: Style, tmp_path: Path) -> None:
    (tmp_path / "small.toml").write_text(RADAR, encoding="utf-8")
    scenes, solids = [], {}
    for seed in SEEDS:
        placements = city(seed=seed, style=style, blocks=1)
        write_usd(tmp_path / f"city{seed}.usdc", placements, "a city")
        scenes.append(open_scene(str(tmp_path / f"city{seed}.usdc")))
        solids[scenes[-1].name] = city_solids(placements)
        assert intersecting(solids[scenes[-1].name]) == []
        for pose in poses_of(scenes[-1]):
            assert 0.4 < pose.position[2] < 0.9  # on the ground, on pavements and islands too
            hold_outside_and_open(solids[scenes[-1].name], pose)
    datafactory.render(
        scenes, tmp_path / "data", radar=tmp_path / "small.toml", frames=len(scenes), rays=RAYS,
        effects="specular,diffuse,doppler",
    )  # fmt: skip
    dataset = open_dataset(tmp_path / "data")
    frames = [frame for split in dataset.splits for frame in dataset.frames(split)]
    assert sorted(frame.scene for frame in frames) == sorted(solids)
    for frame in frames:
        assert frame.image_peak > 0.0
        assert frame.targets
        assert containing(solids[frame.scene], frame.sensor_position) == []
