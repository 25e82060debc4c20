"""Reading shards: single frames, streams of frames in bounded memory, and what a shard says about itself."""

from __future__ import annotations

import copy
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from shared.dataset import COMPLEX_ARRAYS, LATER, METADATA_KEY, SCALARS, VECTORS, Box, Frame, Target, row_bytes
from shared.dataset.locations import Location, file_size, open_parquet
from shared.dataset.manifest import check_version, require_as_written
from shared.dataset.schema import BOX_FIELDS, COLUMNS, POWERS, array_shapes, never_null
from shared.physics.errors import InputError
from shared.radar import FrontEnd, Radar, validated
from shared.radar.arrays import AntennaArray
from shared.radar.waveform import Waveform

SELECTABLE = ("range_channel", "velocity", "image", "targets", "boxes", "range_doppler", "cube")
"""Columns that a reader may leave out; the others are a few bytes a frame and always read."""

BATCH_BYTES = 64 << 20
"""Array bytes decoded at a time while streaming: some 30 frames of the default radar, one of its cubes."""

# What pyarrow raises for a file that is missing, cut short or damaged (a damaged name is no UTF-8 any more).
_READ_ERRORS = (pa.ArrowException, OSError, UnicodeDecodeError)


def open_shard(path: Location) -> pq.ParquetFile:
    """The Parquet file, opened; its pages are checked as they are read, the whole file as it is opened first.

    :raises InputError: missing, cut short or no Parquet file, or not as its dataset's manifest says
    """
    if file_size(path) is None:
        raise InputError(path, "no such file", "a Parquet shard")
    try:
        require_as_written(path)
        return open_parquet(path)
    except _READ_ERRORS as error:
        raise InputError(path, f"not readable as Parquet: {error}", "a whole Parquet shard") from error


def read_description(path: Location) -> dict[str, Any]:
    """The JSON description in a shard's schema, its version and its columns checked.

    :raises InputError: not a shard of this format, or of a newer version of it
    """
    with open_shard(path) as file:
        return copy.deepcopy(_description(path, file.schema_arrow))


def frame_from_row(batch: pa.RecordBatch, row: int, shapes: Mapping[str, Sequence[int]]) -> Frame:
    """One row as a frame; its arrays are read-only views of the batch's memory.

    :param shapes: the description's shapes, by column
    """
    names = batch.schema.names
    small = [name for name in names if name in SCALARS or name in LATER or name in VECTORS]
    values: dict[str, Any] = LATER | {name: batch.column(name)[row].as_py() for name in small}
    values.update((name, tuple(values[name])) for name in VECTORS)
    values.update((name, _array(batch, name, row, shapes[name])) for name in shapes)
    targets = _targets(batch, row) if "targets" in names else ()
    return Frame(**values, targets=targets, boxes=_boxes(batch, row) if "boxes" in names else ())


