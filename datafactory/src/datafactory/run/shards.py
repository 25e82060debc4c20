"""Frames to Parquet shards: which frame goes where, what is made at a time or by one of several jobs, and how a shard
becomes complete; and what made them.

Whole shards are dealt to jobs, so that their bytes are those of the run in one piece. Each job has a folder of its own:
nothing that two machines write to is shared, and no lock has to reach from one to the other.

A file with the final name is whole, see :mod:`shared.dataset.writing`.
What a killed run had finished is taken up again by :mod:`datafactory.run.progress`.
"""

from __future__ import annotations

import platform
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from importlib.util import find_spec
from typing import Annotated, Any

import pyarrow as pa
import pyarrow.parquet as pq
from pydantic import BaseModel, Field

from datafactory.defaults import CPU, IMAGE_BATCH
from datafactory.frame.draws import split_of
from datafactory.paths.backend import cuda_device
from shared.dataset import Frame, to_record_batch
from shared.dataset.folder import SPLITS
from shared.dataset.locations import Location, sha256_of
from shared.dataset.manifest import ShardRecord
from shared.dataset.writing import atomic, make_folder
from shared.physics.errors import InputError

FRAMES_PER_SHARD = 8
"""Frames in a full shard: 12 MB for the default radar, 400 MB with its cubes; what is not whole a killed run loses."""

PORTIONS_A_WORKER = 2
"""Of a portion's size that are left for each when it is cut: with fewer they wait for the last one, with more single
frames make their matrices alone."""

PATHS = "paths"
"""Folder of traced paths, beside the splits."""

# Measured with pyarrow on one core of an AVX-512 Zen 5: range_channel and image of the default radar (1.86 MB), each
# frame its own row group so that a random one is cheap. Frames/s at random / in order, size: none 530 / 600, 100 %;
# LZ4 + byte stream split 470 / 555, 82 %; zstd level 1 + byte stream split 390 / 465, 76 %.
COMPRESSION = "lz4"
FRAMES_PER_ROW_GROUP = 1
PACKAGES = (
    "sparseradar-shared",
    "sparseradar-datafactory",
    "sionna-rt",
    "mitsuba",
    "drjit",
    "numpy",
    "numba",
    "pyarrow",
)


@dataclass(frozen=True)
class ShardPlan:
    """Which frames make up one shard.

    :param split: "train", "validation", "test", or "paths" for traced paths
    :param index: number of the shard in its split
    :param frame_ids: its frames, rising
    """

    split: str
    index: int
    frame_ids: tuple[int, ...]

    @property
    def path(self) -> str:
        """Path relative to the dataset's folder, with forward slashes."""
        return f"{self.split}/part-{self.index:05d}.parquet"


def plan_shards(frame_splits: Sequence[str], frames_per_shard: int = FRAMES_PER_SHARD) -> tuple[ShardPlan, ...]:
    """The shards of a dataset whose frame i belongs to ``frame_splits[i]``, split by split, frames rising.

    :param frame_splits: a split, or PATHS for traced paths
    """
    folders = (*SPLITS, PATHS)
    if unknown := sorted(set(frame_splits) - set(folders)):
        raise ValueError(f"split {unknown[0]!r}; expected one of {list(folders)}")
    plans = []
    for folder in folders:
        frame_ids = [index for index, name in enumerate(frame_splits) if name == folder]
        for index, first in enumerate(range(0, len(frame_ids), frames_per_shard)):
            plans.append(ShardPlan(folder, index, tuple(frame_ids[first : first + frames_per_shard])))
    return tuple(plans)


@dataclass(frozen=True)
class Portion:
    """What a worker makes at a time: neighbouring frames of one shard.

    :param frame_ids: rising
    """

    plan: ShardPlan
    frame_ids: tuple[int, ...]


