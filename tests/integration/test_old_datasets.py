"""Datasets of code before this one are read as they are; columns that came later say that nothing is known.

Each of tests/old_datasets was made by the commit of its name; the first had no columns time, sequence and boxes:

    datafactory render scenes/tiny.usda --radar tests/old_datasets/radar.toml --frames 1 --points 1 --split 1:0:0 \
        --seed 1 --rays 2000 --out DIR
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from factory_command import run

from shared.dataset.folder import open_dataset
from shared.dataset.reading import read_frame
from shared.radar import load_radar
from trainer.data.dataset import RadarDataset

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