def read_frames(path: Location, columns: Sequence[str] | None = None) -> Iterator[Frame]:
    """The frames of one shard one after the other, in bounded memory.

    :param columns: which of :data:`SELECTABLE` to read, all by default; an array left out has length 0 along its first
        axis (None for ``range_doppler`` and ``cube``), targets and boxes left out are (). ``boxes`` may be asked of a
        dataset that was made before there were any.
    :raises InputError: a file that is missing, damaged or of a newer version; a column that it does not have
    """
    with open_shard(path) as file:
        shapes = _description(path, file.schema_arrow)["shapes"]
        wanted = _wanted_columns(path, file, columns)
        rows = max(1, BATCH_BYTES // max(1, row_bytes(shapes, wanted)))
        try:
            for batch in file.iter_batches(batch_size=rows, columns=wanted, use_threads=False):
                require_finite(path, batch)
                for row in range(len(batch)):
                    yield frame_from_row(batch, row, shapes)
        except _READ_ERRORS as error:
            raise InputError(path, f"damaged: {error}", "a shard as it was written") from error


def read_frame(path: Location, row: int, columns: Sequence[str] | None = None) -> Frame:
    """Frame ``row`` of a shard; only its row group is read. ``columns`` and errors as in :func:`read_frames`."""
    with open_shard(path) as file:
        shapes = _description(path, file.schema_arrow)["shapes"]
        wanted = _wanted_columns(path, file, columns)
        if not 0 <= row < file.metadata.num_rows:
            raise InputError(path, f"row {row}", f"a row from 0 to {file.metadata.num_rows - 1}")
        batch = read_row(path, file, row, wanted)
    require_finite(path, batch)
    return frame_from_row(batch, 0, shapes)


def read_row(path: Location, file: pq.ParquetFile, row: int, columns: Sequence[str]) -> pa.RecordBatch:
    """These columns of one row of an open shard; only its row group is read.

    :raises InputError: a damaged shard, by its path
    """
    group, first = 0, 0
    while row >= first + file.metadata.row_group(group).num_rows:
        first += file.metadata.row_group(group).num_rows
        group += 1
    try:
        table = file.read_row_group(group, columns=columns, use_threads=False)
    except _READ_ERRORS as error:
        raise InputError(path, f"damaged: {error}", "a shard as it was written") from error
    (batch,) = table.slice(row - first, 1).combine_chunks().to_batches()
    return batch


def require_finite(path: Location, batch: pa.RecordBatch) -> None:
    """Refuse what no writer of this package lets pass and another's may: found here, it has a shard and a frame.

    :param batch: rows of a shard, ``frame_id`` among their columns
    :raises InputError: a number that is not finite, or a power below 0, naming shard, frame and column
    """
    for name, column in zip(batch.schema.names, batch.columns, strict=True):
        values = column.flatten() if pa.types.is_fixed_size_list(column.type) else column
        if not pa.types.is_floating(values.type):
            continue
        numbers = np.from_dlpack(values).reshape(len(batch), -1)
        least = 0.0 if name in POWERS else -np.inf
        # The extremes are not finite where any number is not: no array of flags for what is whole.
        low, high = numbers.min(initial=0.0), numbers.max(initial=0.0)
        if np.isfinite(low + high) and low >= least:
            continue
        wrong = ~np.isfinite(numbers) | (numbers < least)
        row = int(np.argmax(wrong.any(axis=1)))
        where, count = f"frame {batch.column('frame_id')[row].as_py()}", np.count_nonzero(wrong[row])
        if name in SCALARS or name in LATER:
            wanted = f"a finite number{' of at least 0' if name in POWERS else ''}"
            raise InputError(path, f"{where}: {name} = {numbers[row, 0]}", wanted)
        raise InputError(path, f"{where}: {name} has {count} values that are not finite", "finite values")


def radar_of(description: Mapping[str, Any], source: object = "description") -> Radar:
    """The radar that a description or a manifest holds (the inverse of ``Radar.metadata``).

    :param source: the file that messages name
    :raises InputError: fields that are missing or that no radar allows
    """
    try:
        stated, u = description["radar"], description["axes"]["u"]
        # u_stop is not among the axes; 12 digits undo the rounding of step = (stop - start) / bins.
        grid = {"u_start": u["start"], "u_stop": round(u["start"] + u["step"] * u["bins"], 12), "bins": u["bins"]}
        fields = {
            "name": stated["name"],
            "waveform": {name: stated[name] for name in Waveform.model_fields},
            # Imperfections of the front end came later: a dataset that does not name them was made without.
            "front_end": {name: stated[name] for name in FrontEnd.model_fields if name in stated},
            "grid": grid,
        }
        for array in ("array", "virtual_sensor"):
            fields[array] = {name: description[array][name] for name in AntennaArray.model_fields}
    except (KeyError, TypeError) as error:
        raise InputError(source, f"no whole radar in the metadata: {error!r}", "the entries of version 1") from error
    radar = validated(Radar, fields, source)
    _check_shapes(description.get("shapes", {}), radar, source)
    return radar


def _check_shapes(shapes: Any, radar: Radar, source: object) -> None:
    """The arrays are those of the radar beside them."""
    for name, shape in array_shapes(radar, 0).items():
        found = shapes.get(name, shape) if isinstance(shapes, dict) else None
        first = 1 if name in ("range_channel", "velocity") else 0  # the first axis of these counts Doppler peaks
        if not isinstance(found, list) or found[first:] != shape[first:]:
            raise InputError(source, f"shapes.{name} = {found}", f"it to end in {shape[first:]}, as its radar has it")


@lru_cache(maxsize=16)
def _parsed(text: bytes) -> Any:
    """The JSON value; shared, not to be changed. To parse 256 positions anew is a tenth of reading a frame."""
    return json.loads(text)


def _description(path: Location, schema: pa.Schema) -> dict[str, Any]:
    metadata = schema.metadata or {}
    if METADATA_KEY not in metadata:
        raise InputError(path, "the schema has no metadata 'sparseradar'", "a shard made by datafactory")
    try:
        description = _parsed(metadata[METADATA_KEY])
    except (ValueError, RecursionError) as error:
        raise InputError(path, f"metadata 'sparseradar' is not JSON: {error}", "a shard made by datafactory") from error
    check_version(path, description)
    _check_columns(path, schema, description)
    return description


def _check_columns(path: Location, schema: pa.Schema, description: Mapping[str, Any]) -> None:
    """Every column that a frame needs, and arrays as long as the description's shapes say."""
    shapes = description.get("shapes", {})
    if not isinstance(shapes, dict) or not all(map(_is_shape, shapes.values())):
        raise InputError(path, "shapes are not lists of lengths by column", "the columns of version 1")
    required = {*SCALARS, *VECTORS, "range_channel", "velocity", "image"}
    if missing := sorted(required - set(schema.names)) or sorted(required - {*SCALARS, *VECTORS} - shapes.keys()):
        raise InputError(path, f"no column or no shape for {missing[0]!r}", "the columns of version 1")
    for column, shape in shapes.items():
        values = math.prod(shape)
        kind = schema.field(column).type if column in schema.names else pa.null()
        if not pa.types.is_fixed_size_list(kind) or kind.list_size != values or kind.value_type != pa.float32():
            raise InputError(path, f"{column} is {kind}", f"a fixed_size_list<float> of {values}, as its shape says")

    # Whatever Arrow calls an element, and whether it may be missing.
    for column, wanted in COLUMNS.items():
        if wanted and column in schema.names and never_null(schema.field(column).type) != never_null(wanted):
            raise InputError(path, f"{column} is {schema.field(column).type}", f"{wanted}")


def _is_shape(value: object) -> bool:
    return isinstance(value, list) and all(type(length) is int and length > 0 for length in value)


def _wanted_columns(path: Location, file: pq.ParquetFile, columns: Sequence[str] | None) -> list[str]:
    present = file.schema_arrow.names
    selectable = [name for name in present if name in SELECTABLE]
    if unknown := sorted(set(columns or ()) - {*selectable, "boxes"}):
        raise InputError(path, f"no column {unknown[0]!r}", f"some of {selectable}")
    chosen = {*SCALARS, *LATER, *VECTORS, *(selectable if columns is None else columns)}
    return [name for name in present if name in chosen]


def _array(batch: pa.RecordBatch, name: str, row: int, shape: Sequence[int]) -> NDArray[Any] | None:
    if name not in batch.schema.names:
        if name in ("range_doppler", "cube"):
            return None
        values: NDArray[Any] = np.empty((0, *shape[1:]), dtype=np.float32)
    else:
        # to_numpy would import pandas where there is one.
        values = np.from_dlpack(batch.column(name).slice(row, 1).flatten()).reshape(shape)
    return values.view(np.complex64)[..., 0] if name in COMPLEX_ARRAYS else values


def _targets(batch: pa.RecordBatch, row: int) -> tuple[Target, ...]:
    structs = batch.column("targets").slice(row, 1).flatten()
    return tuple(Target(*values) for values in zip(*(field.to_pylist() for field in structs.flatten()), strict=True))


def _boxes(batch: pa.RecordBatch, row: int) -> tuple[Box, ...]:
    return tuple(map(box_of, batch.column("boxes")[row].as_py()))


def box_of(values: Mapping[str, Any]) -> Box:
    """An element of the column ``boxes`` as a value.

    :param values: by the fields' names
    """
    fields: list[Any] = [tuple(values[name]) if isinstance(values[name], list) else values[name] for name in BOX_FIELDS]
    return Box(*fields)
