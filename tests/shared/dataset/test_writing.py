"""The one writer: whole files or none, errors that name the final file."""

from __future__ import annotations

import errno
import json
import os
import resource
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from shared.dataset.writing import PARTIAL, atomic, write_bytes, write_json, write_text


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
