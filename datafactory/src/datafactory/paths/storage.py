"""PathTables on disk: one Parquet row a frame, so that another radar can be rendered from the same trace.

Lists have the length of the frame's own paths; vectors are flattened in C order, complex numbers split into real and
imaginary. A path that one point scattered has its first point where its last one is: ``scattered_tx_point`` holds those
of the others alone, which ``scattered_two_points`` marks. Amplitudes are isotropic, as in the table; the wavelength
they were traced at, to which they are proportional, stands beside them.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from datafactory.paths.candidates import Candidates
from datafactory.paths.table import PathTable, ScatteredPaths, SpecularPaths
from datafactory.scenes.boxes import SeenThing
from datafactory.scenes.poses import Pose
from shared.dataset.locations import Location
from shared.dataset.reading import open_shard, read_row
from shared.physics.errors import InputError
from shared.physics.vectors import Mask, Real

OF_BOTH: dict[str, tuple[int, ...]] = {"amplitude": (2,), "depth": (), "object_index": (), "kinds": (), "candidate": ()}
SHAPES = {
    "scattered": {
        "tx_point": (3,), "rx_point": (3,), "tx_velocity": (3,), "rx_velocity": (3,), "between_m": (),
        "between_rate_mps": (), **OF_BOTH,
    },
    "specular": {"image": (3,), "image_velocity": (3,), "axes": (3, 3), **OF_BOTH},
    "candidates": {"family": (), "departure": (3,), "arrival": (3,), "range_m": (), "power": ()},
}  # fmt: skip
"""Trailing shape of each list column; ``amplitude`` holds (real, imaginary), ``tx_point`` as many as are marked."""
TWO_POINTS = "scattered_two_points"
CONSTANT = ("tx_velocity", "rx_velocity", "between_m", "between_rate_mps", "image_velocity")
"""Columns with few values, most of them that of the standing world."""

INTEGERS = {"depth": np.int8, "object_index": np.int32, "kinds": np.uint8, "candidate": np.int32, "family": np.uint8}

VERSION = b"8"
"""Of the paths' columns; 2 added ``kinds``, 3 ``scene_number``, 4 ``sequence``, 5 ``things``, 6
``scattered_two_points``, 7 the candidates, and with 8 specular paths count from the origin."""

AS_IT_IS = ("frame_id", "scene", "scene_number", "sequence", "seed", "wavelength_m", "point_targets")
"""Columns that a frame has under the same name."""

THING = pa.struct(
    [
        ("name", pa.string()),
        ("class_name", pa.string()),
        *((name, pa.list_(pa.float64(), 3)) for name in ("center", "size", "forward", "left", "up", "velocity")),
        ("indices", pa.list_(pa.int32())),
    ]
)
"""A :class:`datafactory.scenes.boxes.SeenThing`."""


@dataclass(frozen=True)
class TracedFrame:
    """One traced frame.

    :param frame_id: index in the dataset
    :param scene: scene name
    :param scene_number: of the scene among the run's
    :param seed: the frame's own seed
    :param pose: where the radar stood
    :param wavelength_m: at which it was traced
    :param point_targets: number of the scene's point targets, the last of ``table.objects``
    :param things: what gets a box
    :param sequence: number of the sequence it belongs to; -1 for none
    """

    frame_id: int
    scene: str
    scene_number: int
    seed: int
    pose: Pose
    wavelength_m: float
    point_targets: int
    table: PathTable
    things: tuple[SeenThing, ...] = ()
    sequence: int = -1


def paths_schema() -> pa.Schema:
    """Columns of a paths shard."""
    triple, number = pa.list_(pa.float64(), 3), pa.int64()
    fields = [
        pa.field(name, kind)
        for name, kind in (
            ("frame_id", number), ("scene", pa.string()), ("scene_number", number), ("sequence", number),
            ("seed", number), ("position", triple), ("velocity", triple), ("yaw_pitch_roll_deg", triple),
            ("time_s", pa.float64()), ("wavelength_m", pa.float64()), ("point_targets", number),
            ("objects", pa.list_(pa.string())), ("counts", pa.map_(pa.string(), number)), ("things", pa.list_(THING)),
        )
    ]  # fmt: skip
    for kind, columns in SHAPES.items():
        whole, real = (pa.uint8(), pa.float32()) if kind == "candidates" else (pa.int32(), pa.float64())
        fields += [pa.field(f"{kind}_{name}", pa.list_(whole if name in INTEGERS else real)) for name in columns]
    fields.insert(-len(SHAPES["candidates"]), pa.field(TWO_POINTS, pa.list_(pa.bool_())))
    return pa.schema(fields, metadata={b"sparseradar_paths": VERSION})


def writer_options() -> dict[str, Any]:
    """How a paths shard is written: bytes of equal weight side by side where values differ, else a dictionary.

    What that saves: docs/own-radar.md.
    """
    columns = [(f"{kind}_{name}", name) for kind, names in SHAPES.items() for name in names]
    whole = {*CONSTANT, *INTEGERS}
    few = [f"{column}.list.element" for column, name in columns if name in whole]
    many = [f"{column}.list.element" for column, name in columns if name not in whole]
    return {"compression": "zstd", "use_dictionary": few, "use_byte_stream_split": many, "write_statistics": False}


def to_row(frame: TracedFrame) -> dict[str, Any]:
    """The frame as a row of :func:`paths_schema`."""
    pose, table = frame.pose, frame.table
    two_points = _differ(table.scattered.tx_point, table.scattered.rx_point)
    row: dict[str, Any] = {
        **{name: getattr(frame, name) for name in AS_IT_IS},
        "position": list(pose.position),
        "velocity": list(pose.velocity),
        "yaw_pitch_roll_deg": [pose.yaw_deg, pose.pitch_deg, pose.roll_deg],
        "time_s": pose.time_s,
        "objects": list(table.objects),
        "counts": sorted(table.counts.items()),
        "things": [vars(thing) for thing in frame.things],
    }
    for kind, columns in SHAPES.items():
        for name in columns:
            values = getattr(getattr(table, kind), name)
            if name == "amplitude":
                values = np.stack([values.real, values.imag], axis=-1)
            elif name == "tx_point":
                values = values[two_points]
            row[f"{kind}_{name}"] = np.ascontiguousarray(values).ravel()
    row[TWO_POINTS] = two_points
    return row


def _differ(first: Real, second: Real) -> Mask:
    """[K] whether two vectors [K, 3] differ in any bit."""
    ours, theirs = (np.ascontiguousarray(vectors, dtype=np.float64).view(np.int64) for vectors in (first, second))
    return np.any(ours != theirs, axis=1)


def from_row(batch: pa.RecordBatch) -> TracedFrame:
    """The way back from a batch of one row of :func:`paths_schema`."""

    def values_of(column: str) -> NDArray:
        values: NDArray = batch.column(column).flatten().to_numpy(zero_copy_only=False)
        return values

    parts: dict[str, dict[str, Any]] = {}
    for kind, columns in SHAPES.items():
        real, parts[kind] = np.float32 if kind == "candidates" else np.float64, {}
        for name, shape in columns.items():
            values = values_of(f"{kind}_{name}").astype(INTEGERS.get(name, real), copy=False).reshape(-1, *shape)
            parts[kind][name] = values[:, 0] + 1j * values[:, 1] if name == "amplitude" else values
    scattered = parts["scattered"]
    two_points = values_of(TWO_POINTS).astype(bool)
    scattered["tx_point"] = _with_one_point(scattered["tx_point"], scattered["rx_point"], two_points)
    arrays = tuple(f"{kind}_" for kind in SHAPES)
    (row,) = batch.select([field.name for field in batch.schema if not field.name.startswith(arrays)]).to_pylist()
    yaw, pitch, roll = row["yaw_pitch_roll_deg"]
    return TracedFrame(
        **{name: row[name] for name in AS_IT_IS},
        pose=Pose(tuple(row["position"]), yaw, pitch, roll, tuple(row["velocity"]), row["time_s"]),
        table=PathTable(
            scattered=ScatteredPaths(**parts["scattered"]),
            specular=SpecularPaths(**parts["specular"]),
            objects=tuple(row["objects"]),
            counts=dict(row["counts"]),
            candidates=Candidates(**parts["candidates"]),
        ),
        things=tuple(_thing(values) for values in row["things"]),
    )


def _with_one_point(stored: Real, rx_point: Real, two_points: Mask) -> Real:
    """[K, 3] first points: those stored where a path has two, else its last point."""
    if len(two_points) != len(rx_point) or np.count_nonzero(two_points) != len(stored):
        raise ValueError(f"{len(stored)} first points and {len(two_points)} marks for {len(rx_point)} paths")
    tx_point = rx_point.copy()
    tx_point[two_points] = stored
    return tx_point


def _thing(values: dict[str, Any]) -> SeenThing:
    fields: dict[str, Any] = {name: tuple(v) if isinstance(v, list) else v for name, v in values.items()}
    return SeenThing(**fields)


def read_paths(path: Location) -> Iterator[TracedFrame]:
    """The frames of a paths shard, one at a time.

    :raises InputError: a file that is not a paths shard
    """
    with _opened(path) as file:
        for group in range(file.num_row_groups):
            for batch in file.read_row_group(group).to_batches(max_chunksize=1):
                yield _understood(path, batch)


def read_frame_paths(path: Location, row: int) -> TracedFrame:
    """The frame in one row of a paths shard; of the others only the row group that it shares with them is read.

    :raises InputError: a file that is not a paths shard, or that has fewer rows
    """
    with _opened(path) as file:
        rows = file.metadata.num_rows
        if not 0 <= row < rows:
            raise InputError(path, f"{rows} rows, row {row} was asked for", "an undamaged paths shard")
        return _understood(path, read_row(path, file, row, file.schema_arrow.names))


def _understood(path: Location, batch: pa.RecordBatch) -> TracedFrame:
    try:
        return from_row(batch)
    except (ValueError, TypeError, ArithmeticError) as error:
        raise InputError(path, f"a row is not understood: {error}", "an undamaged paths shard") from error


def read_places(path: Location) -> list[tuple[int, int, int]]:
    """(frame index, scene number, sequence) of every row of a paths shard.

    :raises InputError: a file that is not a paths shard
    """
    names = ["frame_id", "scene_number", "sequence"]
    with _opened(path) as file:
        rows = file.read(names)
        if any(column.null_count for column in rows.columns):
            raise InputError(path, f"rows without {' or '.join(names)}", "an undamaged paths shard")
        return list(zip(*(rows[name].to_pylist() for name in names), strict=True))


@contextmanager
def _opened(path: Location) -> Iterator[pq.ParquetFile]:
    try:
        with open_shard(path) as file:
            found = (file.schema_arrow.metadata or {}).get(b"sparseradar_paths")
            if found is None:
                raise InputError(path, "holds no traced paths", "a shard under paths/ written by datafactory trace")
            if found != VERSION:
                raise InputError(path, f"paths of version {found!r}", f"version {VERSION!r}: trace again")
            there = {field.name: field.type for field in file.schema_arrow}
            for name, kind in ((field.name, field.type) for field in paths_schema()):
                if there.get(name) != kind:
                    raise InputError(path, f"column {name!r} is {there.get(name, 'missing')}", f"{kind}")
            yield file
    except (OSError, pa.ArrowException, UnicodeDecodeError) as error:  # a damaged name is no UTF-8 any more
        raise InputError(path, f"not readable as Parquet: {error}", "an undamaged paths shard") from error
