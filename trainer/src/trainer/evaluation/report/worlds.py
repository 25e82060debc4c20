"""Average precision over the number of scenes that networks were trained on: one chart and one table.

    python -m trainer.evaluation.report.worlds EVALUATION [EVALUATION ...] --out DIR

The numbers are those of the experiment "worlds" of one or more evaluations (``trainer evaluate``), e.g. on bare and on
populated scenes; each has panels of its own. Leaves DIR/worlds.png, .svg and .md.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from shared.dataset.writing import write_text
from shared.physics.errors import InputError, figure_text
from trainer.evaluation.report.style import COLOURS, counted, label_ends, new_figure, save_figure, subplots
from trainer.evaluation.report.summary import markdown_cell
from trainer.evaluation.report.tables import METRICS_FILE
from trainer.evaluation.rows import AVERAGE_PRECISION, MetricRow

NAME = "worlds"
TITLE = "What more scenes to train on are worth in scenes that no network saw"
OVER_FEWEST = "gain in average precision over the fewest scenes"
OVER_BARE = "gain in average precision over bare scenes"
METRICS = AVERAGE_PRECISION, OVER_FEWEST, OVER_BARE
BARE, POPULATED, MIXED = "bare", "populated", "bare and populated"
KIND_COLOURS = {BARE: COLOURS[0], POPULATED: COLOURS[1], MIXED: COLOURS[2]}
ASIDE = {BARE: 0.97, POPULATED: 1.03, MIXED: 1.0}
"""Factors of the abscissa, so that intervals stand beside each other."""
ESTIMATOR_COLOUR = "#777777"


@dataclass(frozen=True, order=True)
class TrainedOn:
    """What networks have seen that are one point of the chart.

    :param kind: :data:`BARE`, :data:`POPULATED` or :data:`MIXED`
    :param scenes: number of different scenes
    :param frames: training frames
    :param runs: number of the networks, of other seeds; 0 in the row of one of several
    """

    kind: str
    scenes: int
    frames: int
    runs: int


def condition(tested_on: str, trained_on: TrainedOn | None) -> str:
    """Of a row of the experiment.

    :param tested_on: e.g. "4 bare scenes"
    :param trained_on: None for a method that is trained on nothing
    """
    parts = [f"tested on={tested_on}"]
    if trained_on is not None:
        parts += [f"trained on={trained_on.kind}", f"scenes={trained_on.scenes}", f"frames={trained_on.frames}"]
        parts += [f"runs={trained_on.runs}"] if trained_on.runs else []
    return ",".join(parts)


@dataclass(frozen=True)
class Panel:
    """The rows of one array on one set of test frames."""

    array: str
    tested_on: str
    rows: tuple[tuple[TrainedOn | None, MetricRow], ...]

    @property
    def title(self) -> str:
        return f"{figure_text(self.array)}: {self.frames} of {figure_text(self.tested_on)}"

    @property
    def frames(self) -> str:
        return counted(self.rows[0][1].samples, "frame")

    def of(self, metric: str) -> dict[TrainedOn, MetricRow]:
        """The networks' rows, each for all runs of a point, in the order of kind and number of scenes."""
        found = {of: row for of, row in self.rows if row.metric == metric and of is not None and of.runs}
        return dict(sorted(found.items()))

    def single_runs(self) -> list[tuple[TrainedOn, MetricRow]]:
        return [(of, row) for of, row in self.rows if of is not None and not of.runs]

    def estimators(self) -> list[MetricRow]:
        return [row for of, row in self.rows if of is None]


def panels(rows: Iterable[MetricRow]) -> list[Panel]:
    """The rows of one evaluation's experiment, array by array."""
    found: dict[tuple[str, str], list[tuple[TrainedOn | None, MetricRow]]] = {}
    for row in rows:
        pairs = dict(pair.split("=", 1) for pair in row.condition.split(","))
        trained_on = (
            TrainedOn(pairs["trained on"], int(pairs["scenes"]), int(pairs["frames"]), int(pairs.get("runs", 0)))
            if "trained on" in pairs
            else None
        )
        found.setdefault((row.array, pairs["tested on"]), []).append((trained_on, row))
    return [Panel(array, tested_on, tuple(of_panel)) for (array, tested_on), of_panel in found.items()]


def figure(drawn: Sequence[Panel]) -> Figure:
    """Average precision above, its gain over the fewest scenes below; a column for each panel."""
    page = new_figure(4.7 * len(drawn) + 0.4, 6.4, TITLE)
    axes = subplots(page, 2, len(drawn), sharex=True, sharey="row")
    ends = []
    for above, below, panel in zip(*axes, drawn, strict=True):
        lines = _draw(above, panel, AVERAGE_PRECISION)
        for row in panel.estimators():
            above.axhline(row.value, color=ESTIMATOR_COLOUR, lw=1.0, ls="--")
            lines.append((row.value, row.method, ESTIMATOR_COLOUR))
        for of, row in panel.single_runs():
            above.plot(of.scenes * ASIDE[of.kind], row.value, ".", ms=4, color=KIND_COLOURS[of.kind], alpha=0.6)
        above.set_title(panel.title, fontsize=9.0)
        above.set_ylim(bottom=0.0)
        below.axhline(0.0, color="black", lw=0.8)
        ends += [(above, lines), (below, _draw(below, panel, OVER_FEWEST))]
        below.set_xlabel("scenes trained on")
    # All panels have one axis of scenes.
    _count_scenes(axes[1, 0], {of.scenes for panel in drawn for of in panel.of(AVERAGE_PRECISION)})
    # The panels of a row have their common scale only when all are drawn. An undefined value has no place.
    for axis, lines in ends:
        label_ends(axis, [line for line in lines if np.isfinite(line[0])], gap=0.06)
    axes[0, 0].set_ylabel(AVERAGE_PRECISION)
    axes[1, 0].set_ylabel("gain over the fewest scenes,\nthe same test frames")
    return page


