"""Objects that are whole or not there, against moto's S3 server: writing, checking, and a store that fails.

One job a folder of a store: refused, released, taken over from the dead, and kept from the living.
"""

import hashlib
import json
import subprocess
import sys
import time
from contextlib import contextmanager

import numpy as np
import pytest
from s3_server import SECRET

from shared.dataset import claims, stores
from shared.dataset.locations import RemotePath, locate
from shared.dataset.writing import PARTIAL, atomic, is_as_recorded, remove_folder, remove_partial, scratch, write_bytes
from shared.physics.errors import InputError


@pytest.fixture
def folder(server, monkeypatch, tmp_path):
    """A folder of this test's own in the bucket; what is on its way there stands below ``tmp_path``."""
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    return locate(server.uri(f"{tmp_path.name}/set"))


def asked(path):
    """What the store says of an object that is there."""
    found = stores.kept(path)
    assert found is not None
    return found


def sha256(content):
    return hashlib.sha256(content).hexdigest()


def test_an_object_is_what_was_written_and_nothing_stays_here(server, folder, tmp_path):
    with atomic(folder / "train/part.bin") as partial:
        partial.write_bytes(b"first")
        assert server.keys(folder.key.partition("/")[2]) == []
    assert server.objects(tmp_path.name) == {f"{tmp_path.name}/set/train/part.bin": b"first"}
    write_bytes(folder / "train/part.bin", b"second")
    assert (folder / "train/part.bin").read_bytes() == b"second"
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []


def test_a_body_that_raises_sends_nothing(server, folder, tmp_path):
    def interrupted(partial):
        partial.write_bytes(b"new, half")
        raise RuntimeError

    write_bytes(folder / "a", b"old")
    with pytest.raises(RuntimeError), atomic(folder / "a") as partial:
        interrupted(partial)
    assert (folder / "a").read_bytes() == b"old"
    assert list(tmp_path.rglob(f"*{PARTIAL}")) == []


def test_a_large_object_goes_in_parts_or_not_at_all(server, folder, monkeypatch):
    monkeypatch.setattr(stores, "PART_BYTES", 5 << 20)
    content = np.random.default_rng(0).bytes(12 << 20)
    write_bytes(folder / "large", content)
    assert (folder / "large").read_bytes() == content
    assert asked(folder / "large").tag.endswith('-3"')
    assert is_as_recorded(folder / "large", len(content), sha256(content))
    server.fail(method="PUT", path="other", after=1, status=500)  # the second part and all after it
    with pytest.raises(OSError, match="the store answers InternalError") as caught:
        write_bytes(folder / "other", content)
    assert caught.value.filename == str(folder / "other")
    server.mend()
    assert (folder / "other").size() is None
    assert server.unfinished() == 0


def test_a_finished_object_is_checked_without_being_sent(server, folder):
    content = b"of a shard"
    write_bytes(folder / "part", content)
    server.fail(method="GET", path="part", status=500)
    assert is_as_recorded(folder / "part", len(content), sha256(content))
    assert not is_as_recorded(folder / "part", len(content) + 1, sha256(content))
    assert not is_as_recorded(folder / "part", len(content), sha256(b"other"))
    assert not is_as_recorded(folder / "none", len(content), sha256(content))


def test_an_object_that_something_else_wrote_is_read(server, folder):
    content = b"of a shard"
    server.request("PUT", f"/{(folder / 'part').key}", content)
    assert asked(folder / "part").sha256 is None
    assert is_as_recorded(folder / "part", len(content), sha256(content))
    assert not is_as_recorded(folder / "part", len(content), sha256(b"of a shaft"))


def test_only_one_of_two_writes_that_depend_on_the_same_state_succeeds(folder):
    first = stores.put_if(folder / "lock", b"one", None)
    assert first
    assert stores.put_if(folder / "lock", b"two", None) is None
    assert stores.put_if(folder / "lock", b"two", first)
    assert stores.put_if(folder / "lock", b"three", first) is None
    stores.remove(folder / "lock", folder / "lock")
    assert stores.put_if(folder / "lock", b"three", first) is None
    assert (folder / "lock").size() is None


@pytest.mark.parametrize("before", [False, True])
def test_a_write_whose_answer_is_lost_is_known_for_ones_own(server, folder, before):
    """It is sent again, and the store holds what was sent first."""
    tag = stores.put_if(folder / "lock", b"before", None) if before else None
    server.fail(method="PUT", path="lock", status=500, times=1, done=True)
    assert stores.put_if(folder / "lock", b"mine", tag) == asked(folder / "lock").tag
    assert (folder / "lock").read_bytes() == b"mine"


def test_a_folder_is_listed_and_removed_with_all_that_is_in_it(folder):
    for name in ("a", "b/c", "b/d/e"):
        write_bytes(folder / name, b"x")
    write_bytes(folder.parent / "settings", b"y")  # its name begins as the folder's does
    assert sorted(stores.objects_under(folder)) == ["a", "b/c", "b/d/e"]
    remove_folder(folder / "b")
    assert list(stores.objects_under(folder)) == ["a"]
    remove_folder(folder)
    assert list(stores.objects_under(folder.parent)) == ["settings"]


