"""Datasets elsewhere, on servers of this machine; the one writer: whole files or none, errors name the final file."""

import errno
import json
import os
import pickle
import resource
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pyarrow.fs
import pytest
from s3_server import SECRET
from small_dataset import make_dataset, values
from web_server import web_server

from shared.dataset.folder import open_dataset, verify
from shared.dataset.locations import RemotePath, file_names, folder_name, local, locate, sha256_of
from shared.dataset.reading import open_shard, read_frame
from shared.dataset.writing import PARTIAL, atomic, write_bytes, write_json, write_text
from shared.physics.errors import InputError


@pytest.fixture
def folder(tmp_path):
    """bucket/radar/set: a dataset of three frames, in a folder that stands for a bucket."""
    return make_dataset(tmp_path / "bucket/radar/set")


def test_a_dataset_on_s3_holds_what_the_local_one_holds(folder, server, tmp_path):
    uri = server.upload(folder, f"{tmp_path.name}/set")
    dataset = open_dataset(uri)
    assert values(dataset) == values(open_dataset(folder))
    assert dataset.rows("train")[2][1] == 2
    assert verify(dataset) == []
    shard = folder / "train/part-00000.parquet"
    content = bytearray(shard.read_bytes())
    content[40] ^= 1
    shard.write_bytes(content)
    (folder / "train/part-00009.parquet").write_bytes(b"more")
    faults = verify(open_dataset(server.upload(folder, f"{tmp_path.name}/set")))
    assert [fault.split(":")[0] for fault in faults] == ["train/part-00000.parquet", "train/part-00009.parquet"]


def test_messages_name_the_uri_without_its_secret(folder, server, tmp_path):
    (folder / "train/part-00000.parquet").unlink()
    uri = server.upload(folder, f"{tmp_path.name}/set")
    with pytest.raises(InputError, match=r"s3://bucket/.*/set/train/part-00000.parquet: missing") as caught:
        open_dataset(uri)
    assert SECRET not in str(caught.value)
    with pytest.raises(InputError, match=r"s3://bucket/.*/other/manifest.json: no such file"):
        open_dataset(uri.replace("/set?", "/other?"))


def test_any_filesystem_of_arrow_will_do(folder):
    inner = pyarrow.fs.SubTreeFileSystem(str(folder.parents[1]), pyarrow.fs.LocalFileSystem())
    place = RemotePath(inner, "radar/set", "memory://radar/set")
    assert values(open_dataset(place)) == values(open_dataset(folder))
    assert file_names(place / "train") == ["part-00000.parquet"]
    assert file_names(place / "none") == []
    assert folder_name(place) == "set"
    assert sha256_of(place / "manifest.json") == sha256_of(folder / "manifest.json")


@pytest.mark.parametrize(
    ("given", "told"),
    [("s3://b/set?region=us-east-1", "s3://b/set"), (Path("s3://b/set"), "s3:/b/set")],
    ids=["a URI", "what a command line made a path of"],
)
def test_what_has_to_be_here_is_refused_elsewhere(folder, given, told):
    assert local(str(folder), "--out") == folder
    with pytest.raises(InputError, match=rf"--out: {told} is not on this machine; expected a local folder"):
        local(given, "--out")


def test_a_local_uri_is_the_local_folder(folder):
    assert locate(folder.as_uri()) == folder
    assert locate(str(folder)) == folder
    assert values(open_dataset(folder.as_uri())) == values(open_dataset(folder))


