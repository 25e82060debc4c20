"""Detections as an Arrow column, as CSV and as point clouds (PCD, ASCII, version 0.7)."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from shared.dataset.writing import write_text
from shared.signal.ego_motion import EgoMotion
from trainer.run.detections import Detections

CSV_FILE = "detections.csv"
UNITS = {
    "range": "m", "u": "sin(azimuth)", "velocity": "m/s, receding", "amplitude_db": "dB re 1 sqrt(W)",
    "u_std": "sin(azimuth), Cramer-Rao", "probability": "that an echo stands there",
    "range_std": "m, Cramer-Rao, or of a bin", "velocity_std": "m/s, Cramer-Rao, or of a Doppler cell",
    "moving": "probability of something that moves; null where the sensor's motion is not known",
    "doppler_cell": "index on the rising velocity axis", "snr_db": "dB over the noise of all channels added",
    "unlike_ways_db": "dB, what an echo of unlike ways out and back explains more of the cell",
}  # fmt: skip
"""Of the fields of a detection, in their order."""
KINDS = {"doppler_cell": pa.int64()}
"""Of those that are no numbers of double precision."""
DETECTION = pa.struct([
    pa.field(name, KINDS.get(name, pa.float64()), nullable=name == "moving") for name in UNITS
])  # fmt: skip
COLUMN = pa.field("detections", pa.list_(pa.field("element", DETECTION, nullable=False)), nullable=False)
"""list<struct<range, u, velocity, amplitude_db, u_std, probability, range_std, velocity_std, moving, doppler_cell,
snr_db, unlike_ways_db>>, strongest first."""
MOTION_UNITS = {"forward": "m/s", "left": "m/s", "forward_std": "m/s, 0 if told", "left_std": "m/s, 0 if told"}
"""Of the sensor's velocity in the radar frame."""
MOTION = pa.field("motion", pa.struct([pa.field(name, pa.float64(), nullable=False) for name in MOTION_UNITS]))
"""Null where it is not known."""
PCD_FIELDS = ("x", "y", "z", "intensity", "velocity", "probability", "moving")


def plain_array(values: NDArray, known: NDArray[np.bool_] | None = None) -> pa.Array:
    """Values one after the other, null where not ``known``. ``pa.array`` would import pandas where there is one."""
    valid = None if known is None else pa.py_buffer(np.packbits(known, bitorder="little"))
    kind, data = pa.from_numpy_dtype(values.dtype), pa.py_buffer(np.ascontiguousarray(values))
    return pa.Array.from_buffers(kind, values.size, [valid, data])


def _values(found: Detections) -> list[NDArray]:
    """In the order of :data:`UNITS`, which is that of the fields."""
    return [getattr(found, field.name) for field in fields(found)]


def records(found: Detections) -> list[dict[str, float | None]]:
    """One dictionary a detection, ``moving`` None where it is not known."""
    rows = zip(*(values.tolist() for values in _values(found)), strict=True)
    return [
        {name: None if math.isnan(value) else value for name, value in zip(UNITS, row, strict=True)} for row in rows
    ]


def column(found: Detections) -> pa.Array:
    """One frame's entry of the column ``detections``."""
    named = list(DETECTION)
    filled = [
        plain_array(values.astype(field.type.to_pandas_dtype()), ~np.isnan(values) if field.nullable else None)
        for field, values in zip(named, _values(found), strict=True)
    ]
    rows = pa.StructArray.from_arrays(filled, fields=named)
    return pa.ListArray.from_arrays(plain_array(np.array([0, len(found)], np.int32)), rows, type=COLUMN.type)


def motion_column(motion: EgoMotion | None) -> pa.Array:
    """One frame's entry of the column ``motion``."""
    values = (0.0,) * 4 if motion is None else (motion.forward_mps, motion.left_mps, *motion.std_mps)
    filled = [plain_array(np.array([value], np.float64)) for value in values]
    return pa.Array.from_buffers(MOTION.type, 1, [pa.py_buffer(b"\0" if motion is None else b"\1")], children=filled)


def write_csv(path: Path, frames: Sequence[tuple[int, Detections]]) -> None:
    """One line a detection, after its frame's index; an empty field where ``moving`` is not known."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["frame_id", *UNITS])
    for frame_id, found in frames:
        writer.writerows([frame_id, *row.values()] for row in records(found))
    write_text(path, text.getvalue())


def write_pcd(path: Path, found: Detections) -> None:
    """A cloud of one frame in the radar frame: x forward, y left [m], z 0, intensity in dB re 1 sqrt(W).

    The angle of a line of elements along y is that to the y axis: targets are drawn in the plane z = 0.
    """
    points = np.stack(
        [
            found.range_m * np.sqrt(np.maximum(1.0 - found.u**2, 0.0)), found.range_m * found.u, np.zeros(len(found)),
            found.amplitude_db, found.velocity, found.probability, found.moving,
        ],
        axis=1,
    )  # fmt: skip
    size = len(PCD_FIELDS)
    header = [
        "# .PCD v0.7 - Point Cloud Data file format", "VERSION 0.7", f"FIELDS {' '.join(PCD_FIELDS)}",
        f"SIZE{' 4' * size}", f"TYPE{' F' * size}", f"COUNT{' 1' * size}", f"WIDTH {len(found)}", "HEIGHT 1",
        "VIEWPOINT 0 0 0 1 0 0 0", f"POINTS {len(found)}", "DATA ascii",
    ]  # fmt: skip
    lines = [" ".join(f"{value:.7g}" for value in point) for point in points.tolist()]
    write_text(path, "\n".join([*header, *lines]) + "\n")
