"""Shards on disk: plans, files and their notes, folders that a run leaves alone; the dataset's card."""

import hashlib
import json
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import pyarrow.parquet as pq
import pytest
import yaml
from small_dataset import PEAKS, RADAR, make_frame

from datafactory import render
from datafactory.frame.draws import split_of
from datafactory.run import progress
from datafactory.run.card import COLUMNS, card, hub_licence, scene_licence, stated_licence
from datafactory.run.shards import ShardPlan, plan_shards, write_shard
from shared.dataset import VERSION, arrow_schema, description
from shared.dataset.folder import open_dataset, read_manifest
from shared.dataset.reading import read_frames
from shared.physics.errors import InputError
from shared.radar import Radar
from shared.radar.waveform import Waveform

SCHEMA = arrow_schema(description(RADAR, PEAKS, "range-channel"))


def begun(directory: Path, resume: bool = False) -> None:
    with progress.claimed(directory, resume):
        progress.begin(directory, {}, resume)


def test_shards_hold_every_frame_once_and_one_split_each():
    plans = plan_shards([split_of(index) for index in range(30)], frames_per_shard=8)
    assert sorted(index for plan in plans for index in plan.frame_ids) == list(range(30))
    assert all(split_of(index) == plan.split for plan in plans for index in plan.frame_ids)
    assert [(plan.path, len(plan.frame_ids)) for plan in plans] == [
        ("train/part-00000.parquet", 8),
        ("train/part-00001.parquet", 8),
        ("train/part-00002.parquet", 8),
        ("validation/part-00000.parquet", 3),
        ("test/part-00000.parquet", 3),
    ]
    with pytest.raises(ValueError, match="split 'dev'"):
        plan_shards(["dev"])


def test_a_shard_is_what_its_record_says_in_the_encoding_that_was_measured(tmp_path):
    """The encoding that the figures in ``shards.py`` are about is the one in the file."""
    path = tmp_path / "train/part-00003.parquet"
    record = write_shard(path, map(make_frame, (4, 5, 6)), SCHEMA)
    content = path.read_bytes()
    assert record.model_dump() == {
        "path": "train/part-00003.parquet",
        "rows": 3,
        "bytes": len(content),
        "sha256": hashlib.sha256(content).hexdigest(),
    }
    assert [frame.frame_id for frame in read_frames(path)] == [4, 5, 6]
    assert pq.read_schema(path).equals(SCHEMA, check_metadata=True)
    metadata = pq.read_metadata(path)
    assert metadata.num_row_groups == 3
    group = metadata.row_group(0)
    columns = {column.path_in_schema: column for column in map(group.column, range(group.num_columns))}
    for name in ("range_channel", "image", "velocity"):
        column = columns[f"{name}.list.element"]
        assert "BYTE_STREAM_SPLIT" in column.encodings
        assert column.compression == "LZ4"
    assert columns["frame_id"].statistics.min == 4


def test_a_shard_counts_as_finished_where_it_and_its_note_are_as_they_were_written(tmp_path):
    begun(tmp_path)
    plans = plan_shards(["train"] * 12, frames_per_shard=3)
    for plan in plans:
        record = write_shard(tmp_path / plan.path, map(make_frame, plan.frame_ids), SCHEMA)
        finished = progress.FinishedShard(record=record, counts={"left_out": 3}, fingerprint="made so")
        progress.record_finished(tmp_path, plan, finished)
    whole, *damaged = plans
    found = progress.completed(tmp_path, plans, "made so")
    assert (set(found.shards), found.damaged) == (set(plans), ())
    assert found.shards[whole].counts == {"left_out": 3}
    flipped = bytearray((tmp_path / damaged[0].path).read_bytes())
    flipped[100] ^= 1
    (tmp_path / damaged[0].path).write_bytes(flipped)
    (tmp_path / damaged[1].path).unlink()
    (tmp_path / ".progress/train-part-00003.json").write_text("{")
    found = progress.completed(tmp_path, plans, "made so")
    assert (set(found.shards), found.damaged) == ({whole}, tuple(plan.path for plan in damaged))
    # Nor does one of other arguments, or of other frames.
    assert progress.completed(tmp_path, [whole], "another").shards == {}
    longer = ShardPlan("train", 0, (0, 1, 2, 3))
    assert progress.completed(tmp_path, [longer], "made so").damaged == (whole.path,)


def test_a_finished_dataset_is_complete_where_its_shards_are_as_the_manifest_says(tmp_path):
    """To say so of a lost shard would send whoever trains on the rest."""
    begun(tmp_path)
    records = [write_shard(tmp_path / f"train/part-0000{i}.parquet", [make_frame(i)], SCHEMA) for i in range(3)]
    manifest = {"arguments": {}, "shards": [record.model_dump() for record in records]}
    progress.finish(tmp_path, {"version": VERSION, **manifest})
    begun(tmp_path, resume=True)
    flipped = bytearray((tmp_path / records[1].path).read_bytes())
    flipped[100] ^= 1
    (tmp_path / records[1].path).write_bytes(flipped)
    said = r"--resume: .* was finished; missing or not as manifest\.json says: train/part-00001\.parquet; expected"
    with pytest.raises(InputError, match=said):
        begun(tmp_path, resume=True)
    (tmp_path / records[0].path).unlink()
    with pytest.raises(InputError, match=r"says: train/part-00000\.parquet, and 1 more; expected"):
        begun(tmp_path, resume=True)