@pytest.mark.parametrize(
    ("uri", "message"),
    [
        ("ftp://host/set", "ftp://host/set: scheme 'ftp'; expected a local path, or one of file, s3, gs, gcs"),
        ("s3://", "s3://: names no bucket; expected s3://BUCKET/FOLDER"),
        ("s3://b/set?endpoint_override=127.0.0.1:9&scheme=http", "s3://b/set/manifest.json: cannot be reach"),
        ("s3://me:secret@b/set", "s3://b/set: credentials in the URI; expected them in the environment: AWS_ACC"),
        ("s3://b/set?endpoint_override=me:secret@host", "s3://b/set: credentials in the URI; expected"),
        ("s3://b/set?access_key=me&secret_key=secret", "s3://b/set: parameter 'access_key' of the URI; expected one"),
        ("gs://b/set?access_token=secret", "gs://b/set: parameter 'access_token' of the URI; expected one of scheme"),
        ("https://me:secret@host/set", r"https://host/set: credentials in the URI; .* ~/.netrc"),
        ("https://host/set?token=secret", "https://host/set: parameter 'token' of the URI; expected none"),
        ("http://host/set", "http://host/set: would be read in the clear; expected https://; http:// only of this"),
        ("hf://OWNER/NAME", "hf://OWNER/NAME: names no dataset; expected hf://datasets/OWNER/NAME or a folder in it"),
        ("hf://datasets/OWNER", "names no dataset"),
        ("http://127.0.0.1:9/set", r"^http://127.0.0.1:9/set/manifest.json: cannot be reached: .*127.0.0.1"),
        (Path("s3://b/set"), "s3:/b/set: a URI as a Path, which drops a slash of it; expected the URI as text"),
    ],
)
def test_a_store_that_is_not_there_is_one_line(uri, message, monkeypatch):
    monkeypatch.setenv("AWS_MAX_ATTEMPTS", "1")
    monkeypatch.setenv("AWS_ACCESS_KEY_ID", "user")
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "secret")
    with pytest.raises(InputError, match=message) as caught:
        open_dataset(uri)
    assert "secret" not in str(caught.value)


@pytest.fixture
def web(folder):
    """``radar/set`` of it is the dataset."""
    with web_server(folder.parents[1]) as (url, handler):
        yield url, handler


def test_a_dataset_on_a_web_server_holds_what_the_local_one_holds(folder, web):
    url, handler = web
    dataset = open_dataset(f"{url}/radar/set/")
    assert values(dataset) == values(open_dataset(folder))
    assert verify(dataset) == []
    (shard, row) = pickle.loads(pickle.dumps(dataset.rows("train")[1]))  # as a worker gets it
    assert np.array_equal(read_frame(shard, row).image, read_frame(folder / "train/part-00000.parquet", 1).image)
    assert set(handler.asked) == {"radar/set/manifest.json", "radar/set/train/part-00000.parquet"}  # nothing is listed


def test_what_a_web_server_lacks_is_one_line(folder, web):
    url, handler = web
    with pytest.raises(InputError, match=rf"^{url}/radar/none/manifest.json: no such file; expected"):
        open_dataset(f"{url}/radar/none")
    handler.denied = "manifest"
    with pytest.raises(InputError, match=rf"^{url}/radar/set/manifest.json: cannot be reached: .*403"):
        open_dataset(f"{url}/radar/set")


def test_a_web_server_without_ranges_is_one_line(folder, web):
    url, handler = web
    handler.ranges = False
    shard = folder / "train/part-00000.parquet"
    shard.write_bytes(shard.read_bytes() + bytes(6 << 20))  # more than is fetched at a time
    with pytest.raises(InputError, match=r"part-00000\.parquet: not readable as Parquet: .*range requests"):
        open_shard(locate(f"{url}/radar/set/train/part-00000.parquet"))


