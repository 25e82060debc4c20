"""The dataset format, version 1: one frame as a value, and its Arrow schema and columns.

Array columns are plain ``fixed_size_list<float>`` in C order, complex values as (real, imaginary) pairs; their nested
shapes, the radar and the axes stand as JSON in the schema's metadata under the key ``sparseradar``, so that one shard
alone can be understood by any Parquet reader. (The Arrow tensor extension would carry the shapes itself, but DuckDB
drops them and Hugging Face datasets refuses the type.) No column and no element is nullable: measured, that saves a
Parquet reader a quarter of its time.

:mod:`shared.dataset.reading` is the way back, :mod:`shared.dataset.folder` a whole dataset.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pyarrow as pa
from jaxtyping import Float64
from numpy.typing import NDArray

from shared.physics.errors import InputError, Told
from shared.processes.defaults import STORES
from shared.radar import Radar

VERSION = 1
"""Format version that this code writes, and the newest that it reads."""

METADATA_KEY = b"sparseradar"
"""Key of the JSON description in the Parquet schema's metadata."""

KINDS = ("scene", "points")

COMPLEX_ARRAYS = ("range_channel", "cube")
"""Array columns of complex64, stored as float pairs; the other array columns are float32."""

SCALARS = ("frame_id", "kind", "scene", "seed", "image_peak", "noise_power")
POWERS = ("image_peak", "noise_power")
"""Scalar columns that are at least 0."""
LATER = {"time": math.nan, "sequence": -1}
"""Scalar columns that came later, with what a frame of a dataset without them has: its time is not known."""

VECTORS = {"sensor_position": 3, "sensor_velocity": 3, "sensor_orientation": 4}

TARGET_FIELDS = ("range", "u", "velocity", "amplitude_db", "object")

BOX_FIELDS = {
    "center": pa.list_(pa.float64(), 3),
    "size": pa.list_(pa.float64(), 3),
    "yaw": pa.float64(),
    "velocity": pa.list_(pa.float64(), 3),
    "class": pa.string(),
    "object": pa.string(),
    "power": pa.float64(),
}
"""Of the elements of ``boxes``, with their types. The column came later: a dataset without it has no boxes."""

COLUMNS: dict[str, pa.DataType | None] = {
    "frame_id": pa.int64(),
    "kind": pa.string(),
    "scene": pa.string(),
    "seed": pa.int64(),
    **{name: pa.list_(pa.float64(), size) for name, size in VECTORS.items()},
    "time": pa.float64(),
    "sequence": pa.int64(),
    "range_channel": None,
    "velocity": None,
    "image": None,
    "image_peak": pa.float64(),
    "noise_power": pa.float64(),
    "targets": pa.list_(pa.struct([*((name, pa.float64()) for name in TARGET_FIELDS[:-1]), ("object", pa.string())])),
    "boxes": pa.list_(pa.struct(list(BOX_FIELDS.items()))),
    "range_doppler": None,
    "cube": None,
}
"""All columns in their order, with their types; None for arrays, whose lengths depend on the radar."""

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Target:
    """What is really there at one place of a frame, at mid-frame.

    :param range_m: distance from the radar frame's origin [m]
    :param u: y / range, sin(azimuth) at elevation 0; left of the radar is positive
    :param velocity_mps: range rate [m/s], receding is positive
    :param amplitude_db: 20 log10 of the amplitude in sqrt(W) [dBW]
    :param object: name of the object, "" for a cell of the truth image
    """

    range_m: float
    u: float
    velocity_mps: float
    amplitude_db: float
    object: str = ""


AROUND = np.array([(0.5, 0.5), (-0.5, 0.5), (-0.5, -0.5), (0.5, -0.5)])
"""The corners of a footprint, counter-clockwise from the front left one, over length and width."""


