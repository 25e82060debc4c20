"""Datasets on a web server and in a repository of Hugging Face, both stood for by a server on this machine."""

import os
import pickle
import subprocess
import sys

import numpy as np
import pytest
from small_dataset import make_dataset, values
from web_server import web_server

from shared.dataset.folder import open_dataset, verify
from shared.dataset.locations import locate
from shared.dataset.reading import open_shard, read_frame
from shared.physics.errors import InputError


@pytest.fixture
def folder(tmp_path):
    """OWNER/set: a dataset of three frames."""
    return make_dataset(tmp_path / "OWNER/set")


@pytest.fixture
def web(folder):
    with web_server(folder.parents[1]) as (url, handler):
        yield url, handler


def test_a_dataset_on_a_web_server_holds_what_the_local_one_holds(folder, web):
    url, handler = web
    dataset = open_dataset(f"{url}/OWNER/set/")
    assert values(dataset) == values(open_dataset(folder))
    assert verify(dataset) == []
    (shard, row) = pickle.loads(pickle.dumps(dataset.rows("train")[1]))  # as a worker gets it
    assert np.array_equal(read_frame(shard, row).image, read_frame(folder / "train/part-00000.parquet", 1).image)
    assert set(handler.asked) == {"OWNER/set/manifest.json", "OWNER/set/train/part-00000.parquet"}  # nothing is listed


def test_what_a_web_server_lacks_is_one_line(folder, web):
    url, handler = web
    with pytest.raises(InputError, match=rf"^{url}/OWNER/none/manifest.json: no such file; expected"):
        open_dataset(f"{url}/OWNER/none")
    handler.denied = "manifest"
    with pytest.raises(InputError, match=rf"^{url}/OWNER/set/manifest.json: cannot be reached: .*403") as caught:
        open_dataset(f"{url}/OWNER/set")
    assert "\n" not in str(caught.value)


def test_a_web_server_without_ranges_is_one_line(folder, web):
    url, handler = web
    handler.ranges = False
    shard = folder / "train/part-00000.parquet"
    shard.write_bytes(shard.read_bytes() + bytes(6 << 20))  # more than is fetched at a time
    with pytest.raises(InputError, match=r"part-00000\.parquet: not readable as Parquet: .*range requests"):
        open_shard(locate(f"{url}/OWNER/set/train/part-00000.parquet"))


def test_a_web_server_that_does_not_answer_is_one_line():
    with pytest.raises(InputError, match=r"^http://127.0.0.1:9/set/manifest.json: cannot be reached: .*127.0.0.1"):
        open_dataset("http://127.0.0.1:9/set")


@pytest.mark.parametrize(
    ("uri", "module", "message"),
    [
        (
            "https://host/set",
            "fsspec.implementations.http",
            "https://host/set: needs fsspec and aiohttp; expected pip in",
        ),
        (
            "hf://datasets/OWNER/set",
            "huggingface_hub",
            "hf://datasets/OWNER/set: needs huggingface_hub; expected pip inst",
        ),
    ],
)
def test_a_package_that_is_missing_is_one_line(uri, module, message, monkeypatch):
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(InputError, match=message):
        locate(uri)


FRAMES = """
import hashlib, sys
from shared.dataset.folder import open_dataset, verify
from shared.physics.errors import InputError

for uri in sys.argv[1:]:
    try:
        dataset = open_dataset(uri)
        assert verify(dataset) == []
        print(hashlib.sha256(b"".join(frame.image.tobytes() for frame in dataset.frames("train"))).hexdigest())
    except InputError as error:
        print(error)
"""


def test_a_dataset_of_hugging_face_holds_what_the_local_one_holds(folder, web, tmp_path):
    """In a process of its own: the hub's address is read from the environment once."""
    places = [str(folder), *(f"hf://datasets/{name}" for name in ("OWNER/set", "OWNER/set/deeper", "OWNER/other"))]
    surroundings = {
        **os.environ,
        "HF_ENDPOINT": web[0],
        "HF_HOME": str(tmp_path / "home"),
        "HF_HUB_DISABLE_TELEMETRY": "1",
    }
    done = subprocess.run(
        [sys.executable, "-c", FRAMES, *places],
        env=surroundings,
        capture_output=True,
        text=True,
        check=False,
        timeout=200,
    )
    assert done.returncode == 0, done.stderr
    local, remote, deeper, other = done.stdout.strip().splitlines()
    assert remote == local
    assert deeper.startswith("hf://datasets/OWNER/set/deeper/manifest.json: no such file")
    assert other.startswith("hf://datasets/OWNER/other/manifest.json: ")