def _draw(axis: Axes, panel: Panel, metric: str) -> list[tuple[float, str, str]]:
    """Draw a line for each kind of training scene; returns where each ends, for its label."""
    ends = []
    rows = panel.of(metric)
    for kind in dict.fromkeys(of.kind for of in rows):
        line = [(of.scenes * ASIDE[kind], row) for of, row in rows.items() if of.kind == kind]
        colour = KIND_COLOURS[kind]
        axis.plot([x for x, _ in line], [row.value for _, row in line], "o-", ms=4, lw=1.3, color=colour)
        for x, row in line:
            if np.isfinite([row.low, row.high]).all():
                axis.plot([x, x], [row.low, row.high], color=colour, lw=1.0)
        ends.append((line[-1][1].value, f"trained on {kind}", colour))
    axis.grid(alpha=0.25)
    return ends


def _count_scenes(axis: Axes, counts: set[int]) -> None:
    axis.set_xscale("log", base=2)
    axis.set_xticks(sorted(counts), [str(count) for count in sorted(counts)])
    axis.set_xticks([], minor=True)


def table(shown: Sequence[Panel]) -> str:
    """Markdown: for each array the networks by kind and number of scenes, then the methods that are trained on nothing.

    Of each panel the average precision, what it gains over the fewest scenes of its kind, and over as many bare scenes.
    """
    return "\n".join(
        _array_table([panel for panel in shown if panel.array == array])
        for array in dict.fromkeys(panel.array for panel in shown)
    )


def _array_table(shown: Sequence[Panel]) -> str:
    head = [f"{shown[0].array}, trained on", "scenes", "frames", "runs"]
    for panel in shown:
        head += [f"AP, {panel.frames} of {panel.tested_on}", "over the fewest", "over bare"]
    lines = [head, ["---"] * len(head)]
    for of in sorted({of for panel in shown for of in panel.of(AVERAGE_PRECISION)}):
        cells = [_text(panel.of(metric).get(of), metric) for panel in shown for metric in METRICS]
        lines.append([of.kind, str(of.scenes), str(of.frames), str(of.runs), *cells])
    for method in dict.fromkeys(row.method for panel in shown for row in panel.estimators()):
        cells = []
        for panel in shown:
            row = next((row for row in panel.estimators() if row.method == method), None)
            cells += [_text(row, AVERAGE_PRECISION), "", ""]
        lines.append([f"nothing: {method}", "", "", "", *cells])
    return "".join(f"| {' | '.join(map(markdown_cell, line))} |\n" for line in lines)


def _text(row: MetricRow | None, metric: str) -> str:
    """Value and 95 % interval; nothing where it is not defined."""
    if row is None or not np.isfinite(row.value):
        return ""
    form = "{:.3f}" if metric == AVERAGE_PRECISION else "{:+.3f}"
    value, low, high = (form.format(number) for number in (row.value, row.low, row.high))
    return f"{value} ({low} to {high})" if np.isfinite([row.low, row.high]).all() else value


def read_panels(evaluation: Path) -> list[Panel]:
    """Of a finished evaluation.

    :raises InputError: none there, or one without the experiment
    """
    path = evaluation / METRICS_FILE
    try:
        records = pq.read_table(path).select([field.name for field in fields(MetricRow)]).to_pylist()
        # What is not defined is null in the file.
        nan: Any = float("nan")
        rows = [MetricRow(**{name: nan if value is None else value for name, value in one.items()}) for one in records]
        found = panels(row for row in rows if row.experiment == NAME)
    except (OSError, pa.ArrowException, KeyError, ValueError) as error:
        raise InputError(path, f"not readable: {error}", "the folder of a finished trainer evaluate") from error
    if not found:
        raise InputError(path, f"no numbers of the experiment {NAME}", f"trainer evaluate with --experiments {NAME}")
    return found


def main(arguments: Sequence[str] | None = None) -> None:
    """Draw the chart and write the table of one or more evaluations."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("evaluations", nargs="+", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    given = parser.parse_args(arguments)
    try:
        shown = [panel for evaluation in given.evaluations for panel in read_panels(evaluation)]
        if given.out.exists() and not given.out.is_dir():
            raise InputError("--out", str(given.out), "a folder")
    except InputError as error:
        print(f"worlds: {error}", file=sys.stderr)
        sys.exit(2)
    given.out.mkdir(parents=True, exist_ok=True)
    save_figure(figure(shown), given.out, NAME)
    write_text(given.out / f"{NAME}.md", table(shown))
    print(table(shown), end="")


if __name__ == "__main__":
    main()
