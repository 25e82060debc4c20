"""The numbers that methods are chosen by, a table for each array, as Markdown."""

from __future__ import annotations

import html
import math
from collections.abc import Mapping, Sequence

import pyarrow as pa

from shared.physics.errors import printable
from trainer.evaluation.report.tables import SECONDS
from trainer.evaluation.rows import SummaryColumn, condition_text

Row = Mapping[str, object]
"""One line of the metrics table by the names of its columns."""
Columns = Sequence[tuple[str, SummaryColumn]]
"""Name of an experiment and a column of its own, from left to right."""


def summary(table: pa.Table, columns: Columns) -> str:
    """Markdown: for each array a table with a line for each method. Columns whose experiment did not run are left out;
    where none ran, the text is a sentence.

    :param table: of :func:`trainer.evaluation.report.tables.metrics_table`
    """
    rows = table.to_pylist()
    arrays = list(dict.fromkeys(row["array"] for row in rows if row[SECONDS] is not None))
    if not any(_belongs(row, *column) for row in rows for column in columns):
        return f"Nothing to sum up: none of {', '.join(dict.fromkeys(name for name, _ in columns))} was run.\n"
    return "\n".join(_array_table(array, [row for row in rows if row["array"] == array], columns) for array in arrays)


def _array_table(array: str, rows: Sequence[Row], all_columns: Columns) -> str:
    columns = [column for column in all_columns if any(_belongs(row, *column) for row in rows)]
    headings = [array, *(column.heading for _, column in columns), "s an image", "parameters"]
    lines = [headings, ["---"] * len(headings)]
    for method in dict.fromkeys(row["method"] for row in rows):
        of_method = [row for row in rows if row["method"] == method]
        if not any(_belongs(row, *column) for row in of_method for column in columns):
            continue
        values = [_value_text(of_method, *column) for column in columns]
        timed = next((row for row in of_method if row[SECONDS] is not None), None)
        seconds = f"{timed[SECONDS]:.3g}" if timed else ""
        parameters = f"{timed['parameters']:,}".replace(",", " ") if timed and timed["parameters"] else ""
        lines.append([str(method), *values, seconds, parameters])
    return "".join(f"| {' | '.join(map(markdown_cell, line))} |\n" for line in lines)


def markdown_cell(text: str) -> str:
    """A name may hold what Markdown takes for a cell's end or for an element of HTML."""
    return html.escape(printable(text), quote=False).replace("|", r"\|")


def _belongs(row: Row, experiment: str, column: SummaryColumn) -> bool:
    named = row["experiment"] == experiment and row["metric"] == column.metric
    return named and (column.condition is None or row["condition"] == condition_text(column.condition))


def _value_text(rows: Sequence[Row], experiment: str, column: SummaryColumn) -> str:
    """Value and 95 % interval; nothing where it is not defined."""
    row = next((row for row in rows if _belongs(row, experiment, column)), None)
    if row is None or row["value"] is None:
        return ""
    value, low, high = (math.nan if row[name] is None else float(str(row[name])) for name in ("value", "low", "high"))
    text = f"{value:.{column.digits}f}"
    return text if math.isnan(low + high) else f"{text} ({low:.{column.digits}f} to {high:.{column.digits}f})"