def portions_of(plans: Sequence[ShardPlan], workers: int) -> tuple[Portion, ...]:
    """The frames of shards in portions, in their order; no byte depends on how they are cut.

    Where several share them, portions become smaller as fewer frames are left: no worker waits long for another's last.

    :param workers: that share them
    """
    left, portions = sum(len(plan.frame_ids) for plan in plans), list[Portion]()
    for plan in plans:
        rest = plan.frame_ids
        while rest:
            most = min(max(left // (PORTIONS_A_WORKER * workers), 1), IMAGE_BATCH)
            size = -(-len(rest) // -(-len(rest) // most))  # 4 and 4 of 8 frames rather than 7 and 1
            portions.append(Portion(plan, rest[:size]))
            rest = rest[size:]
            left -= size if workers > 1 else 0
    return tuple(portions)


def write_shard(path: Location, frames: Iterable[Frame], schema: pa.Schema) -> ShardRecord:
    """Write one shard, frame by frame; its file has the final name only once it is whole.

    :param path: ``DIR/<split>/part-NNNNN.parquet``; the folder is made if need be
    :param frames: at least one; drawn one at a time, so that a shard may exceed the memory
    :returns: the record for the manifest, its path relative to ``DIR``
    :raises InputError: a frame that does not fit the schema
    :raises OSError: the disk is full or fails; nothing is left behind
    """
    tables = (pa.Table.from_batches([to_record_batch([frame], schema)]) for frame in frames)
    return write_tables(path, tables, schema, **frame_options(schema))


def write_tables(path: Location, tables: Iterable[pa.Table], schema: pa.Schema, **options: Any) -> ShardRecord:
    """Write a Parquet file as :func:`write_shard` does, from tables that hold one frame each.

    :param options: of :class:`pyarrow.parquet.ParquetWriter`
    """
    make_folder(path.parent)
    rows = 0
    with atomic(path) as partial:
        # A checksum of every page: a bit that flips later is found by whoever reads.
        options |= {"write_page_checksum": True}
        with partial.open("wb") as handle, pq.ParquetWriter(handle, schema, **options) as writer:
            for table in tables:
                writer.write_table(table, row_group_size=FRAMES_PER_ROW_GROUP)
                rows += 1
        if rows == 0:
            raise ValueError(f"{path.name} would have no frames; expected at least one")
        digest, size = sha256_of(partial), partial.stat().st_size
    return ShardRecord(path=f"{path.parent.name}/{path.name}", rows=rows, bytes=size, sha256=digest)


def frame_options(schema: pa.Schema) -> dict[str, Any]:
    """How shards of frames are written: options of :func:`write_tables`."""
    arrays = [field.name for field in schema if pa.types.is_fixed_size_list(field.type)]
    floats = [name for name in arrays if pa.types.is_float32(schema.field(name).type.value_type)]
    plain = [field.name for field in schema if pa.types.is_integer(field.type) or pa.types.is_string(field.type)]
    return {
        "compression": COMPRESSION,
        "use_dictionary": False,  # noise has no repeated values
        "use_byte_stream_split": [f"{name}.list.element" for name in floats],
        "write_statistics": plain,  # minima of array elements help nobody
    }


def provenance(
    engine: str, workers: int, seconds: float, step_seconds: Mapping[str, float], device: str = CPU
) -> dict[str, Any]:
    """The manifest's ``made``.

    :param engine: that made the shards, see :mod:`datafactory.run.portions`
    :param workers: its processes; 0 on a cluster for all that its nodes had
    :param seconds: wall-clock seconds of the run
    :param step_seconds: seconds of each step of the chain, added over the workers
    :param device: of the run; a GPU is named
    """
    packages: tuple[str, ...] = PACKAGES
    gpu = dict[str, str]()
    if device != CPU:
        gpu = {"gpu": cuda_device().name}
        packages += ("torch",) if find_spec("torch") else ()
    return {
        **gpu,
        "finished": datetime.now(UTC).isoformat(timespec="seconds"),
        "host": platform.node(),
        "machine": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "versions": {name: version(name) for name in packages},
        "engine": engine,
        "workers": workers,
        "seconds": round(seconds, 1),
        "step_seconds": {name: round(value, 1) for name, value in sorted(step_seconds.items())},
    }


OPTION = "--shard"
ARGUMENT = "shard"
"""Among the ``arguments`` of a job's manifest, which are otherwise those of the run in one piece."""
ENTRY = "job"
"""Entry of a job's manifest, see :class:`JobEntry`."""

EXPECTED = "i/n with i from 0 to n - 1, e.g. 0/16 to 15/16 for `sbatch --array=0-15`"


@dataclass(frozen=True)
class ArrayJob:
    """Job ``number`` of ``of``.

    :param number: from 0
    """

    number: int
    of: int

    def __post_init__(self) -> None:
        if not 0 <= self.number < self.of:
            raise InputError(OPTION, f"{str(self)!r}", EXPECTED)

    def __str__(self) -> str:
        return f"{self.number}/{self.of}"

    @property
    def folder(self) -> str:
        """Name of its folder; those of all jobs sort by their numbers."""
        return f"job-{self.number:0{len(str(self.of - 1))}d}-of-{self.of}"

    def own(self, plans: Sequence[ShardPlan]) -> tuple[ShardPlan, ...]:
        """Its shards among those of the dataset: every ``of``-th, so that each job has shards of every split and scene.

        :raises InputError: more jobs than shards
        """
        if self.of > len(plans):
            raise InputError(OPTION, f"{self.of} jobs for {len(plans)} shards", f"at most {len(plans)} jobs")
        return tuple(plans[self.number :: self.of])

    def least_frames(self, frames: int) -> int:
        """Its frames of so many, before they are planned: of its shards one a split may not be full."""
        return FRAMES_PER_SHARD * max(frames // (FRAMES_PER_SHARD * self.of) - len(SPLITS), 0)


def parse_job(text: str) -> ArrayJob:
    """Job ``i/n``.

    :raises InputError: anything else
    """
    found = re.fullmatch(r"([0-9]{1,9})/([0-9]{1,9})", text)
    if found is None:
        raise InputError(OPTION, repr(text), EXPECTED)
    return ArrayJob(int(found[1]), int(found[2]))


def is_job_folder(name: str) -> bool:
    """Whether :attr:`ArrayJob.folder` may be called so."""
    return re.fullmatch(r"job-[0-9]+-of-[0-9]+", name) is not None


class JobEntry(BaseModel, frozen=True):
    """What a job's manifest says beside what every manifest does.

    :param frames: of the whole dataset
    :param split: pattern of the whole dataset; None for traced paths
    :param sequences: frames of each sequence, which come first and have one split
    """

    frames: Annotated[int, Field(ge=1)]
    split: str | None
    sequences: tuple[Annotated[int, Field(ge=1)], ...] = ()

    def plans(self) -> tuple[ShardPlan, ...]:
        """The shards of the whole dataset.

        :raises InputError: a split pattern that is none
        """
        if self.split is None:
            return plan_shards((PATHS,) * self.frames)
        own = range(sum(self.sequences), self.frames)
        splits = [split_of(number, self.split) for number, count in enumerate(self.sequences) for _ in range(count)]
        return plan_shards([*splits, *(split_of(frame_id, self.split) for frame_id in own)])