def test_a_folder_with_something_in_it_is_left_alone(tmp_path):
    (tmp_path / "thesis.tex").write_text("mine")
    with pytest.raises(InputError, match=r"--out: .* is not empty; expected an empty or new folder, or --resume"):
        begun(tmp_path)
    with pytest.raises(InputError, match=r"--out: .* is not empty and holds no unfinished run"):
        begun(tmp_path, resume=True)
    assert [path.name for path in tmp_path.rglob("*") if path.is_file()] == ["thesis.tex"]


def test_a_folder_that_cannot_be_written_is_refused_before_any_work(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match=r"--out: .*Not a directory; expected a folder that can be written"):
        begun(tmp_path / "file" / "out")

    def read_only(dir):
        raise OSError(30, "Read-only file system")

    # Root may write into folders of mode 555, so the file system's answer is played.
    monkeypatch.setattr(tempfile, "TemporaryFile", read_only)
    with pytest.raises(InputError, match=r"--out: .*Read-only file system"):
        begun(tmp_path / "out")


RADAR = Radar(waveform=Waveform(chirps=4, samples=64, range_bins=40))


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("card") / "points"
    render(None, out, frames=0, points=9, radar=RADAR, license="cc-by-4.0")
    return out


def front_matter(folder: Path) -> dict:
    _, matter, _ = (folder / "README.md").read_text(encoding="utf-8").split("---\n", 2)
    return yaml.safe_load(matter)


def test_the_front_matter_names_splits_licence_and_size(dataset: Path) -> None:
    matter = front_matter(dataset)
    assert matter["license"] == "cc-by-4.0"
    assert matter["size_categories"] == ["n<1K"]
    assert {"radar", "synthetic"} <= set(matter["tags"])
    (config,) = matter["configs"]
    assert config["data_files"] == [
        {"split": split, "path": f"{split}/*.parquet"} for split in ("train", "validation", "test")
    ]
    assert read_manifest(dataset)["license"] == "CC-BY-4.0"


def test_without_a_licence_the_card_says_so(tmp_path: Path) -> None:
    render(None, tmp_path / "data", frames=0, points=1, radar=RADAR)
    assert front_matter(tmp_path / "data")["license"] == "unknown"
    assert "--license" in (tmp_path / "data" / "README.md").read_text()
    assert "license" not in read_manifest(tmp_path / "data")["arguments"]


def test_columns_scenes_effects_and_licences_are_told(dataset: Path) -> None:
    text = (dataset / "README.md").read_text(encoding="utf-8")
    for field in arrow_schema(open_dataset(dataset).description()):
        assert f"| `{field.name}` |" in text
        assert COLUMNS[field.name] in text
    assert "3 x 40 x 48 x 2 (Doppler peak, range, channel, re/im)" in text
    manifest = read_manifest(dataset)
    manifest["scenes"] = [
        {"name": "street", "content_sha256": "ab" * 32, "source": "shipped:street"},
        {"name": "mine", "content_sha256": "cd" * 32, "source": "/home/somebody/mine.usda"},
    ]
    manifest["counts"] |= {"frames_with_diffraction": 4, "frames_with_refraction": 0}
    text = card(manifest)
    assert "| street | `abababababababab` | Apache-2.0, as this software |" in text
    assert "| mine | `cdcdcdcdcdcdcdcd` | not known here: its author's |" in text
    assert "somebody" not in text  # where a file lay is nobody's business
    assert "| diffraction | 4 |" in text
    assert "- refraction: in none of the scene frames." in text
    assert hub_licence(stated_licence("odbl-1.0")) == ("odbl", None)
    assert hub_licence(stated_licence("LicenseRef-Ours")) == ("other", "licenseref-ours")
    assert hub_licence(stated_licence(None)) == ("unknown", None)
    assert scene_licence("sionna:munich").startswith("ODbL-1.0")
    with pytest.raises(InputError, match=r"--license: 'free': .*; expected an SPDX identifier"):
        stated_licence("free")


READ = """
{snippet}
import json, sys
from datasets import load_dataset
everything = load_dataset(folder)
print(json.dumps([image.shape, signal.shape, str(signal.dtype), boxes,
                  {{name: split["frame_id"][:] for name, split in everything.items()}}]))
"""


def test_hugging_faces_library_reads_the_splits_and_the_snippet_runs(dataset: Path, tmp_path: Path) -> None:
    """Offline, in a process of its own; strangers in the folder, ``paths`` among them, are no data."""
    (dataset / "paths").mkdir(exist_ok=True)
    (dataset / "paths" / "part-00000.parquet").write_bytes(b"no rows")
    snippet = re.search(r"```python\n(.*?)```", (dataset / "README.md").read_text(encoding="utf-8"), re.DOTALL)
    assert snippet is not None
    environment = {"HF_HOME": str(tmp_path), "HF_HUB_OFFLINE": "1", "HF_DATASETS_OFFLINE": "1"}
    done = subprocess.run(
        [sys.executable, "-c", READ.format(snippet=snippet[1])],
        cwd=dataset, env={**os.environ, **environment}, capture_output=True, text=True, check=False, timeout=300,
    )  # fmt: skip
    (dataset / "paths" / "part-00000.parquet").unlink()
    assert done.returncode == 0, done.stderr[-800:]
    image, signal, kind, boxes, splits = json.loads(done.stdout.splitlines()[-1])
    assert (image, signal, kind, boxes) == ([40, 450], [3, 40, 48], "complex64", [])
    assert splits == {"train": [0, 1, 2, 3, 4, 5, 8], "validation": [6], "test": [7]}