@pytest.mark.parametrize(
    ("uri", "module", "message"),
    [
        ("https://host/set", "fsspec.implementations.http", "https://host/set: needs fsspec and aiohttp; expected pip"),
        ("hf://datasets/OWNER/set", "huggingface_hub", "OWNER/set: needs huggingface_hub; expected pip inst"),
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
    places = [str(folder), *(f"hf://datasets/{name}" for name in ("radar/set", "radar/set/deeper", "radar/other"))]
    hub = {"HF_ENDPOINT": web[0], "HF_HOME": str(tmp_path / "home"), "HF_HUB_DISABLE_TELEMETRY": "1"}
    command = [sys.executable, "-c", FRAMES, *places]
    done = subprocess.run(command, env={**os.environ, **hub}, capture_output=True, text=True, check=False, timeout=200)
    assert done.returncode == 0, done.stderr
    local, remote, deeper, other = done.stdout.strip().splitlines()
    assert remote == local
    assert deeper.startswith("hf://datasets/radar/set/deeper/manifest.json: no such file")
    assert other.startswith("hf://datasets/radar/other/manifest.json: ")


@contextmanager
def disk_of(size: int) -> Iterator[None]:
    """No file may grow beyond ``size`` bytes: every write past it fails, as on a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_a_file_is_not_seen_before_it_is_whole(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    with atomic(path) as partial:
        assert partial == tmp_path / f"table.csv{PARTIAL}"
        partial.write_bytes(b"half")
        assert not path.exists()
    assert path.read_bytes() == b"half"
    assert [entry.name for entry in tmp_path.iterdir()] == ["table.csv"]


def test_the_content_is_on_the_disk_before_the_name_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    steps = []
    flush, rename = os.fsync, Path.replace

    def flushed(handle: int) -> None:
        steps.append("flush")
        flush(handle)

    def renamed(self: Path, target: Path) -> Path:
        steps.append("rename")
        return rename(self, target)

    monkeypatch.setattr(os, "fsync", flushed)
    monkeypatch.setattr(Path, "replace", renamed)
    write_bytes(tmp_path / "x", b"content")
    assert steps == ["flush", "rename"]


@pytest.mark.parametrize("failure", [RuntimeError("the solver failed"), KeyboardInterrupt(), OSError(28, "No space")])
def test_a_body_that_fails_leaves_what_was_there(tmp_path: Path, failure: BaseException) -> None:
    path = tmp_path / "shard"
    path.write_bytes(b"old")

    def attempt() -> None:
        with atomic(path) as partial:
            partial.write_bytes(b"new")
            raise failure

    with pytest.raises(type(failure)):
        attempt()
    assert {entry.name: entry.read_bytes() for entry in tmp_path.iterdir()} == {"shard": b"old"}


def test_a_full_disk_names_the_final_file_and_leaves_nothing(tmp_path: Path) -> None:
    path = tmp_path / "out.json"
    with disk_of(500), pytest.raises(OSError, match="File too large") as caught:
        write_json(path, {"long": "x" * 10_000})
    assert (caught.value.errno, caught.value.filename) == (errno.EFBIG, str(path))
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_is_missing_or_a_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError) as missing:
        write_text(tmp_path / "none" / "x", "text")
    assert missing.value.filename == str(tmp_path / "none" / "x")
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(NotADirectoryError) as no_folder:
        write_text(tmp_path / "file" / "x", "text")
    assert no_folder.value.filename == str(tmp_path / "file" / "x")


def test_a_killed_writer_leaves_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "manifest.json"
    path.write_bytes(b"old")
    script = f"""
import os, signal
from pathlib import Path
from shared.dataset.writing import atomic
with atomic(Path({str(path)!r})) as partial:
    partial.write_bytes(b"new")
    os.kill(os.getpid(), signal.SIGKILL)
"""
    killed = subprocess.run([sys.executable, "-c", script], capture_output=True, check=False, timeout=60)
    assert killed.returncode == -signal.SIGKILL, killed.stderr.decode()
    assert path.read_bytes() == b"old"
    assert path.with_name(f"manifest.json{PARTIAL}").read_bytes() == b"new"


def test_json_is_sorted_indented_and_free_of_nan(tmp_path: Path) -> None:
    path = tmp_path / "x.json"
    write_json(path, {"b": "ü", "a": [1.5, None]})
    assert path.read_bytes() == b'{\n "a": [\n  1.5,\n  null\n ],\n "b": "\\u00fc"\n}\n'
    with pytest.raises(ValueError, match="not JSON compliant"):
        write_json(path, {"a": float("nan")})
    assert json.loads(path.read_bytes())["b"] == "ü"
    write_json(path, {"b": 1, "a": 2}, sort_keys=False)
    assert path.read_bytes() == b'{\n "b": 1,\n "a": 2\n}\n'
