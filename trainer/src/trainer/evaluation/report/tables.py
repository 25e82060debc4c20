"""The metrics table as Parquet and CSV."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq

from shared.dataset.writing import atomic
from trainer.evaluation.rows import MetricRow, condition_text

SECONDS = "seconds_per_image"
METRICS_FILE = "metrics.parquet"
SCHEMA = pa.schema(
    [
        ("experiment", pa.string()),
        ("method", pa.string()),
        ("array", pa.string()),
        ("metric", pa.string()),
        ("condition", pa.string()),
        ("value", pa.float64()),
        ("low", pa.float64()),
        ("high", pa.float64()),
        ("samples", pa.int64()),
        (SECONDS, pa.float64()),
        ("parameters", pa.int64()),
    ]
)
"""One row a number; :data:`SECONDS` is what depends on the machine and its load, all else on the arguments alone."""


def metrics_table(
    rows: Sequence[MetricRow],
    seconds: Mapping[tuple[str, str], float],
    parameters: Mapping[tuple[str, str], int],
) -> pa.Table:
    """The rows with the seconds for one image and the trained parameters of their (method, array) beside them."""
    records = [
        {
            **asdict(row),
            "condition": condition_text(row.condition),
            SECONDS: seconds.get((row.method, row.array)),
            "parameters": parameters.get((row.method, row.array)),
        }
        for row in rows
    ]
    # Undefined values and intervals are null in the file: NaN or infinity would count in a reader's mean.
    for record in records:
        record.update({name: None for name in ("value", "low", "high") if not math.isfinite(record[name])})
    return pa.Table.from_pylist(records, schema=SCHEMA)


def write_table(table: pa.Table, directory: Path) -> None:
    """``metrics.parquet`` and ``metrics.csv``, whole or not at all."""
    with atomic(directory / METRICS_FILE) as partial:
        pq.write_table(table, partial, compression="zstd")
    with atomic(directory / "metrics.csv") as partial:
        pyarrow.csv.write_csv(table, partial)
