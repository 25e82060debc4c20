"""What an evaluation leaves to be read: its tables and its page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pyarrow as pa

from shared.dataset.folder import Dataset
from shared.dataset.writing import write_text
from trainer.evaluation.experiments.bench import Bench, Results
from trainer.evaluation.experiments.street import shown_frames
from trainer.evaluation.report.page import PEAKS, WHOLE, ReportFigure, ReportFrame, report_page, small_picture
from trainer.evaluation.report.tables import TRUTH, MetricRow, SummaryColumn, metrics_table, summary, write_table

REPORT, SUMMARY = "report.html", "summary.md"


def write_outcome(
    out: Path,
    bench: Bench,
    title: str,
    ran: Sequence[str],
    rows: Sequence[MetricRow],
    figures: Sequence[ReportFigure],
    frames: Sequence[ReportFrame],
    columns: Sequence[tuple[str, SummaryColumn]],
) -> pa.Table:
    """Write the tables and the page; returns the table of all numbers.

    :param ran: names of the experiments
    :param frames: to look at
    :param columns: of the summary
    """
    parameters = {(contender.method, contender.array.name): contender.parameters for contender in bench.contenders}
    table = metrics_table(rows, bench.seconds, parameters)
    write_table(table, out)
    if bench.frames:
        write_text(out / SUMMARY, summary(table, columns))
    page = report_page(title, _introduction(bench, ran), bench.radar, frames, figures, table)
    write_text(out / REPORT, page)
    return table


def report_frames(bench: Bench, results: Results, dataset: Dataset) -> list[ReportFrame]:
    """The frames to look at.

    :param results: the cells of the street
    :param dataset: whose camera pictures stand beside them
    """
    frames = []
    for ref in shown_frames(bench):
        known = results[TRUTH, "", ref.condition]
        truth, doppler = known["levels"], (WHOLE if known["doppler_whole"] else PEAKS, known["doppler"])
        images = {c.name: results[c.method, c.array.name, ref.condition]["levels"] for c in bench.contenders}
        # The cut starts where the truth is strongest.
        row = int(truth.max(axis=1).argmax())
        camera = small_picture(dataset, ref.frame_id)
        frames.append(ReportFrame(f"{ref.scene}, frame {ref.frame_id}", row, {**images, TRUTH: truth}, doppler, camera))
    return frames


def _introduction(bench: Bench, ran: Sequence[str]) -> str:
    config, run = bench.config, ", ".join(ran)
    if not bench.frames:
        return f"No dataset; experiments: {run}."
    kinds = [ref.kind for ref in bench.frames]
    counts = ", ".join(f"{kinds.count(kind)} {kind}" for kind in dict.fromkeys(kinds))
    methods = ", ".join(dict.fromkeys(contender.method for contender in bench.contenders))
    arrays = ", ".join(dict.fromkeys(contender.array.name for contender in bench.contenders))
    return (
        f"Radar {bench.radar.name}; test frames: {counts}; methods: {methods}; arrays: {arrays}; {config.trials} "
        f"simulated trials of a condition; seed {config.seed}; experiments: {run}."
    )
