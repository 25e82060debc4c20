"""The price list as a table and as files; its picture is :mod:`datafactory.accuracy.chart`."""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from dataclasses import asdict, fields
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from datafactory.accuracy.knobs import Effort
from datafactory.accuracy.study import Row
from shared.dataset.writing import atomic

HEADINGS = ("knob", "setting", "s/frame", "cube dB", "image dB", "power dB", "bias dB", "paths", "work s")


def explanation(effort: Effort) -> tuple[str, ...]:
    """What the columns are."""
    return (
        "A frame on one core, median seconds: write, and trace on a GPU, on the wall clock, the rest in processor "
        "time. * is the default. Errors are the largest over the frames. Work is seconds by fixed rates, the same on "
        "every machine.",
        "tolerance, prune_db and truth_terms, on the same paths: cube is relative L2; image the largest difference "
        "over the peak, in the same Doppler cells; bias is of the image's power. They are varied around an unpruned "
        "cube at 1e-6 and a truth of 6 terms.",
        "rays and depth change the paths, and the speckle with them. Measured is the power in a resolution cell, "
        "summed over its paths without phase: power is the largest difference of amplitudes over the peak, mean over "
        f"{effort.realisations} realisations of the rays or more; bias is of the total power. Rays are held against "
        f"the mean of {effort.reference_realisations} realisations of {effort.reference_rays}, whose own variance is "
        "subtracted, depth against the deepest with the same rays.",
        "front: the cheapest settings, by work, whose three errors stay below a level, all at once. Their error of the "
        "power, and that of the defaults, is that of their rays and depth in the rows above; times are with their own "
        "rays.",
    )


def table_rows(rows: Sequence[Row]) -> list[tuple[str, ...]]:
    """The rows as text under HEADINGS."""

    def level(value: float | None, sign: str = "") -> str:
        return "" if value is None else f"{value:{sign}.{3 if sign else 1}f}"

    return [
        (
            row.knob,
            row.setting + (" *" if row.default else ""),
            f"{row.seconds:.2f}",
            level(row.cube_error_db),
            level(row.image_error_db),
            level(row.power_error_db),
            level(row.power_bias_db, "+"),
            f"{row.paths:.0f}",
            f"{row.work:.2f}",
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
