"""The animation of ``trainer predict``: one picture a frame, whole or not there."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from PIL import Image, ImageSequence
from tiny_radar import small_dataset
from tiny_run import make_run
from typer.testing import CliRunner

from shared.physics.errors import InputError
from trainer.cli.app import app
from trainer.run.pictures import save_animation


def predicted(tmp_path, *more: str):
    data, run = tmp_path / "data", tmp_path / "run"
    if not run.exists():
        small_dataset(data, training=2)
        make_run(run)
    arguments = ["predict", str(run), str(data), "--split", "all", "--no-pictures", "--out", str(tmp_path / "out")]
    CliRunner().invoke(app, [*arguments, *more], catch_exceptions=False)
    return tmp_path / "out"


def test_every_frame_is_a_picture_in_its_order(tmp_path):
    out = predicted(tmp_path, "--points", "--animation")
    with Image.open(out / "animation.gif") as film:
        pictures = [np.asarray(picture.convert("RGB")) for picture in ImageSequence.all_frames(film)]
    assert len(pictures) == 5
    assert pictures[0].shape[1] > 2 * 200
    differences = [np.abs(one.astype(int) - other).max() for one, other in itertools.pairwise(pictures)]
    assert min(differences) > 50
    assert save_animation(out / "images.parquet", out / "again.gif") == 5
    assert (out / "again.gif").read_bytes() == (out / "animation.gif").read_bytes()
    assert sorted(path.name for path in out.iterdir()) == ["again.gif", "animation.gif", "images.parquet"]


def test_it_needs_the_list_of_targets(tmp_path):
    out = predicted(tmp_path)
    with pytest.raises(InputError, match=r"images.parquet: no detections; expected a file of trainer predict --points"):
        save_animation(out / "images.parquet", out / "animation.gif")
    assert not (out / "animation.gif").exists()
