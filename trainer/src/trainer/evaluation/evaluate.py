"""``trainer evaluate``: experiments, numbers, figures and the page that shows them.

OUT/cells/            one file for each finished (experiment, method, array, condition): what ``--resume`` keeps
OUT/figures/          PNG and SVG
OUT/metrics.parquet   the numbers, also as metrics.csv
OUT/summary.md        the numbers that methods are chosen by, a table for each array
OUT/report.html       everything, in one file
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import partial

import pyarrow as pa

from shared.dataset.folder import MANIFEST, open_dataset
from shared.dataset.locations import Location, folder_name, locate
from shared.dataset.reading import radar_of
from shared.dataset.writing import remove_partial, write_text
from shared.physics.errors import InputError
from shared.processes.declared import common, taking
from shared.radar import Radar
from trainer.data.arrays import choose_array
from trainer.defaults import DEFAULT_ARRAYS, NETWORKS
from trainer.estimators.base import ESTIMATORS
from trainer.evaluation.experiments.bench import Bench, Experiment, Results
from trainer.evaluation.experiments.contenders import check_methods, check_networks, gather, kind_of
from trainer.evaluation.experiments.cylinders import PointSpread, Reflectors
from trainer.evaluation.experiments.detection import Detection
from trainer.evaluation.experiments.doppler import Doppler
from trainer.evaluation.experiments.frames import frame_refs
from trainer.evaluation.experiments.generalisation import Generalisation, Runtime, Tradeoff
from trainer.evaluation.experiments.measured import METHODS, Measured, fitting_networks
from trainer.evaluation.experiments.measured_input import MeasuredInput, read_measured, with_arrays
from trainer.evaluation.experiments.noise_only import NoiseOnly
from trainer.evaluation.experiments.resolution import Resolution
from trainer.evaluation.experiments.robustness import Robustness
from trainer.evaluation.experiments.street import Street
from trainer.evaluation.options import EvaluateOptions, EvaluationConfig
from trainer.evaluation.report.figures import save_figure
from trainer.evaluation.report.page import ReportFigure, report_page
from trainer.evaluation.report.tables import MetricRow, Numbers, metrics_table, summary, write_table
from trainer.evaluation.store import CellStore, Values, cell_name
from trainer.evaluation.workers import Workers
from trainer.run.answers import Answer, NetworkAnswer
from trainer.run.folder import JOB, Fingerprint, output_folder, read_run, scene_records
from trainer.run.imager import precision_remark

RUNTIME, STREET = Runtime(), Street()
"""What is looked at whatever the experiments."""
EXPERIMENTS: dict[str, Experiment] = {
    experiment.name: experiment
    for experiment in (
        PointSpread(), STREET, Reflectors(), Detection(), Doppler(), Resolution(), Robustness(), Generalisation(),
        NoiseOnly(), Tradeoff(),
    )
}  # fmt: skip
"""By the name that ``--experiments`` takes, in the order of the report; the measured row comes after them."""
NAMES = (*EXPERIMENTS, Measured.name)
SUMMARY_COLUMNS = [(name, column) for name, experiment in EXPERIMENTS.items() for column in experiment.summary]
CELLS, FIGURES = "cells", "figures"
REPORT, SUMMARY = "report.html", "summary.md"


@taking(EvaluateOptions)
def evaluate(asked: EvaluateOptions) -> pa.Table:
    """Run the experiments that apply and write everything into ``out``, as ``trainer evaluate`` does.

    Seconds are measured before the first cell, in this process alone.

    >>> evaluate("build/dataset", out="build/report", pretrained="sparse6", methods=["das", "unet"])  # doctest: +SKIP

    :returns: the metrics table
    :raises InputError: bad data, runs, names, or an experiment asked for that does not apply
    :raises Stopped: three worker processes died of a cell
    """
    config = common(EvaluationConfig, asked)
    row = None
    if asked.measured is not None:
        row = read_measured(asked.measured, asked.targets, asked.range_m, asked.model_error)
    dataset, out, announce, advance = asked.dataset, asked.out, asked.announce, asked.progress
    with output_folder(out, asked.resume, "an empty or new folder, or --resume to keep what is finished") as folder:
        if asked.resume and any(item.name != JOB for item in out.iterdir()) and not (out / CELLS).is_dir():
            raise InputError("--out", f"{out} holds no {CELLS}/", "the folder of an evaluation to resume, or a new one")
        bench, chosen, title, remarks = _prepared(dataset, row, config)
        remove_partial(out)
        store = CellStore(out / CELLS)
        if row is not None and row.numbered:
            remarks.append(f"{row.path}: {row.place} is looked at; other frames are not")
        for line in remarks:
            announce(line)
        if bench.frames:
            # Before there are other processes, which would take the machine's time.
            timed = _compute(RUNTIME, bench, store, Workers(bench, 1, folder), partial(advance, RUNTIME.name))
            bench = replace(bench, seconds={key[:2]: float(values["seconds"]) for key, values in timed.items()})
        rows: list[MetricRow] = []
        figures: list[ReportFigure] = []
        texts: dict[str, str] = {}
        written = set[str]()
        (out / FIGURES).mkdir(exist_ok=True)
        with Workers(bench, asked.workers, folder) as pool:
            shown = _compute(STREET, bench, store, pool, partial(advance, "images")) if bench.frames else {}
            for experiment in (*chosen, RUNTIME):
                results = _compute(experiment, bench, store, pool, partial(advance, experiment.name))
                found = Numbers(experiment.name, config.seed)
                experiment.count(bench, results, found)
                for name, figure in experiment.figures(bench, results, found).items():
                    png = save_figure(figure, out / FIGURES, name)
                    figures.append(ReportFigure(experiment.title, experiment.caption, png))
                    written |= {f"{name}.png", f"{name}.svg"}
                rows += found.rows
                texts |= experiment.texts()
        parameters = {contender.key: contender.parameters for contender in bench.contenders}
        table = metrics_table(rows, bench.seconds, parameters)
        write_table(table, out)
        if bench.frames:
            texts = {SUMMARY: summary(table, SUMMARY_COLUMNS), **texts}
        frames = [] if dataset is None else STREET.report_frames(bench, shown, open_dataset(dataset))
        ran = ", ".join(experiment.name for experiment in chosen)
        page = report_page(title, _introduction(bench, ran), bench.radar, frames, figures, table)
        for name, text in {REPORT: page, **texts}.items():
            write_text(out / name, text)
    if stale := sum(path.name not in written for path in (out / FIGURES).iterdir()):
        announce(f"{stale} files in {out / FIGURES} are of other arguments and not in this report")
    if store.unused:
        announce(f"{store.unused} cells in {store.directory} are of other arguments and not in this report")
    announce(
        f"{store.computed} cells computed, {store.kept} kept; {len(table)} numbers; look: "
        f"{', '.join([str(out / REPORT), *texts])}"
    )
    return table


def _prepared(
    dataset: Location | str | None, row: MeasuredInput | None, config: EvaluationConfig
) -> tuple[Bench, list[Experiment], str, list[str]]:
    """(what the experiments work on, those that apply, title, a line for each thing left out and on precision)."""
    # A name that is mistyped is said before any data is read.
    unknown = [repr(name) for name in config.experiments or () if name not in NAMES]
    if unknown or config.experiments == ():
        raise InputError("--experiments", unknown[0] if unknown else "none", f"some of {', '.join(NAMES)}")
    if config.methods is not None:
        check_methods(config.methods, (*(METHODS if dataset is None else ESTIMATORS), *NETWORKS))
    if dataset is not None:
        bench, left_out = open_bench(dataset, config)
        arrays = [contender.array for contender in bench.contenders]
        networks, left = ([], []) if row is None else fitting_networks(row, config.runs)
        measured = None if row is None else Measured(with_arrays(row, bench.radar, arrays), config.methods, networks)
        chosen, remarks = choose_experiments(config.experiments, bench, measured)
        remarks += left
        remarks += _of_precision(contender.answer for contender in bench.contenders)
        for kind, count in left_out.items():
            remarks.append(f"{count} {kind} frames of the test split are left out: --frames {config.frames}")
        return bench, chosen, f"Evaluation on {folder_name(locate(dataset))}", remarks
    if row is None:
        raise InputError("arguments", "neither a dataset nor --measured", "one of both, or both")
    if config.experiments is not None and config.experiments != (Measured.name,):
        raise InputError("--experiments", ", ".join(config.experiments), f"{Measured.name} alone without a dataset")
    # The default names are of the default radar: of another cube nobody has asked for them.
    asked = ("full",) if row.radar is not None and config.arrays == DEFAULT_ARRAYS else config.arrays
    if config.methods is not None:
        check_networks(config.methods, [kind_of(read_run(path)) for path in config.runs])
    arrays, remarks, radar = [], list[str](), row.radar or Radar()
    for name in asked:
        try:
            arrays.append(choose_array(name, radar, "--arrays"))
        except InputError as error:
            remarks.append(f"left out: {error}")
    networks, others = fitting_networks(row, config.runs)
    remarks += [*others, *_of_precision(answer for _, answer in networks)]
    alone = Measured(with_arrays(row, radar, arrays), config.methods, networks)
    return Bench("", radar, (), frozenset(), (), config), [alone], f"Evaluation of {row.path.name}", remarks


def open_bench(source: Location | str, config: EvaluationConfig) -> tuple[Bench, dict[str, int]]:
    """(what the experiments work on, frames left out by kind); errors as :func:`evaluate`."""
    dataset = open_dataset(source)
    radar = radar_of(dataset.description(), dataset.path / MANIFEST)
    if not config.arrays:
        raise InputError("--arrays", "none", f"some of {', '.join(DEFAULT_ARRAYS)}, or TOML files")
    option = f"--arrays, by default {','.join(DEFAULT_ARRAYS)}" if config.arrays == DEFAULT_ARRAYS else "--arrays"
    arrays = [choose_array(name, radar, option) for name in config.arrays]
    names = [array.name for array in arrays]
    if twice := [name for index, name in enumerate(names) if name in names[:index]]:
        raise InputError("--arrays", f"{twice[0]!r} twice", "every array once, files of different names")
    if "test" not in dataset.splits:
        raise InputError(source, "no frames in split 'test'", "a dataset with frames to test, as of --split 3:1:1")
    refs, left_out = frame_refs(dataset, "test", config.frames)
    contenders = gather(config.methods, config.runs, arrays, radar, dataset.path)
    fingerprint = Fingerprint.of(dataset.path, dataset.records, {})
    seen = {frame.scene for frame in dataset.frames("train", ())} if "train" in dataset.splits else set[str]()
    scenes = scene_records(dataset.manifest)
    return Bench(fingerprint.sha256, radar, refs, frozenset(seen), contenders, config, scenes=scenes), left_out


def _of_precision(answers: Iterable[Answer]) -> list[str]:
    """A line where networks among these are computed in another precision than their runs say."""
    remark = precision_remark(answer.imager.config for answer in answers if isinstance(answer, NetworkAnswer))
    return [remark] if remark else []


def choose_experiments(
    names: Sequence[str] | None, bench: Bench, measured: Measured | None
) -> tuple[list[Experiment], list[str]]:
    """(the experiments that apply, a line for each that does not).

    :param names: of :data:`NAMES`; None for all
    :raises InputError: one that does not apply, a snapshot that no experiment looks at
    """
    every: dict[str, Experiment | None] = {**EXPERIMENTS, Measured.name: measured}
    wanted = {name: every[name] for name in NAMES if names is None or name in names}
    if measured is not None and Measured.name not in wanted:
        raise InputError(
            "--measured", f"{measured.measured.path} without the experiment", f"{Measured.name!r} in --experiments"
        )
    chosen, lines = [], []
    for name, experiment in wanted.items():
        obstacle = "no --measured file" if experiment is None else experiment.obstacle(bench)
        if experiment is not None and not obstacle:
            chosen.append(experiment)
        elif names is not None:
            raise InputError("--experiments", f"{name}: {obstacle}", "an experiment that applies")
        else:
            lines.append(f"experiment {name} is left out: {obstacle}")
    return chosen, lines


def _introduction(bench: Bench, ran: str) -> str:
    config = bench.config
    if not bench.frames:
        return f"No dataset; experiments: {ran}."
    kinds = [ref.kind for ref in bench.frames]
    counts = ", ".join(f"{kinds.count(kind)} {kind}" for kind in dict.fromkeys(kinds))
    methods = ", ".join(dict.fromkeys(contender.method for contender in bench.contenders))
    arrays = ", ".join(array.name for array in bench.arrays)
    return (
        f"Radar {bench.radar.name}; test frames: {counts}; methods: {methods}; arrays: {arrays}; {config.trials} "
        f"simulated trials of a condition; seed {config.seed}; experiments: {ran}."
    )


def _compute(
    experiment: Experiment, bench: Bench, store: CellStore, pool: Workers, advance: Callable[[int, int], None]
) -> Results:
    """The cells of an experiment in the order of its tasks; those not yet on disk are computed and kept one by one."""
    tasks = experiment.tasks(bench)
    cells = [cell_name(experiment.cells or experiment.name, *task.key, task.inputs) for task in tasks]
    values: dict[int, Values] = {}
    for place, cell in enumerate(cells):
        if (found := store.finished(cell)) is not None:
            values[place] = found
    advance(len(values), len(tasks))
    missing = [place for place in range(len(tasks)) if place not in values]
    for place, computed in pool.results(experiment, tasks, missing):
        values[place] = store.keep(cells[place], computed)
        advance(len(values), len(tasks))
    return {task.key: values[place] for place, task in enumerate(tasks)}
