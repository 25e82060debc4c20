"""A dataset's folder: the manifest, the splits' shards, and the check of every byte."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import pyarrow as pa

from shared.dataset import Frame
from shared.dataset.locations import Location, RemotePath, file_names, file_size, locate
from shared.dataset.manifest import MANIFEST, ShardRecord, digest_fault, read_manifest, shard_records
from shared.dataset.reading import open_shard, read_description, read_frames
from shared.physics.errors import InputError

Split = Literal["train", "validation", "test"]
SPLITS: tuple[Split, ...] = ("train", "validation", "test")
CAMERA = "camera"
"""Folder of the frames as a camera at the sensor sees them, where they were asked for."""


def camera_path(folder: Location, frame_id: int) -> Location:
    """Where a frame's camera picture stands in a dataset's folder."""
    return folder / CAMERA / f"frame-{frame_id:06d}.png"


@dataclass(frozen=True)
class Dataset:
    """An opened dataset.

    :param path: its folder, local or remote
    :param manifest: the whole manifest, as plain JSON values
    :param splits: split name to the paths of its shards, in the manifest's order; only splits that have frames
    :param records: one for each shard of the manifest, ``paths/`` included
    """

    path: Location
    manifest: dict[str, Any]
    splits: dict[str, tuple[Location, ...]]
    records: tuple[ShardRecord, ...]

    def shards(self, split: str) -> tuple[Location, ...]:
        """The shards of a split.

        :raises InputError: a split that has no frames
        """
        self._require_frames()
        if split not in self.splits:
            raise InputError(self.path, f"no frames in split {split!r}", f"one of {list(self.splits)}")
        return self.splits[split]

    def frames(self, split: str, columns: Sequence[str] | None = None) -> Iterator[Frame]:
        """The frames of a split one after the other, see :func:`read_frames`."""
        for shard in self.shards(split):
            yield from read_frames(shard, columns)

    def rows(self, split: str) -> tuple[tuple[Location, int], ...]:
        """(shard, row) of every frame of a split, for :func:`read_frame`."""
        count = {self.path / record.path: record.rows for record in self.records}
        return tuple((shard, row) for shard in self.shards(split) for row in range(count[shard]))

    def camera(self, frame_id: int) -> bytes | None:
        """The PNG of a frame as a camera at the sensor sees it; None where there is none."""
        path = camera_path(self.path, frame_id)
        return None if file_size(path) is None else path.read_bytes()

    def description(self) -> dict[str, Any]:
        """The description of the first shard; all shards have the same (:func:`verify` checks it).

        :raises InputError: a folder without frames, a first shard that cannot be read
        """
        self._require_frames()
        return read_description(next(shard for shards in self.splits.values() for shard in shards))

    def _require_frames(self) -> None:
        """``datafactory trace`` writes shards under ``paths/`` alone."""
        if not self.splits:
            made_by = f"datafactory render --paths {shlex.quote(str(self.path))} --out OTHER"
            raise InputError(self.path, "holds traced paths and no frames", f"a dataset, as made by {made_by}")


def open_dataset(path: Path | str | RemotePath, check_sizes: bool = True) -> Dataset:
    """A dataset by its folder, local or by URI; every shard of the manifest is there and has the right size.

    :param path: see :func:`shared.dataset.locations.locate`
    :param check_sizes: False leaves missing and cut-off shards to :func:`verify`
    :raises InputError: naming the file that is missing, damaged or of a newer version
    """
    path = locate(path)
    manifest = read_manifest(path)
    records = shard_records(path / MANIFEST, manifest)
    if check_sizes:
        for record in records:
            if fault := _size_fault(path, record):
                raise InputError(path / record.path, fault)
    of_split = {name: tuple(path / r.path for r in records if r.path.startswith(f"{name}/")) for name in SPLITS}
    return Dataset(path, manifest, {name: shards for name, shards in of_split.items() if shards}, records)


def verify(dataset: Dataset) -> list[str]:
    """Every fault of the dataset's files, one line each that names the file; empty if all is as it was written.

    Size and SHA-256 of every shard, then whether it is Parquet with the rows that the manifest says and the schema of
    the other shards of its kind, and files that the manifest does not know.
    """
    faults = []
    schemas: dict[bool, pa.Schema] = {}
    for record in dataset.records:
        fault = _size_fault(dataset.path, record) or _content_fault(dataset.path, record, schemas)
        if fault:
            faults.append(f"{record.path}: {fault}")
    known = {record.path for record in dataset.records}
    for folder in (*SPLITS, "paths"):
        found = (f"{folder}/{name}" for name in file_names(dataset.path / folder))
        faults.extend(f"{name}: not in the manifest" for name in found if name not in known)
    return faults


def _size_fault(directory: Location, record: ShardRecord) -> str | None:
    path = directory / record.path
    size = file_size(path)
    if size is None:
        return "missing; the manifest names it"
    return None if size == record.bytes else f"{size} bytes; the manifest says {record.bytes}"


def _content_fault(directory: Location, record: ShardRecord, schemas: dict[bool, pa.Schema]) -> str | None:
    path = directory / record.path
    if fault := digest_fault(path, record):
        return fault
    is_paths = record.path.startswith("paths/")
    try:
        with open_shard(path) as file:
            if not is_paths:
                read_description(path)
            rows, schema = file.metadata.num_rows, file.schema_arrow
    except InputError as error:
        return str(error)
    if rows != record.rows:
        return f"{rows} rows; the manifest says {record.rows}"
    if not schema.equals(schemas.setdefault(is_paths, schema), check_metadata=True):
        return "its schema differs from that of the first shard"
    return None
