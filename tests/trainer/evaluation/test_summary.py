"""The summary shows the numbers of the metrics table, and only those that are there."""

from __future__ import annotations

import math
from collections.abc import Mapping

from trainer.data.simulation import Condition
from trainer.evaluation.evaluate import SUMMARY_COLUMNS
from trainer.evaluation.report.tables import MetricRow, metrics_table, summary

CLOSE, CLOSER = Condition(1.0, 20.0).named, Condition(0.5, 20.0).named
NEAR: dict[str, object] = {"d_max": "2 bins"}


def row(
    method: str, array: str, metric: str, condition: Mapping[str, object], value: float, spread: float = 0.1
) -> MetricRow:
    experiment = "resolution" if metric.startswith("probability") else "detection"
    return MetricRow(experiment, method, array, metric, condition, value, value - spread, value + spread, 9)


ROWS = [
    row("das", "sparse6", "one-to-one F1", NEAR, 0.25),
    row("das", "sparse6", "one-to-one F1", {"d_max": "4 bins"}, 0.95),
    row("unet", "sparse6", "one-to-one F1", NEAR, 0.75, math.nan),
    row("unet", "sparse6", "average precision", {}, 0.5, 0.125),
    row("unet", "sparse6", "detection probability", {"false alarms": "1 a frame"}, 0.1),
    row("unet", "sparse6", "detection probability", {"false alarms": "10 a frame"}, 0.2),
    row("truth", "sparse6", "average precision", {}, 1.0, 0.0),
    row("unet", "sparse4", "one-to-one F1", NEAR, math.nan),
    row("das", "sparse6", "probability of resolution", CLOSE, 0.5),
    row("das", "sparse6", "probability of resolution", {**CLOSE, "phase": "0-60 deg"}, 0.4),
    row("ml", "sparse6", "probability of resolution", CLOSER, 0.6),
    row("iaa", "sparse4", "bias [bins]", {"snr": "20 dB"}, 1.0),
    row("ml", "reference", "angle 1 [deg]", {"elements": "all"}, 1.0),
    row("das", "sparse6", "bias [bins]", {"snr": "20 dB"}, 7.0),
]
SECONDS = {("das", "sparse6"): 0.0123, ("unet", "sparse6"): 1.5, ("unet", "sparse4"): 1.4}
PARAMETERS = {("das", "sparse6"): 0, ("unet", "sparse6"): 1612123, ("unet", "sparse4"): 1612123}


def tables() -> dict[str, list[list[str]]]:
    text = summary(metrics_table(ROWS, SECONDS, PARAMETERS), SUMMARY_COLUMNS)
    parts = [part.splitlines() for part in text.split("\n\n")]
    cells = [[[cell.strip() for cell in line.strip("|").split("|")] for line in part] for part in parts]
    return {part[0][0]: part for part in cells}


def test_a_line_for_each_method_with_the_columns_that_ran():
    head, _, das, unet, truth, ml = tables()["sparse6"]
    assert head == [
        "sparse6", "AP", "P(detect) at 10 FA", "F1", "P(resolve) 1 RL", "0.5 RL", "s an image", "parameters",
    ]  # fmt: skip
    assert das == ["das", "", "", "0.25 (0.15 to 0.35)", "0.50 (0.40 to 0.60)", "", "0.0123", ""]
    assert unet == ["unet", "0.50 (0.38 to 0.62)", "0.20 (0.10 to 0.30)", "0.75", "", "", "1.5", "1 612 123"]
    # The ceilings are no methods of the evaluation: they have no time.
    assert truth == ["truth", "1.00 (1.00 to 1.00)", "", "", "", "", "", ""]
    assert ml == ["ml", "", "", "", "", "0.60 (0.50 to 0.70)", "", ""]


def test_what_is_undefined_is_blank_and_other_numbers_make_no_line():
    head, _, *lines = tables()["sparse4"]
    assert head == ["sparse4", "F1", "s an image", "parameters"]
    assert lines == [["unet", "", "1.4", "1 612 123"]]
    assert "reference" not in tables()


def test_with_none_of_its_experiments_it_is_a_sentence():
    text = summary(
        metrics_table([row("iaa", "sparse4", "bias [bins]", {"snr": "20 dB"}, 1.0)], {("iaa", "sparse4"): 1.0}, {}),
        SUMMARY_COLUMNS,
    )
    assert text == "Nothing to sum up: none of detection, resolution, noise-only was run.\n"


def test_a_name_is_no_markup() -> None:
    hostile = [row("unet:<b>|x\x1b[31m", "a|<script>", "one-to-one F1", NEAR, 0.75)]
    text = summary(metrics_table(hostile, {("unet:<b>|x\x1b[31m", "a|<script>"): 1.0}, {}), SUMMARY_COLUMNS)
    assert "| a\\|&lt;script&gt; |" in text
    assert "| unet:&lt;b&gt;\\|x\\x1b[31m |" in text