@dataclass(frozen=True)
class Box:
    """An object that moves or has a class: the box around it, at mid-frame, in the radar frame.

    :param center: x, y, z of its middle [m]
    :param size: length along its own forward, width along its left, height along its up [m]
    :param yaw: from the radar's x to its forward, towards y [rad], -pi to pi
    :param velocity: x, y, z relative to the radar [m/s], so that its part along ``center`` is the range rate
    :param class_name: e.g. "car"; "other" where the scene states none. The column's field is named ``class``.
    :param object: its name in the scene
    :param power: of the paths that it sends back [W], before the processing; 0 where the radar does not see it
    """

    center: Vector
    size: Vector
    yaw: float
    velocity: Vector
    class_name: str
    object: str
    power: float = 0.0

    def footprint(self, points: int = 1) -> Float64[np.ndarray, "outline 2"]:
        """[4 * points, 2] x and y [m] along its outline seen from above, counter-clockwise from its front left corner.

        :param points: of each side, its first corner among them
        """
        share = np.arange(points)[:, None] / points
        sides = zip(AROUND, np.roll(AROUND, -1, axis=0), strict=True)
        around = np.concatenate([(1.0 - share) * first + share * second for first, second in sides])
        along = around * np.array(self.size[:2])
        cosine, sine = np.cos(self.yaw), np.sin(self.yaw)
        return np.array(self.center[:2]) + along @ np.array([[cosine, sine], [-sine, cosine]])

    def range_and_u(self) -> tuple[Float64[np.ndarray, " outline"], Float64[np.ndarray, " outline"]]:
        """[64] range [m] and u = sin(azimuth) along its footprint, at the height of its middle."""
        x, y = self.footprint(16).T
        range_m = np.sqrt(x**2 + y**2 + self.center[2] ** 2)
        return range_m, y / np.maximum(range_m, 1e-9)


@dataclass(frozen=True, eq=False)
class Frame(Told):
    """One frame of a dataset. An array column that was not read has length 0 along its first axis (or is None).

    :param frame_id: index in the dataset
    :param kind: "scene" or "points"
    :param scene: scene name
    :param seed: the frame's own seed
    :param sensor_position: world frame [m]
    :param sensor_velocity: world frame [m/s]
    :param sensor_orientation: quaternion w, x, y, z from the radar frame to the world frame
    :param time: of the scene, at the start of the frame [s]; NaN in a dataset made before there was this column
    :param sequence: number of the sequence of frames along one track; -1 of a frame of its own
    :param range_channel: [D, R, C] complex64 at the D strongest Doppler peaks of each range bin, with noise [sqrt(W)]
    :param velocity: [D, R] float32 velocity of those Doppler cells [m/s]
    :param image: [R, U] float32 truth magnitude, noise free, linear, relative to ``image_peak``
    :param image_peak: the magnitude that 1.0 in ``image`` stands for [sqrt(W)]
    :param noise_power: of one channel in one range-Doppler cell [W]
    :param targets: strongest first
    :param boxes: objects within the range and the field of view, in the scene's order
    :param range_doppler: [R, chirps] float32 mean magnitude over channels [sqrt(W)], if stored
    :param cube: [chirp, sample, C] complex64 IF samples [sqrt(W)], if stored
    """

    frame_id: int
    kind: str
    scene: str
    seed: int
    sensor_position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    sensor_velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    sensor_orientation: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    range_channel: NDArray[np.complex64] = field(default_factory=lambda: np.empty(0, np.complex64))
    velocity: NDArray[np.float32] = field(default_factory=lambda: np.empty(0, np.float32))
    image: NDArray[np.float32] = field(default_factory=lambda: np.empty(0, np.float32))
    image_peak: float = 0.0
    noise_power: float = 0.0
    targets: tuple[Target, ...] = ()
    boxes: tuple[Box, ...] = ()
    range_doppler: NDArray[np.float32] | None = None
    cube: NDArray[np.complex64] | None = None
    time: float = 0.0
    sequence: int = -1

    def __str__(self) -> str:
        place = ", ".join(f"{metres:.1f}" for metres in self.sensor_position)
        arrays = ("range_channel", "velocity", "image", "range_doppler", "cube")
        found = {name: getattr(self, name) for name in arrays}
        read = (f"{name} {list(array.shape)}" for name, array in found.items() if array is not None and len(array))
        return "\n".join([
            f"frame {self.frame_id}: {self.kind}, {self.scene}, seed {self.seed}, {self.time:.3f} s",
            f"sensor at ({place}) m, {math.hypot(*self.sensor_velocity):.1f} m/s",
            f"{len(self.targets)} targets, {len(self.boxes)} boxes, noise {self.noise_power:.2g} W a channel and cell",
            f"arrays: {', '.join(read) or 'none was read'}",
        ])  # fmt: skip


