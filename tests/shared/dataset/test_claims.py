"""One job a folder of an object store: refused, released, taken over from the dead, and kept from the living."""

import json
import subprocess
import sys
import time
from contextlib import contextmanager

import pytest

from shared.dataset import claims
from shared.dataset.locations import locate
from shared.dataset.stores import kept, put_if
from shared.physics.errors import InputError


@pytest.fixture
def folder(server, tmp_path):
    return locate(server.uri(f"{tmp_path.name}/set"))


@contextmanager
def held(folder, check=lambda: None):
    with claims.claimed(folder, folder / ".progress", "--out", check):
        yield folder / ".progress/lock"


def tag_of(lock):
    found = kept(lock)
    assert found is not None
    return found.tag


def left_by(folder, **changed):
    """The claim of a process that is not this one."""
    signature = json.loads(claims._signature()) | changed
    assert put_if(folder / ".progress/lock", json.dumps(signature).encode(), None)


def test_a_second_job_is_refused_and_the_folder_given_back(server, folder):
    with held(folder) as lock:
        with (
            pytest.raises(InputError, match=r"--out: another process is at work in s3://bucket/.*, seen \d+ s ago"),
            held(folder),
        ):
            pass
        assert kept(lock)
    assert kept(lock) is None
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
        tags = {tag_of(lock)}
        while len(tags) < 3:  # ends: each beat changes the tag
            time.sleep(0.01)
            tags.add(tag_of(lock))


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
        before = tag_of(lock)
        while tag_of(lock) == before:
            time.sleep(0.01)
    assert kept(lock) is None


def test_a_store_that_refuses_is_bad_input(server, folder):
    server.fail(method="PUT", path="lock", status=403)
    with (
        pytest.raises(InputError, match=r"--out: s3://bucket/.*/lock: the store answers AccessDenied.* can be written"),
        held(folder),
    ):
        pass
