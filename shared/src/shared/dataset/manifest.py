"""A dataset's manifest: what it says of itself and of every shard, and whether that is still so.

The manifest holds a SHA-256 of its own entries, and one of every shard. A flipped bit in either is found as the file is
opened first in a process; a bit that flips later, in the checksums that Parquet keeps of every page.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, Field

from shared.dataset import VERSION
from shared.dataset.documents import read_json, sealed, unsealed
from shared.dataset.locations import Location, RemotePath, file_size, sha256_of
from shared.dataset.writing import write_json
from shared.physics.errors import InputError
from shared.radar import validated

MANIFEST = "manifest.json"


class ShardRecord(BaseModel, frozen=True, extra="forbid"):
    """What the manifest says about one shard.

    :param path: relative to the dataset's folder, with forward slashes
    :param rows: frames in it
    :param bytes: size of the file
    :param sha256: of the file, in hexadecimal
    """

    path: Annotated[str, Field(pattern=r"^(train|validation|test|paths)/part-[0-9]{5,}\.parquet$")]
    rows: Annotated[int, Field(ge=1, strict=True)]
    bytes: Annotated[int, Field(ge=1, strict=True)]
    sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]


class _ManifestShards(BaseModel):
    """The part of a manifest that reading depends on."""

    shards: tuple[ShardRecord, ...]


def check_version(source: object, document: object) -> None:
    """Refuse what a newer version made, or what has no version.

    :raises InputError: always naming ``source``
    """
    version = document.get("version") if isinstance(document, dict) else None
    if not isinstance(version, int) or isinstance(version, bool) or version < 1:
        raise InputError(source, f"version = {version!r}", f"a format version from 1 to {VERSION}")
    if version > VERSION:
        raise InputError(source, f"made by a newer version: version {version}; this reads up to {VERSION}; upgrade")


def read_manifest(directory: Location) -> dict[str, Any]:
    """The manifest of a dataset's folder, its version and its checksum checked.

    :raises InputError: missing, not JSON, no version or a newer one, entries that were changed
    """
    if isinstance(directory, Path) and directory.is_file():
        raise InputError(directory, "is a file", "the folder of a finished dataset")
    path = directory / MANIFEST
    if file_size(path) is None:
        raise InputError(path, "no such file", "the folder of a finished dataset")
    manifest = read_json(path, "a manifest made by datafactory")
    check_version(path, manifest)
    return unsealed(path, manifest)


def write_manifest(directory: Location, manifest: Mapping[str, Any]) -> Location:
    """Write ``DIR/manifest.json`` in one step, keys sorted.

    A run fills it: ``version``, ``shards`` (one :class:`ShardRecord` each, as a dict), ``arguments``, radar and
    axes, ``seeds``, ``scenes``, ``effects``, ``counts``, and ``made``, the only key that may differ between equal runs.
    ``sha256`` is added, of all but ``made``.
    """
    path = directory / MANIFEST
    write_json(path, sealed(manifest))
    return path


def shard_records(path: Location, manifest: Mapping[str, Any]) -> tuple[ShardRecord, ...]:
    """The records of all shards, in the manifest's order.

    :param path: of the manifest
    :raises InputError: none, one that is not right, a path twice
    """
    if not isinstance(manifest.get("shards"), list) or not manifest["shards"]:
        raise InputError(path, "no list of shards", "one record for each shard")
    records = validated(_ManifestShards, manifest, path).shards
    if len({record.path for record in records}) < len(records):
        raise InputError(path, "shards names a path twice", "one record for each shard")
    return records


State = tuple[int, int]
"""Time of change [ns] and size [B] of a file."""

_as_written: dict[Path, State] = {}
"""Shards that this process has found as the manifest says."""


def require_as_written(shard: Location) -> None:
    """Check the size and the SHA-256 of a shard that a manifest names, once in a process.

    A shard that lies alone, without its dataset, has nothing to be checked against. A remote one is not checked: to
    read one frame of it would take the whole file; ``inspect --verify`` and ``fit`` do that.

    :raises InputError: a shard that is not as the manifest says
    """
    if isinstance(shard, RemotePath) or not (shard.parent.parent / MANIFEST).is_file():
        return
    state = _state(shard)
    if _as_written.get(shard) == state:
        return
    record = _records(shard.parent.parent, _state(shard.parent.parent / MANIFEST)).get(
        f"{shard.parent.name}/{shard.name}"
    )
    if record is None:
        return
    if fault := digest_fault(shard, record):
        raise InputError(shard, fault, "a shard as it was written")


def digest_fault(shard: Location, record: ShardRecord) -> str | None:
    """How size or SHA-256 differ from the record; the file is read as a whole."""
    state = None if isinstance(shard, RemotePath) else _state(shard)
    if state and state[1] != record.bytes:
        return f"{state[1]} bytes; the manifest says {record.bytes}"
    digest = sha256_of(shard)
    if digest != record.sha256:
        return f"sha256 is {digest}; the manifest says {record.sha256}"
    if state and isinstance(shard, Path):
        _as_written[shard] = state
    return None


def _state(path: Path) -> State:
    found = path.stat()
    return found.st_mtime_ns, found.st_size


@lru_cache(maxsize=16)
def _records(folder: Path, _manifest: State) -> dict[str, ShardRecord]:
    records = shard_records(folder / MANIFEST, read_manifest(folder))
    return {record.path: record for record in records}
