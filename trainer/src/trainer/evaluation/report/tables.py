"""Rows of the metrics table, the table as Parquet and CSV, and the numbers that methods are chosen by as Markdown."""

from __future__ import annotations

import html
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq
from numpy.typing import ArrayLike

from shared.dataset.writing import atomic
from shared.physics.errors import printable
from trainer.metrics.bootstrap import UNDEFINED, Interval, bootstrap_mean, bootstrap_ratio, wilson

TRUTH = "truth"
"""Stands for a method where the truth's own image is shown or scored."""
AVERAGE_PRECISION = "average precision"
"""Name of the metric that methods are compared by first."""
PROBABILITY_OF_RESOLUTION = "probability of resolution"


Condition = Mapping[str, object]
"""What was varied, by name; as text in tables and in the names of cells."""


def condition_text(condition: Condition) -> str:
    """ "name=value" pairs, separated by commas."""
    return ",".join(f"{name}={value}" for name, value in condition.items())


@dataclass(frozen=True)
class MetricRow:
    """One line of the metrics table.

    :param condition: what the number belongs to; empty for all that the experiment looked at
    :param value: NaN where the metric is not defined
    :param low, high: ends of the 95 % interval
    :param samples: what the value is a mean of: frames, trials or angles
    """

    experiment: str
    method: str
    array: str
    metric: str
    condition: Condition
    value: float
    low: float
    high: float
    samples: int


class Numbers:
    """The numbers that an experiment finds, as a long table: a row each, of which tables and figures are made.

    :param experiment: its name
    :param seed: of the bootstrap
    """

    def __init__(self, experiment: str, seed: int) -> None:
        self._rows: dict[tuple[str, str, str, str], MetricRow] = {}
        self.experiment, self.seed = experiment, seed

    @property
    def rows(self) -> list[MetricRow]:
        """In the order in which they were found."""
        return list(self._rows.values())

    def row(self, key: tuple[str, str], metric: str, condition: Condition) -> MetricRow:
        """The one of this (method, array), metric and condition."""
        return self._rows[*key, metric, condition_text(condition)]

    def values(self, key: tuple[str, str], metric: str, conditions: Iterable[Condition]) -> list[float]:
        """A metric of this (method, array) under several conditions, for a line in a figure."""
        return [self.row(key, metric, condition).value for condition in conditions]

    def add(self, key: tuple[str, str], metric: str, condition: Condition, found: Interval, samples: int = 1) -> None:
        """A number whose interval is known.

        :param key: (method, array)
        :param samples: what it is a mean of
        """
        row = MetricRow(self.experiment, *key, metric, condition, found.value, found.low, found.high, samples)
        self._rows[*key, metric, condition_text(condition)] = row

    def known(self, key: tuple[str, str], metric: str, condition: Condition, value: float) -> None:
        """A number that is not estimated."""
        self.add(key, metric, condition, Interval(value, value, value))

    def mean(
        self, key: tuple[str, str], metric: str, condition: Condition, samples: ArrayLike, root: bool = False
    ) -> None:
        """The mean of samples with its bootstrap interval.

        Samples that are not finite (a metric that is not defined) do not count; the row says how many did. Of samples
        that are true or false it is a share, with its Wilson interval, which keeps a width where all end alike. Other
        samples that are all alike have no spread that could be resampled, and no interval.

        :param root: the root of the mean instead
        """
        values = np.asarray(samples)
        values = values[np.isfinite(values)]
        if not len(values):
            found = UNDEFINED
        elif values.dtype == np.bool_:
            found = wilson(int(values.sum()), len(values))
        elif np.ptp(values) == 0.0:
            found = Interval(float(values[0]), math.nan, math.nan)
        else:
            found = bootstrap_mean(values, self.seed)
        if root:
            found = Interval(*map(math.sqrt, (found.value, found.low, found.high)))
        self.add(key, metric, condition, found, len(values))

    def ratio(
        self, key: tuple[str, str], metric: str, condition: Condition, parts: ArrayLike, wholes: ArrayLike
    ) -> None:
        """A ratio of sums over frames with its bootstrap interval over the frames; NaN where the whole is nothing."""
        part, whole = np.asarray(parts, dtype=np.float64), np.asarray(wholes, dtype=np.float64)
        found = bootstrap_ratio(part, whole, self.seed) if whole.sum() > 0 else UNDEFINED
        self.add(key, metric, condition, found, len(whole))


@dataclass(frozen=True)
class SummaryColumn:
    """One column of the summary: of each method and array it shows one row of its experiment.

    :param metric: of that row
    :param condition: of the row; None where each method has one row of the metric, whatever its condition
    :param digits: behind the decimal point
    """

    heading: str
    metric: str
    condition: Condition | None = None
    digits: int = 2


SECONDS = "seconds_per_image"
NAMED, NUMBERS = ("experiment", "method", "array", "metric", "condition"), ("value", "low", "high")
"""Columns of text, which say what a row is of, and those that are null where they are not finite."""
SCHEMA = pa.schema(
    [
        *((name, pa.string()) for name in NAMED),
        *((name, pa.float64()) for name in NUMBERS),
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
        record.update({name: None for name in NUMBERS if not math.isfinite(record[name])})
    return pa.Table.from_pylist(records, schema=SCHEMA)


def write_table(table: pa.Table, directory: Path) -> None:
    """``metrics.parquet`` and ``metrics.csv``, whole or not at all."""
    with atomic(directory / "metrics.parquet") as partial:
        pq.write_table(table, partial, compression="zstd")
    with atomic(directory / "metrics.csv") as partial:
        pyarrow.csv.write_csv(table, partial)


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
    value, low, high = (math.nan if row[name] is None else float(str(row[name])) for name in NUMBERS)
    text = f"{value:.{column.digits}f}"
    return text if math.isnan(low + high) else f"{text} ({low:.{column.digits}f} to {high:.{column.digits}f})"
