"""Datasets on object storage: an S3 server on this machine, a filesystem of Arrow's, and what is refused."""

from pathlib import Path

import pyarrow.fs
import pytest
from s3_server import SECRET
from small_dataset import make_dataset, values

from shared.dataset.folder import open_dataset, verify
from shared.dataset.locations import RemotePath, file_names, folder_name, local, locate, sha256_of
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


def test_what_has_to_be_here_is_refused_elsewhere(folder):
    assert local(str(folder), "--out") == folder
    with pytest.raises(InputError, match=r"--out: s3://b/set is not on this machine; expected a local folder"):
        local("s3://b/set?region=us-east-1", "--out")


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
        (
            "s3://me:secret@b/set",
            "s3://b/set: credentials in the URI; expected them in the environment: AWS_ACCESS_KEY",
        ),
        ("s3://b/set?endpoint_override=me:secret@host", "s3://b/set: credentials in the URI; expected"),
        (
            "s3://b/set?access_key=me&secret_key=secret",
            "s3://b/set: parameter 'access_key' of the URI; expected one of",
        ),
        ("gs://b/set?access_token=secret", "gs://b/set: parameter 'access_token' of the URI; expected one of scheme"),
        ("https://me:secret@host/set", r"https://host/set: credentials in the URI; .* ~/.netrc"),
        ("https://host/set?token=secret", "https://host/set: parameter 'token' of the URI; expected none"),
        (
            "http://host/set",
            "http://host/set: would be read in the clear; expected https://; http:// only of this machi",
        ),
        ("hf://OWNER/NAME", "hf://OWNER/NAME: names no dataset; expected hf://datasets/OWNER/NAME or a folder in it"),
        ("hf://datasets/OWNER", "names no dataset"),
        (Path("s3://b/set"), "s3:/b/set: a URI as a Path, which drops a slash of it; expected the URI as text"),
    ],
)
def test_a_store_that_is_not_there_is_one_line(uri, message, monkeypatch):
    monkeypatch.setenv("AWS_MAX_ATTEMPTS", "1")
    monkeypatch.setenv("AWS_ACCESS_KEY_ID", "user")
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "secret")
    with pytest.raises(InputError, match=message) as caught:
        open_dataset(uri)
    assert "\n" not in str(caught.value)
    assert "secret" not in str(caught.value)
