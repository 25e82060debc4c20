"""What experiments hand to the report: rows of the metrics table, and the columns of the summary that show them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

TRUTH = "truth"
"""Stands for a method where the truth's own image is shown or scored."""
AVERAGE_PRECISION = "average precision"
"""Name of the metric that methods are compared by first."""


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
    :param low: lower end of the 95 % interval
    :param high: upper end
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
