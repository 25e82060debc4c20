"""The sweep as a table and as files; its picture is :mod:`datafactory.accuracy.chart`."""

from __future__ import annotations

import csv
import json
from collections.abc import Collection, Sequence
from dataclasses import asdict, fields
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from datafactory.accuracy.row import Row
from shared.dataset.writing import atomic

HEADINGS = (
    "knob", "setting", "s/frame", "cube dB", "image dB", "power dB", "image L2 dB", "cell L1 dB", "L1 r^4 dB",
    "bias dB", "plan dB", "detections %", "rows %", "peak MB", "paths", "work",
)  # fmt: skip
EXPLANATION = (
    "A frame on one core, median seconds: write, and trace on a GPU, on the wall clock, the rest in processor time. "
    "* is the default. Errors are the largest over the frames. An effect or another way is timed in turn with a frame "
    "without that change (seconds_beside in the files): times that lie minutes apart differ by more.",
    "Signal knobs, on the same paths: cube is relative L2; image the largest difference over the peak, in the same "
    "Doppler cells. They are varied around an unpruned cube at 1e-6 and a truth of 6 terms.",
    "Power knobs change the paths, and the ray count changes the speckle realisation. Measured is the power in a "
    "resolution cell, summed over its paths without phase, of one realisation of the rays against its average over "
    "realisations of many more: cube and image L2 are relative L2 of the amplitudes, rms over realisations, "
    "image is the largest difference over the peak, mean over realisations, the reference's own variance subtracted; "
    "cell L1 is sum |P - P_ref| / sum P_ref, mean over realisations, L1 r^4 the same weighted by range^4; bias is of "
    "the total power. Sphere rays are those of the solver's own lattice, of which the front half counts as it does for "
    "the fan; lattice all around is what the fan's half space leaves out. Depth, surfaces and effects are held against "
    "the default with the same rays (depth against the deepest). surface_phase turns phases alone: it has no error in "
    "power. The change in detections contains that of speckle.",
    "plan: what leaving the effect out of the first frame changes, as datafactory plan says it: the power in a cell "
    "over the strongest cell's, 0 dB at most. Of effects on the paths the errors beside it are between two traces.",
    "front: the cheapest settings, by counted work, whose three errors (power: that of the amplitude in a cell) stay "
    "below a level, all at once; with the same paths rays and depth stay the default's. Times are with its own rays.",
    "rows: Doppler cells chosen otherwise, among rows with a detection. Peak: growth of the resident set in any stage. "
    "Work: counted multiply-adds.",
)


def table_rows(rows: Sequence[Row]) -> list[tuple[str, ...]]:
    """The rows as text under HEADINGS."""
    return [
        (
            row.knob,
            row.setting + (" *" if row.default else ""),
            f"{row.seconds:.2f}",
            f"{row.cube_error_db:.1f}",
            f"{row.image_error_db:.1f}",
            "" if row.power_error_db is None else f"{row.power_error_db:.1f}",
            f"{row.image_l2_db:.1f}",
            "" if row.power_l1_db is None else f"{row.power_l1_db:.1f}",
            "" if row.power_l1_range_weighted_db is None else f"{row.power_l1_range_weighted_db:.1f}",
            f"{row.power_bias_db:+.3f}",
            "" if row.plan_db is None else f"{row.plan_db:.1f}",
            f"{row.detections_changed:.1f}",
            f"{row.doppler_rows_changed:.1f}",
            f"{row.peak_mb:.0f}",
            f"{row.paths:.0f}",
            f"{row.work:.2e}",
        )
        for row in rows
    ]


def write_tables(rows: Sequence[Row], directory: Path) -> list[Path]:
    """``accuracy.parquet`` and ``accuracy.csv``; in the latter ``stage_seconds`` is JSON.

    :raises OSError: the folder cannot be written
    """
    parquet, text = directory / "accuracy.parquet", directory / "accuracy.csv"
    with atomic(parquet) as partial:
        pq.write_table(pa.Table.from_pylist([asdict(row) for row in rows]), partial)
    with atomic(text) as partial, partial.open("w", encoding="utf-8", newline="") as handle:
        writer = csv.DictWriter(handle, [item.name for item in fields(Row)])
        writer.writeheader()
        writer.writerows({**asdict(row), "stage_seconds": json.dumps(row.stage_seconds)} for row in rows)
    return [parquet, text]


def effects_line(effects: Collection[str]) -> str:
    """What the first frame is made with; an effect's row is without it."""
    return f"Effects of the first frame: {', '.join(effects)}. An effect's row is without it."
