"""Folders of shards: read by split, verified against their manifest, and manifests that are not as they should be."""

import hashlib
import json
from pathlib import Path

import numpy as np
import pytest
from small_dataset import make_dataset, make_frame, make_traced, write

from shared.dataset.folder import open_dataset, verify
from shared.dataset.reading import read_frame, read_frames
from shared.physics.errors import InputError

SHARDS = {"train/part-00000": (0, 1), "train/part-00001": (2,), "test/part-00000": (3,)}


def edit_manifest(folder: Path, **changes) -> None:
    manifest = json.loads((folder / "manifest.json").read_text()) | changes
    (folder / "manifest.json").write_text(json.dumps(manifest))


def test_a_folder_of_traced_paths_is_verified_and_says_that_it_holds_no_frames(tmp_path):
    dataset = open_dataset(make_traced(tmp_path))
    assert dataset.splits == {}
    assert verify(dataset) == []
    expected = "holds traced paths and no frames; expected a dataset, as made by datafactory render --paths"
    for ask in (dataset.description, lambda: dataset.shards("test"), lambda: dataset.rows("train")):
        with pytest.raises(InputError, match=expected):
            ask()


def test_a_dataset_is_read_split_by_split(tmp_path):
    dataset = open_dataset(make_dataset(tmp_path, SHARDS))
    assert [frame.frame_id for frame in dataset.frames("train")] == [0, 1, 2]
    assert [read_frame(*place).frame_id for place in dataset.rows("train")] == [0, 1, 2]
    assert list(dataset.splits) == ["train", "test"]
    assert verify(dataset) == []
    with pytest.raises(InputError, match=r"no frames in split 'validation'; expected one of \['train', 'test'\]"):
        next(dataset.frames("validation"))


def test_verify_finds_one_flipped_bit_anywhere(tmp_path):
    shard = make_dataset(tmp_path, SHARDS) / "train/part-00001.parquet"
    content = shard.read_bytes()
    for place in np.linspace(0, len(content) - 1, 9).astype(int):
        damaged = bytearray(content)
        damaged[place] ^= 1
        shard.write_bytes(damaged)
        (fault,) = verify(open_dataset(tmp_path))
        assert fault.startswith("train/part-00001.parquet: sha256 is ")


def test_a_truncated_or_missing_shard_is_named(tmp_path):
    shard = make_dataset(tmp_path, SHARDS) / "train/part-00001.parquet"
    size = shard.stat().st_size
    shard.write_bytes(shard.read_bytes()[:-7])
    with pytest.raises(InputError, match=rf"part-00001\.parquet: {size - 7} bytes; the manifest says {size}"):
        open_dataset(tmp_path)
    assert len(verify(open_dataset(tmp_path, check_sizes=False))) == 1
    with pytest.raises(InputError, match=rf"part-00001\.parquet: {size - 7} bytes; the manifest says {size}"):
        list(read_frames(shard))
    alone = tmp_path / "alone.parquet"
    alone.write_bytes(shard.read_bytes())
    with pytest.raises(InputError, match=r"alone\.parquet: not readable as Parquet"):
        list(read_frames(alone))
    shard.unlink()
    with pytest.raises(InputError, match=r"part-00001\.parquet: missing"):
        open_dataset(tmp_path)
    assert verify(open_dataset(tmp_path, check_sizes=False)) == [
        "train/part-00001.parquet: missing; the manifest names it"
    ]


def test_verify_finds_strangers_and_other_schemas(tmp_path):
    make_dataset(tmp_path, SHARDS)
    (tmp_path / "train/part-00009.parquet").write_bytes(b"")
    other = tmp_path / "test/part-00000.parquet"
    write(other, [make_frame(3)], note="from another run")
    manifest = json.loads((tmp_path / "manifest.json").read_text())
    digest = hashlib.sha256(other.read_bytes()).hexdigest()
    manifest["shards"][2] |= {"bytes": other.stat().st_size, "sha256": digest}
    manifest["shards"][0]["rows"] = 5
    edit_manifest(tmp_path, **manifest)
    assert verify(open_dataset(tmp_path)) == [
        "train/part-00000.parquet: 2 rows; the manifest says 5",
        "test/part-00000.parquet: its schema differs from that of the first shard",
        "train/part-00009.parquet: not in the manifest",
    ]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (None, "no such file"),
        ("{", "not readable as JSON"),
        ("[1]", "version = None"),
        ('{"version": 2}', "made by a newer version: version 2; this reads up to 1; upgrade"),
        ('{"version": "1"}', "version = '1'"),
        ('{"version": 1}', "no list of shards"),
        ('{"version": 1, "shards": [{"path": "../x", "rows": 1, "bytes": 1, "sha256": ""}]}', r"shards\.0\.path"),
    ],
)
def test_a_manifest_that_is_not_right_is_refused_in_one_line(tmp_path, text, message):
    if text is not None:
        (tmp_path / "manifest.json").write_text(text)
    with pytest.raises(InputError, match=message) as caught:
        open_dataset(tmp_path)
    assert "manifest.json" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_file_in_place_of_a_dataset_is_said_to_be_one(tmp_path):
    (tmp_path / "data.parquet").write_bytes(b"")
    with pytest.raises(InputError, match=r"data\.parquet: is a file; expected the folder of a finished dataset"):
        open_dataset(tmp_path / "data.parquet")
