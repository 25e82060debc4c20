"""``trainer fit --frames``: the first frames of each dataset, so that one world and eight give as many."""

import json
from dataclasses import replace
from typing import Any

import pytest
from tiny_radar import frame, tiny, write_dataset

from shared.physics.errors import InputError
from trainer.data.shards import ShardDataset
from trainer.run.folder import read_run
from trainer.training.datamodule import ImagingData
from trainer.training.fit import FitRequest, fit

BESIDES: dict[str, Any] = {"workers": 0, "check": False, "logger": "none"}


def city(directory, frames=16):
    """Every fourth frame is for validation."""
    ids = range(frames)
    return write_dataset(
        directory,
        {
            "train": [frame(index) for index in ids if index % 4 != 3],
            "validation": [frame(index) for index in ids if index % 4 == 3],
        },
    )


def ids(frames):
    return [int(frames[index]["frame_id"]) for index in range(len(frames))]


def test_the_first_frames_are_those_of_small_index_in_every_split(tmp_path):
    folder = city(tmp_path / "city")
    assert ids(ShardDataset(folder, "train", first=8)) == [0, 1, 2, 4, 5, 6]
    assert ids(ShardDataset(folder, "validation", first=8)) == [3, 7]
    assert len(ShardDataset(folder, "train")) == len(ShardDataset(folder, "train", first=16)) == 12


def test_one_world_and_four_give_as_many_frames(tmp_path):
    cities = [city(tmp_path / f"city-{index}") for index in range(4)]
    one = ImagingData(cities[:1], None, tiny(frames=16))
    four = ImagingData(cities, None, tiny(frames=4))
    assert [len(part) for part in one.training] == [12]
    assert [len(part) for part in four.training] == [3, 3, 3, 3]
    assert len(one.validation) == len(four.validation) == 4
    assert [fingerprint.frames for fingerprint in four.fingerprints] == [{"train": 3, "validation": 1, "test": 0}] * 4


@pytest.mark.parametrize(("first", "seen"), [(0, ["a", "b"]), (4, ["a"]), (8, ["a", "b"])])
def test_the_scenes_of_a_run_are_those_of_frames_that_train_or_validate(tmp_path, first, seen):
    frames = [replace(frame(index), kind="scene", scene="b" if index == 7 else "a") for index in range(8)]
    tested = [replace(frame(8), kind="scene", scene="tested alone")]
    folder = write_dataset(tmp_path / "data", {"train": frames[:3], "validation": frames[3:], "test": tested})
    scenes = [{"name": name, "content_sha256": name} for name in ("a", "b", "tested alone")]
    manifest = json.loads((folder / "manifest.json").read_text())
    (folder / "manifest.json").write_text(json.dumps({**manifest, "scenes": scenes}))
    (fingerprint,) = ImagingData([folder], None, tiny(frames=first)).fingerprints
    assert fingerprint.scenes is not None
    assert [scene.name for scene in fingerprint.scenes] == seen


def test_too_few_frames_are_refused(tmp_path):
    folder = city(tmp_path / "city")
    with pytest.raises(InputError, match="no frames in split 'validation' among the first 3 frames"):
        ImagingData([folder], None, tiny(frames=3))
    late = write_dataset(tmp_path / "late", {"train": [frame(9)], "validation": [frame(0)]})
    with pytest.raises(InputError, match="no frame of split 'train' among the first 3"):
        ImagingData([late], None, tiny(frames=3))
    # One dataset of several may be without.
    without = write_dataset(tmp_path / "without", {"train": [frame(0)]})
    data = ImagingData([without, folder], None, tiny(frames=4))
    assert len(data.validation) == 1


def test_the_run_says_what_it_has_seen_and_goes_on_with_it_alone(tmp_path):
    folder = city(tmp_path / "city")
    fit(FitRequest([folder], tmp_path / "run", tiny(frames=4, steps=2), "full", **BESIDES), str)
    run = read_run(tmp_path / "run")
    assert run.config.frames == 4
    assert run.datasets[0].frames == {"train": 3, "validation": 1, "test": 0}
    assert run.datasets[0].scenes is None
    with pytest.raises(InputError, match=r"frames is 8, but the run in .* had 4"):
        fit(FitRequest([folder], tmp_path / "run", tiny(frames=8, steps=2), "full", resume=True, **BESIDES), str)


def test_the_same_frames_and_seed_are_the_same_weights(tmp_path):
    """What lies behind the first frames changes nothing."""
    long, short = city(tmp_path / "long", 16), city(tmp_path / "short", 8)
    for name, folder, frames, seed in (("a", long, 8, 3), ("b", short, 0, 3), ("c", long, 8, 4)):
        fit(FitRequest([folder], tmp_path / name, tiny(frames=frames, steps=2, seed=seed), "full", **BESIDES), str)
    weights = {name: (tmp_path / name / "weights.safetensors").read_bytes() for name in "abc"}
    assert weights["a"] == weights["b"] != weights["c"]
