"""Object stores that are written to: S3, what speaks as it does, and Google's, by obstore.

An object appears only whole: a small one by one request, a large one when its parts are completed. A part, or the whole
of a small object, is sent with its SHA-256, which S3 checks before it keeps it. An upload that fails is taken back;
what a killed process had sent of one is no object, and is dropped by the bucket's rule for unfinished uploads.

Arrow reads, but cannot write so: its files complete what was sent when they are closed by an error, and it knows no
request that depends on what is there, which a claim needs.
"""

from __future__ import annotations

import errno
import os
import re
import textwrap
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime, timedelta
from functools import lru_cache
from pathlib import Path
from typing import Any
from urllib.parse import parse_qsl, urlsplit

from shared.dataset.locations import CREDENTIALS, RemotePath
from shared.physics.errors import InputError

PART_BYTES = 64 << 20
"""Of a part of a large upload; what is smaller goes in one request."""
PARTS_AT_A_TIME = 2
RETRY_SECONDS = 180
"""After which a request that is answered by 5xx, or not at all, is given up."""
RETRIES = 10
"""Repetitions of a request within that time, where AWS_MAX_ATTEMPTS does not say otherwise."""
CONNECT_SECONDS = 10
SHA256 = "sha256"
"""Metadata of every object: SHA-256 of its content, in hexadecimal."""
LONGEST_REASON = 200
"""Characters of a store's own message that are shown."""


@dataclass(frozen=True)
class Kept:
    """What a store says of an object, without sending it.

    :param size: bytes
    :param sha256: that its writer stated, None where it was written by something else
    :param tag: changes with the content
    :param modified: by the store's clock
    """

    size: int
    sha256: str | None
    tag: str
    modified: datetime


def kept(path: RemotePath) -> Kept | None:
    """What the store says of an object, None if there is none.

    :raises OSError: a store that refuses or does not answer; naming the object
    """
    with _asked(path) as (store, key):
        try:
            found = store.get(key, options={"head": True})
        except FileNotFoundError as error:
            _require_bucket(error)
            return None
    meta = found.meta
    stated = found.attributes.get(SHA256)
    return Kept(meta["size"], stated, meta["e_tag"] or "", meta["last_modified"])


def put(path: RemotePath, file: Path, sha256: str) -> None:
    """Write what a file holds, all of it or none.

    :raises OSError: a store that refuses or does not answer; naming the object
    """
    in_parts = file.stat().st_size > PART_BYTES
    parts: Any = {"use_multipart": in_parts, "chunk_size": PART_BYTES, "max_concurrency": PARTS_AT_A_TIME}
    with _asked(path) as (store, key):
        store.put(key, file, attributes={SHA256: sha256}, **parts)


def put_if(path: RemotePath, content: bytes, tag: str | None) -> str | None:
    """Write a small object where the store still holds the one of this tag, or none if the tag is None.

    :param content: of nobody else
    :returns: the new tag; None where another was faster
    :raises OSError: a store that refuses or does not answer; naming the object
    """
    with _asked(path) as (store, key):
        from obstore.exceptions import AlreadyExistsError, PreconditionError

        try:
            try:
                return str(store.put(key, content, mode="create" if tag is None else {"e_tag": tag})["e_tag"])
            except (AlreadyExistsError, PreconditionError):
                # A request whose answer was lost is sent again, and meets what it wrote itself.
                found = store.get(key)
                return str(found.meta["e_tag"]) if found.bytes() == content else None
        except FileNotFoundError as error:  # the object of the tag is gone
            _require_bucket(error)
            return None


def remove(*paths: RemotePath) -> None:
    """Remove objects; one that is not there is no error.

    :raises OSError: a store that refuses or does not answer
    """
    for path in paths:
        with _asked(path) as (store, key):
            try:
                store.delete(key)
            except FileNotFoundError as error:
                _require_bucket(error)