def array_shapes(radar: Radar, doppler_peaks: int) -> dict[str, list[int]]:
    """Of every array column, complex values as pairs."""
    waveform, channels = radar.waveform, radar.array.channels
    return {
        "range_channel": [doppler_peaks, waveform.range_bins, channels, 2],
        "velocity": [doppler_peaks, waveform.range_bins],
        "image": [waveform.range_bins, radar.grid.bins],
        "range_doppler": [waveform.range_bins, waveform.chirps],
        "cube": [waveform.chirps, waveform.samples, channels, 2],
    }


def description(radar: Radar, doppler_peaks: int, store: str, extra: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """What a shard says about itself: version, shapes, radar, array, virtual sensor and axes, as plain JSON values.

    :param doppler_peaks: D, the Doppler cells kept of every range bin
    :param store: "range-channel" or with one more array column, "range-doppler" or "cube"
    :param extra: further entries, e.g. conventions in words; none may replace one of the above
    """
    if store not in STORES:
        raise InputError("--store", f"{store!r}", f"one of {list(STORES)}")
    optional = {"range_doppler": "range-doppler", "cube": "cube"}
    every = array_shapes(radar, doppler_peaks)
    shapes = {name: shape for name, shape in every.items() if optional.get(name, store) == store}
    result = {"version": VERSION, "shapes": shapes, **radar.metadata()}
    extra = dict(extra or {})
    if replaced := sorted(result.keys() & extra.keys()):
        raise ValueError(f"extra replaces {replaced}; expected new names")
    return result | extra


def arrow_schema(description: Mapping[str, Any]) -> pa.Schema:
    """The Parquet schema of shards with this description (:func:`description`), the same bytes for the same content."""
    shapes = description["shapes"]
    types = {
        name: pa.list_(pa.float32(), math.prod(shapes[name])) if kind is None else kind
        for name, kind in COLUMNS.items()
        if kind is not None or name in shapes
    }
    fields = [_required(name, never_null(kind)) for name, kind in types.items()]
    text = json.dumps(description, sort_keys=True, allow_nan=False)
    return pa.schema(fields, metadata={METADATA_KEY: text.encode()})


def never_null(kind: pa.DataType) -> pa.DataType:
    """The type with no part of it nullable, and elements of one name."""
    if pa.types.is_struct(kind):
        return pa.struct([_required(field.name, never_null(field.type)) for field in kind])
    if pa.types.is_fixed_size_list(kind):
        return pa.list_(_required("element", never_null(kind.value_type)), kind.list_size)
    return pa.list_(_required("element", never_null(kind.value_type))) if pa.types.is_list(kind) else kind


def to_record_batch(frames: Sequence[Frame], schema: pa.Schema) -> pa.RecordBatch:
    """Frames as rows of ``schema`` (:func:`arrow_schema`); the arrays of a single frame are not copied.

    :raises InputError: a shape, type or kind that the schema does not allow, or a value that is not finite, naming the
        frame and the column
    """
    shapes = json.loads(schema.metadata[METADATA_KEY])["shapes"]
    columns = []
    for item in schema:
        name = item.name
        if name in shapes:
            flat = [_flat_array(frame, name, tuple(shapes[name])) for frame in frames]
            values = flat[0] if len(flat) == 1 else np.concatenate(flat) if flat else np.empty(0, np.float32)
            columns.append(pa.FixedSizeListArray.from_arrays(pa.array(values), type=item.type))
        elif name in VECTORS:
            vectors = np.array([_vector(frame, name) for frame in frames], dtype=np.float64)
            columns.append(pa.FixedSizeListArray.from_arrays(pa.array(vectors.reshape(-1)), type=item.type))
        elif name == "targets":
            rows = [[_target_row(frame, target) for target in frame.targets] for frame in frames]
            columns.append(pa.array(rows, type=item.type))
        elif name == "boxes":
            rows = [[_box_row(frame, box) for box in frame.boxes] for frame in frames]
            columns.append(pa.array(rows, type=item.type))
        else:
            columns.append(pa.array([_scalar(frame, name) for frame in frames], type=item.type))
    return pa.RecordBatch.from_arrays(columns, schema=schema)


def _required(name: str, kind: pa.DataType) -> pa.Field:
    return pa.field(name, kind, nullable=False)


def _flat_array(frame: Frame, name: str, shape: tuple[int, ...]) -> NDArray[np.float32]:
    value = getattr(frame, name)
    if name in COMPLEX_ARRAYS:
        shape = shape[:-1]  # the last axis holds the real and imaginary part
    dtype = np.dtype(np.complex64 if name in COMPLEX_ARRAYS else np.float32)
    if not isinstance(value, np.ndarray) or value.dtype != dtype or value.shape != shape:
        found = f"{value.dtype} {list(value.shape)}" if isinstance(value, np.ndarray) else repr(value)
        raise InputError(f"frame {frame.frame_id}", f"{name} is {found}", f"{dtype} {list(shape)}")
    if not np.isfinite(value).all():
        count = int(np.count_nonzero(~np.isfinite(value)))
        raise InputError(f"frame {frame.frame_id}", f"{name} has {count} values that are not finite", "finite values")
    return np.ascontiguousarray(value).reshape(-1).view(np.float32)


def _vector(frame: Frame, name: str) -> tuple[float, ...]:
    vector = tuple(float(component) for component in getattr(frame, name))
    if len(vector) != VECTORS[name] or not all(map(math.isfinite, vector)):
        raise InputError(f"frame {frame.frame_id}", f"{name} = {vector}", f"{VECTORS[name]} finite numbers")
    return vector


def _target_row(frame: Frame, target: Target) -> dict[str, Any]:
    values = (target.range_m, target.u, target.velocity_mps, target.amplitude_db)
    if not all(map(math.isfinite, values)):
        raise InputError(f"frame {frame.frame_id}", f"{target}", "finite numbers")
    return dict(zip(TARGET_FIELDS, (*map(float, values), target.object), strict=True))


def _box_row(frame: Frame, box: Box) -> dict[str, Any]:
    center, size, velocity = (tuple(map(float, vector)) for vector in (box.center, box.size, box.velocity))
    if not all(map(math.isfinite, (*center, *size, *velocity, box.yaw, box.power))):
        raise InputError(f"frame {frame.frame_id}", f"{box}", "finite numbers")
    if len(center) != 3 or len(size) != 3 or len(velocity) != 3 or min(*size, box.power) < 0.0:
        raise InputError(f"frame {frame.frame_id}", f"{box}", "three numbers each; sizes and power of at least 0")
    values = (center, size, float(box.yaw), velocity, box.class_name, box.object, float(box.power))
    return dict(zip(BOX_FIELDS, values, strict=True))


def _scalar(frame: Frame, name: str) -> int | float | str:
    value = getattr(frame, name)
    if name == "kind" and value not in KINDS:
        raise InputError(f"frame {frame.frame_id}", f"kind = {value!r}", f"one of {list(KINDS)}")
    if name in POWERS and not (math.isfinite(value) and value >= 0.0):
        raise InputError(f"frame {frame.frame_id}", f"{name} = {value!r}", "a finite number of at least 0")
    if name == "time" and not math.isfinite(value):
        raise InputError(f"frame {frame.frame_id}", f"{name} = {value!r}", "a finite number")
    return value


def row_bytes(shapes: Mapping[str, Iterable[int]], columns: Iterable[str] | None = None) -> int:
    """Bytes of one row's array columns in memory, all or those named."""
    names = shapes.keys() if columns is None else shapes.keys() & set(columns)
    return sum(4 * math.prod(shapes[name]) for name in names)
