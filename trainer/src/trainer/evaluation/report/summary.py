"""The numbers that methods are chosen by, a table for each array, as Markdown."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import pyarrow as pa

from trainer.data.pairs import Condition
from trainer.evaluation.experiments.detection import Detection
from trainer.evaluation.experiments.noise_only import METRIC as FALSE_ALARMS
from trainer.evaluation.experiments.noise_only import NoiseOnly
from trainer.evaluation.experiments.resolution import SHOWN_SNR_DB, Resolution
from trainer.evaluation.report.tables import SECONDS
from trainer.metrics.detection import D_MAX_BINS


class Column(NamedTuple):
    """One column of the summary: the metrics table's row of a method and an array that it shows.

    :param condition: how the row's condition begins; the first such row counts
    """

    heading: str
    experiment: str
    metric: str
    condition: str
    digits: int


_MATCH = f"d_max={D_MAX_BINS[0]} bins"
COLUMNS = (
    Column("NMSE, best scale", Detection.name, "NMSE at the best scale", "", 2),
    Column("SSIM", Detection.name, "SSIM of levels", "", 2),
    Column("recall", Detection.name, "one-to-one recall", _MATCH, 2),
    Column("precision", Detection.name, "one-to-one precision", _MATCH, 2),
    Column("F1", Detection.name, "one-to-one F1", _MATCH, 2),
    Column("unsupported peaks", Detection.name, "peaks that the data do not support", "", 2),
    Column("P(resolve) 1 RL", Resolution.name, "probability of resolution", str(Condition(1.0, SHOWN_SNR_DB)), 2),
    Column("0.5 RL", Resolution.name, "probability of resolution", str(Condition(0.5, SHOWN_SNR_DB)), 2),
    Column("false alarms", NoiseOnly.name, FALSE_ALARMS, "", 1),
)
"""Scores of the scene frames, pairs of equal targets at 20 dB, frames of noise alone."""


def summary(table: pa.Table) -> str:
    """Markdown: for each array a table with a line for each method; columns whose experiment did not run are left out.
    Where none ran, a sentence.

    :param table: of :func:`trainer.evaluation.report.tables.metrics_table`
    """
    rows = table.to_pylist()
    arrays = list(dict.fromkeys(row["array"] for row in rows if row[SECONDS] is not None))
    if not any(_is_of(row, column) for row in rows for column in COLUMNS):
        return f"Nothing to sum up: none of {', '.join(dict.fromkeys(c.experiment for c in COLUMNS))} was run.\n"
    return "\n".join(_array_table(array, [row for row in rows if row["array"] == array]) for array in arrays)


def _array_table(array: str, rows: Sequence[Mapping[str, object]]) -> str:
    columns = [column for column in COLUMNS if any(_is_of(row, column) for row in rows)]
    headings = [array, *(column.heading for column in columns), "s an image", "parameters"]
    lines = [headings, ["---"] * len(headings)]
    for method in dict.fromkeys(row["method"] for row in rows):
        of_method = [row for row in rows if row["method"] == method]
        if not any(_is_of(row, column) for row in of_method for column in columns):
            continue
        shown = [_shown(of_method, column) for column in columns]
        about = next((row for row in of_method if row[SECONDS] is not None), None)
        seconds = f"{about[SECONDS]:.3g}" if about else ""
        parameters = f"{about['parameters']:,}".replace(",", " ") if about and about["parameters"] else ""
        lines.append([str(method), *shown, seconds, parameters])
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def _is_of(row: Mapping[str, object], column: Column) -> bool:
    return (row["experiment"], row["metric"]) == column[1:3] and str(row["condition"]).startswith(column.condition)


def _shown(rows: Sequence[Mapping[str, object]], column: Column) -> str:
    """Value and 95 % interval; nothing where it is not defined."""
    row = next((row for row in rows if _is_of(row, column)), None)
    if row is None or row["value"] is None:
        return ""
    value, low, high = (math.nan if row[name] is None else float(str(row[name])) for name in ("value", "low", "high"))
    text = f"{value:.{column.digits}f}"
    return text if math.isnan(low + high) else f"{text} ({low:.{column.digits}f} to {high:.{column.digits}f})"
