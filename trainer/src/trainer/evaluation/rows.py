"""What experiments hand to the report: rows of the metrics table, and the columns of the summary that show them."""

from __future__ import annotations

from dataclasses import dataclass

TRUTH = "truth"
"""Stands for a method where the truth's own image is shown or scored."""
AVERAGE_PRECISION = "average precision"
"""Name of the metric that methods are compared by first."""


@dataclass(frozen=True)
class MetricRow:
    """One line of the metrics table.

    :param condition: "name=value" pairs, separated by commas; "" for none
    :param value: NaN where the metric is not defined
    :param low: lower end of the 95 % interval
    :param high: upper end
    :param samples: what the value is a mean of: frames, trials or angles
    """

    experiment: str
    method: str
    array: str
    metric: str
    condition: str
    value: float
    low: float
    high: float
    samples: int


@dataclass(frozen=True)
class SummaryColumn:
    """One column of the summary: of each method and array it shows one row of its experiment.

    :param metric: of that row
    :param condition: how the row's condition begins; the first such row counts
    :param digits: behind the decimal point
    """

    heading: str
    metric: str
    condition: str = ""
    digits: int = 2