def objects_under(folder: RemotePath) -> Iterator[str]:
    """Names of the objects in a folder and the folders in it, relative to it, with forward slashes.

    :raises OSError: a store that refuses or does not answer
    """
    with _asked(folder) as (store, prefix):
        for found in store.list(prefix or None):
            for item in found:
                if name := item["path"][len(prefix) :].lstrip("/"):
                    yield name


def store_of(path: RemotePath) -> Any:
    """obstore's client of the bucket, one for all paths of a URI in a process.

    :raises InputError: a place that is only read, or a package that is missing
    """
    scheme = urlsplit(path.origin).scheme
    if scheme not in ("s3", "gs", "gcs"):
        raise InputError(path, "is only read", "a local folder, s3:// or gs:// to write to")
    bucket = path.key.partition("/")[0]
    region = getattr(path.filesystem, "region", "")
    return _client(scheme, bucket, urlsplit(path.origin).query, region, os.environ.get("AWS_MAX_ATTEMPTS", ""))


@lru_cache(maxsize=8)
def _client(scheme: str, bucket: str, query: str, region: str, attempts: str) -> Any:
    try:
        from obstore.store import GCSStore, S3Store
    except ImportError:
        problem = "writing there needs obstore"
        raise InputError(f"{scheme}://{bucket}", problem, "pip install 'sparseradar-shared[s3]'") from None
    given = dict(parse_qsl(query))
    retry: Any = {"retry_timeout": timedelta(seconds=RETRY_SECONDS), "max_retries": RETRIES}
    if attempts.isdecimal() and int(attempts) > 0:
        retry["max_retries"] = int(attempts) - 1
    options: Any = {"connect_timeout": timedelta(seconds=CONNECT_SECONDS)}
    if scheme != "s3":
        if "endpoint_override" in given:
            raise InputError(f"{scheme}://{bucket}", "endpoint_override", "Google's own storage to write to")
        return GCSStore(bucket, client_options=options, retry_config=retry)
    config: dict[str, Any] = {"checksum_algorithm": "SHA256", "region": region or given.get("region", "us-east-1")}
    if endpoint := given.get("endpoint_override"):
        scheme = given.get("scheme", "https")
        options["allow_http"] = scheme == "http"
        config |= {"endpoint": endpoint if "://" in endpoint else f"{scheme}://{endpoint}"}
    if certificates := given.get("tls_ca_file_path"):
        options["root_certificate"] = Path(certificates).read_bytes()
    return S3Store(bucket, client_options=options, retry_config=retry, **config)


def _require_bucket(error: FileNotFoundError) -> None:
    """A bucket that is missing is another thing than an object that is."""
    if "NoSuchBucket" in str(error):
        raise error


@contextmanager
def _asked(path: RemotePath) -> Iterator[tuple[Any, str]]:
    """(the client, the key within its bucket); what obstore raises becomes an :class:`OSError` of one line that names
    the object."""
    try:
        yield store_of(path), path.key.partition("/")[2]
    except InputError:
        raise
    except Exception as error:
        if not (isinstance(error, OSError) or type(error).__module__.startswith("obstore")):
            raise
        raise OSError(errno.EIO, _reason(error, urlsplit(path.origin).scheme), path.label) from None


def _reason(error: Exception, scheme: str) -> str:
    """Why, in a few words: what the store answered, or what became of the request."""
    said = str(error).partition("Debug source")[0]
    code, message = (re.search(rf"<{name}>(.*?)</{name}>", said, re.DOTALL) for name in ("Code", "Message"))
    status = re.search(r"status code: (\d+ [A-Za-z ]+)", said)
    if code:
        reason = f"the store answers {code[1]}" + (f", {message[1]}" if message else "")
    elif status:
        reason = f"the store answers {status[1].strip()}"
    else:
        reason = f"the store does not answer: {said.rpartition(' - ')[2].strip()}"
    if any(word in said for word in ("403", "401", "credential", "instance metadata")):
        reason += f" (credentials are looked for in the environment: {CREDENTIALS[scheme]}, or the machine's role)"
    return textwrap.shorten(reason, LONGEST_REASON + 100, placeholder=" ...")