@pytest.mark.parametrize(
    ("status", "words"),
    [(403, "AccessDenied, made to fail .credentials are looked for in the environment"), (500, "InternalError, made")],
)
def test_a_store_that_fails_is_one_line_that_names_the_object(server, folder, status, words):
    server.fail(method="PUT", path="", status=status)
    with pytest.raises(OSError, match=words) as caught:
        write_bytes(folder / "a", b"x")
    assert "\n" not in str(caught.value)
    assert SECRET not in str(caught.value)
    assert caught.value.__cause__ is None


def test_a_request_is_repeated(server, folder):
    server.fail(method="PUT", path="", status=500, times=1)
    write_bytes(folder / "a", b"x")
    assert (folder / "a").read_bytes() == b"x"


def test_a_missing_bucket_is_another_thing_than_a_missing_object(server, folder):
    elsewhere = locate(server.uri("set", bucket="nowhere"))
    assert isinstance(elsewhere, RemotePath)
    for write in (
        lambda: write_bytes(elsewhere / "a", b"x"),
        lambda: stores.put_if(elsewhere / "a", b"x", None),
        lambda: list(stores.objects_under(elsewhere)),
    ):
        with pytest.raises(OSError, match="NoSuchBucket"):
            write()


def test_what_a_killed_process_left_here_is_found_by_the_next(folder):
    (scratch(folder / "train/part") / "1-part.partial").write_bytes(b"half")
    assert scratch(folder) == scratch(folder / "train")
    remove_partial(folder)
    assert list(scratch(folder).iterdir()) == []


def test_a_place_that_is_only_read_is_refused(folder, monkeypatch):
    with pytest.raises(InputError, match=r"http://localhost/set/a: is only read; expected a local folder, s3:// or"):
        write_bytes(locate("http://localhost/set") / "a", b"x")
    stores._client.cache_clear()
    loaded = {name for name in sys.modules if name.partition(".")[0] == "obstore"}
    for name in {"obstore", *loaded}:  # whether it was loaded before or not
        monkeypatch.setitem(sys.modules, name, None)
    asked_of = (lambda: write_bytes(folder / "a", b"x"), lambda: stores.put_if(folder / "a", b"x", None))
    for ask in (*asked_of, held(folder).__enter__):
        with pytest.raises(InputError, match=r"needs obstore; expected pip install 'sparseradar-shared\[s3\]'"):
            ask()


@contextmanager
def held(folder, check=lambda: None):
    with claims.claimed(folder, folder / ".progress", "--out", check):
        yield folder / ".progress/lock"


def left_by(folder, **changed):
    """The claim of a process that is not this one."""
    signature = json.loads(claims._signature()) | changed
    assert stores.put_if(folder / ".progress/lock", json.dumps(signature).encode(), None)


def test_a_second_job_is_refused_and_the_folder_given_back(server, folder):
    with held(folder) as lock:
        with (
            pytest.raises(InputError, match=r"--out: another process is at work in s3://bucket/.*, seen \d+ s ago"),
            held(folder),
        ):
            pass
        assert stores.kept(lock)
    assert stores.kept(lock) is None
    with held(folder):
        pass


def test_a_check_that_fails_leaves_nothing(server, folder, tmp_path):
    def check():
        raise InputError("--out", "is not empty")

    with pytest.raises(InputError, match="not empty"), held(folder, check):
        pass
    assert server.keys(tmp_path.name) == []


def test_the_claim_of_a_process_of_this_machine_that_is_gone_is_taken_over(folder):
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    left_by(folder, pid=gone.pid)
    with held(folder):
        pass


def test_a_claim_of_another_machine_is_kept_until_its_lease_ends(folder, monkeypatch):
    left_by(folder, machine="another", host="far", pid=7)
    with (
        pytest.raises(
            InputError, match=r"far 7, seen \d+ s ago; expected to wait for it, or until it was not seen for 60 s"
        ),
        held(folder),
    ):
        pass
    monkeypatch.setattr(claims, "LEASE_S", -1.0)
    with held(folder):
        pass


def test_a_job_that_lives_writes_its_claim_anew(folder, monkeypatch):
    monkeypatch.setattr(claims, "BEAT_S", 0.02)
    with held(folder) as lock:
        tags = {asked(lock).tag}
        while len(tags) < 3:  # ends: each beat changes the tag
            time.sleep(0.01)
            tags.add(asked(lock).tag)


def test_a_claim_that_was_taken_over_is_not_removed(server, folder, monkeypatch):
    monkeypatch.setattr(claims, "BEAT_S", 0.02)
    with held(folder) as lock:
        server.request("PUT", f"/{lock.key}", b"another's")
        time.sleep(0.3)
    assert lock.read_bytes() == b"another's"


def test_a_job_outlives_a_store_that_is_away_for_a_while(server, folder, monkeypatch):
    monkeypatch.setattr(claims, "BEAT_S", 0.02)
    monkeypatch.setenv("AWS_MAX_ATTEMPTS", "1")
    with held(folder) as lock:
        server.fail(method="PUT", path="lock", status=500, times=3)
        before = asked(lock).tag
        while asked(lock).tag == before:
            time.sleep(0.01)
    assert stores.kept(lock) is None


def test_a_store_that_refuses_is_bad_input(server, folder):
    server.fail(method="PUT", path="lock", status=403)
    with (
        pytest.raises(InputError, match=r"--out: s3://bucket/.*/lock: the store answers AccessDenied.* can be written"),
        held(folder),
    ):
        pass
