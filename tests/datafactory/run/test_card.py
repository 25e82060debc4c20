"""The dataset's card: the same for equal runs, of every column a line, read by Hugging Face's library as it stands."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from datafactory import render
from datafactory.run.card import COLUMNS, card, hub_licence, scene_licence, stated_licence
from shared.dataset import arrow_schema
from shared.dataset.folder import open_dataset
from shared.physics.errors import InputError
from shared.radar import Radar
from shared.radar.waveform import Waveform

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
    assert json.loads((dataset / "manifest.json").read_text())["license"] == "CC-BY-4.0"


def test_without_a_licence_the_card_says_so(tmp_path: Path) -> None:
    render(None, tmp_path / "data", frames=0, points=1, radar=RADAR)
    assert front_matter(tmp_path / "data")["license"] == "unknown"
    assert "--license" in (tmp_path / "data" / "README.md").read_text()
    assert "license" not in json.loads((tmp_path / "data" / "manifest.json").read_text())["arguments"]


def test_columns_scenes_effects_and_licences_are_told(dataset: Path) -> None:
    text = (dataset / "README.md").read_text(encoding="utf-8")
    for field in arrow_schema(open_dataset(dataset).description()):
        assert f"| `{field.name}` |" in text
        assert COLUMNS[field.name] in text
    assert "3 x 40 x 48 x 2 (Doppler peak, range, channel, re/im)" in text
    manifest = json.loads((dataset / "manifest.json").read_text())
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
