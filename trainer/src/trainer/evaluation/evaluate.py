"""``trainer evaluate``: experiments, numbers, figures and the page that shows them.

OUT/cells/            one file for each finished (experiment, method, array, condition): what ``--resume`` keeps
OUT/figures/          PNG and SVG
OUT/metrics.parquet   the numbers, also as metrics.csv
OUT/summary.md        the numbers that methods are chosen by, a table for each array
OUT/report.html       everything, in one file
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pyarrow as pa
from matplotlib.figure import Figure
from threadpoolctl import threadpool_limits

from shared.dataset.folder import MANIFEST, open_dataset
from shared.dataset.locations import Location, folder_name, locate
from shared.dataset.reading import radar_of
from shared.dataset.writing import remove_partial, write_text
from shared.physics.errors import InputError
from shared.radar import Radar
from trainer.data.arrays import choose_array
from trainer.evaluation.experiments.bench import (
    DEFAULT_ARRAYS,
    Bench,
    EvaluationConfig,
    Experiment,
    FrameRef,
    Results,
    Task,
    contender_task,
    single_row,
)
from trainer.evaluation.experiments.contenders import Contender, check_methods, gather
from trainer.evaluation.experiments.cylinders import PointSpread, Reflectors
from trainer.evaluation.experiments.detection import Detection
from trainer.evaluation.experiments.doppler import Doppler
from trainer.evaluation.experiments.frames import frame_refs, load_frame
from trainer.evaluation.experiments.generalisation import SECONDS, Generalisation, Tradeoff
from trainer.evaluation.experiments.measured import (
    CAPTION,
    TITLE,
    MeasuredRow,
    check_measured_methods,
    fitting_networks,
    look_at,
)
from trainer.evaluation.experiments.measured import NAME as MEASURED
from trainer.evaluation.experiments.measured_input import MeasuredInput, with_arrays
from trainer.evaluation.experiments.noise_only import NoiseOnly
from trainer.evaluation.experiments.resolution import Resolution
from trainer.evaluation.experiments.robustness import Robustness
from trainer.evaluation.experiments.street import Street
from trainer.evaluation.outcome import REPORT, SUMMARY, report_frames, write_outcome
from trainer.evaluation.report.figures import save_figure
from trainer.evaluation.report.page import ReportFigure
from trainer.evaluation.report.tables import MetricRow
from trainer.evaluation.store import Cell, CellStore, Values, code_fingerprint
from trainer.evaluation.workers import Workers, alone
from trainer.run.answers import Answer, NetworkAnswer
from trainer.run.folder import JOB, Fingerprint, output_folder, scene_records
from trainer.run.precision import precision_remark

EXPERIMENTS: dict[str, Experiment] = {
    experiment.name: experiment
    for experiment in (
        PointSpread(), Street(), Reflectors(), Detection(), Doppler(), Resolution(), Robustness(), Generalisation(),
        NoiseOnly(), Tradeoff(),
    )
}  # fmt: skip
"""By the name that ``--experiments`` takes, in the order of the report; the measured row comes after them."""
NAMES = (*EXPERIMENTS, MEASURED)
SUMMARY_COLUMNS = [(name, column) for name, experiment in EXPERIMENTS.items() for column in experiment.summary]
CELLS, FIGURES = "cells", "figures"
LINES = "lines.md"
RUNTIME = "runtime"
RUNTIME_REPEATS = 3
"""Runs for one image after a first one, of which the shortest counts: what else a machine does only adds."""

Progress = Callable[[str, int, int], None]
"""(what is computed, cells done, cells in all)."""


def evaluate(
    dataset: Location | str | None,
    out: Path,
    config: EvaluationConfig | None = None,
    measured: MeasuredInput | None = None,
    resume: bool = False,
    workers: int = 1,
    announce: Callable[[str], object] = print,
    progress: Progress | None = None,
) -> pa.Table:
    """Run the experiments that apply and write everything into ``out``; returns the metrics table.

    :param dataset: folder of a dataset with a test split, local or remote; None with ``measured``, for that alone
    :param measured: a row of a snapshot or cube, see
        :func:`trainer.evaluation.experiments.measured_input.read_measured`
    :param resume: keep the cells that ``out`` already has
    :param workers: processes that compute cells, see :class:`trainer.evaluation.workers.Workers`; the numbers, but for
        the seconds, do not depend on it. Seconds are measured before the first cell, in this process alone.
    :raises InputError: bad data, runs, names, or an experiment asked for that does not apply
    :raises TrainingStopped: three worker processes died of a cell
    """
    config = config or EvaluationConfig()
    remedy = "an empty or new folder, or --resume to keep what is finished"
    advance = progress or (lambda *_: None)
    with output_folder(out, resume, remedy) as folder:
        if resume:
            _require_cells(out)
        if config.methods is not None and dataset is not None:
            check_methods(config.methods)
        _check_experiments(config.experiments)
        if dataset is None:
            if measured is None:
                raise InputError("arguments", "neither a dataset nor --measured", "one of both, or both")
            if config.experiments is not None and config.experiments != (MEASURED,):
                raise InputError("--experiments", ", ".join(config.experiments), f"{MEASURED} alone without a dataset")
            look, obstacles = _measured_alone(measured, config)
            bench, left_out = Bench("", measured.radar or Radar(), (), frozenset(), (), config), dict[str, int]()
            chosen = list[Experiment]()
            title = f"Evaluation of {measured.path.name}"
        else:
            bench, left_out = open_bench(dataset, config)
            chosen, obstacles = choose_experiments(
                config.experiments, bench, None if measured is None else measured.path
            )
            obstacles = [*obstacles, *_of_precision(contender.answer for contender in bench.contenders)]
            title = f"Evaluation on {folder_name(locate(dataset))}"
            if measured is not None:
                arrays = [contender.array for contender in bench.contenders]
                look = partial(look_at, with_arrays(measured, bench.radar, arrays))
        remove_partial(out)
        store = CellStore(out / CELLS)
        for line in obstacles:
            announce(line)
        for kind, count in left_out.items():
            announce(f"{count} {kind} frames of the test split are left out: --frames {bench.config.frames}")
        if bench.frames:
            bench = replace(bench, seconds=_seconds(bench, store, advance))
        rows: list[MetricRow] = []
        figures: list[ReportFigure] = []
        (out / FIGURES).mkdir(exist_ok=True)
        written = set[str]()

        def save(name: str, figure: Figure) -> bytes:
            written.update({f"{name}.png", f"{name}.svg"})
            return save_figure(figure, out / FIGURES, name)

        with Workers(bench, workers, folder) as pool:
            street = EXPERIMENTS[Street.name]
            shown = _compute(street, bench, store, pool, partial(advance, "images")) if bench.frames else {}
            for experiment in chosen:
                results = _compute(experiment, bench, store, pool, partial(advance, experiment.name))
                rows += experiment.rows(bench, results)
                for name, figure in experiment.figures(bench, results).items():
                    figures.append(ReportFigure(experiment.title, experiment.caption, save(name, figure)))
        if measured is not None:
            advance(MEASURED, 0, 1)
            with threadpool_limits(limits=1):
                seen = look()
            advance(MEASURED, 1, 1)
            rows += seen.rows
            write_text(out / LINES, seen.lines)
            figures += [ReportFigure(TITLE, CAPTION, save(name, figure)) for name, figure in seen.figures.items()]
        rows += [
            single_row(RUNTIME, contender, SECONDS, {}, bench.seconds[contender.method, contender.array.name])
            for contender in bench.contenders
        ]
        frames = [] if dataset is None else report_frames(bench, shown, open_dataset(dataset))
        ran = [*(experiment.name for experiment in chosen), *([MEASURED] if measured is not None else [])]
        table = write_outcome(out, bench, title, ran, rows, figures, frames, SUMMARY_COLUMNS)
    if stale := sum(path.name not in written for path in (out / FIGURES).iterdir()):
        announce(f"{stale} files in {out / FIGURES} are of other arguments and not in this report")
    if store.unused:
        announce(f"{store.unused} cells in {store.directory} are of other arguments and not in this report")
    written_texts = [REPORT, *([SUMMARY] if bench.frames else []), *([LINES] if measured is not None else [])]
    announce(
        f"{store.computed} cells computed, {store.kept} kept; {len(table)} numbers; look: "
        f"{', '.join(str(out / name) if name == REPORT else name for name in written_texts)}"
    )
    return table


def open_bench(source: Location | str, config: EvaluationConfig) -> tuple[Bench, dict[str, int]]:
    """(what the experiments work on, frames left out by kind); errors as :func:`evaluate`."""
    dataset = open_dataset(source)
    radar = radar_of(dataset.description(), dataset.path / MANIFEST)
    if not config.arrays:
        raise InputError("--arrays", "none", f"some of {', '.join(DEFAULT_ARRAYS)}, or TOML files")
    arrays = [choose_array(name, radar) for name in config.arrays]
    names = [array.name for array in arrays]
    if twice := [name for index, name in enumerate(names) if name in names[:index]]:
        raise InputError("--arrays", f"{twice[0]!r} twice", "every array once, files of different names")
    refs, left_out = frame_refs(dataset, "test", config.frames)
    contenders = gather(config.methods, config.runs, arrays, radar, dataset.path)
    fingerprint = Fingerprint.of(dataset.path, dataset.records, {})
    scenes = (
        frozenset(frame.scene for frame in dataset.frames("train", ())) if "train" in dataset.splits else frozenset()
    )
    of_data = scene_records(dataset.manifest)
    return Bench(fingerprint.sha256, radar, refs, scenes, contenders, config, scenes=of_data), left_out


def _measured_alone(row: MeasuredInput, config: EvaluationConfig) -> tuple[Callable[[], MeasuredRow], list[str]]:
    """(what looks at a row without a dataset, a line for each array and run that does not fit, and on precision)."""
    # The default names are of the default radar: of another cube nobody has asked for them.
    asked = ("full",) if row.radar is not None and config.arrays == DEFAULT_ARRAYS else config.arrays
    chosen, radar = check_measured_methods(config.methods), row.radar or Radar()
    arrays, obstacles = [], []
    for name in asked:
        try:
            arrays.append(choose_array(name, radar))
        except InputError as error:
            obstacles.append(f"left out: {error}")
    networks, others = fitting_networks(row, config.runs)
    obstacles += [*others, *_of_precision(answer for _, answer in networks)]
    return partial(look_at, with_arrays(row, radar, arrays), chosen, networks), obstacles


def _of_precision(answers: Iterable[Answer]) -> list[str]:
    """A line where networks among these are computed in another precision than their runs say."""
    remark = precision_remark(answer.imager.config for answer in answers if isinstance(answer, NetworkAnswer))
    return [remark] if remark else []


def choose_experiments(
    names: Sequence[str] | None, bench: Bench, measured: Path | None
) -> tuple[list[Experiment], list[str]]:
    """(the experiments that apply, a line for each that does not).

    :param names: of :data:`NAMES`; None for all
    :raises InputError: an unknown name, one that does not apply, none, a snapshot that no experiment looks at
    """
    _check_experiments(names)
    wanted = [experiment for name, experiment in EXPERIMENTS.items() if names is None or name in names]
    obstacles = {experiment.name: experiment.obstacle(bench) for experiment in wanted}
    if names is None or MEASURED in names:
        obstacles[MEASURED] = None if measured else "no --measured file"
    for name, obstacle in obstacles.items():
        if obstacle and names is not None:
            raise InputError("--experiments", f"{name}: {obstacle}", "an experiment that applies")
    if measured is not None and MEASURED not in obstacles:
        raise InputError("--measured", f"{measured} without the experiment", f"{MEASURED!r} in --experiments")
    return (
        [experiment for experiment in wanted if not obstacles[experiment.name]],
        [f"experiment {name} is left out: {obstacle}" for name, obstacle in obstacles.items() if obstacle],
    )


def _check_experiments(names: Sequence[str] | None) -> None:
    if unknown := [name for name in names or () if name not in NAMES]:
        raise InputError("--experiments", repr(unknown[0]), f"some of {', '.join(NAMES)}")
    if names is not None and not names:
        raise InputError("--experiments", "none", f"some of {', '.join(NAMES)}")


def _require_cells(out: Path) -> None:
    if any(item.name != JOB for item in out.iterdir()) and not (out / CELLS).is_dir():
        raise InputError("--out", f"{out} holds no {CELLS}/", "the folder of an evaluation to resume, or a new one")


def _compute(
    experiment: Experiment, bench: Bench, store: CellStore, pool: Workers, advance: Callable[[int, int], None]
) -> Results:
    """The cells of an experiment in the order of its tasks; those not yet on disk are computed and kept one by one."""
    tasks = experiment.tasks(bench)
    cells = [_cell(experiment.cells or experiment.name, task) for task in tasks]
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


def _cell(family: str, task: Task) -> Cell:
    return Cell(family, task.method, task.array, task.condition, task.inputs, code_fingerprint())


def _seconds(bench: Bench, store: CellStore, advance: Progress) -> dict[tuple[str, str], float]:
    """Seconds for one image of each contender, one thread: the first test frame, whole."""
    ref = bench.frames[0]
    tasks = [
        contender_task(bench, contender, ref.condition, bench.data_sha256, partial(_time, contender, ref))
        for contender in bench.contenders
    ]
    seconds = {}
    for done, task in enumerate(tasks):
        advance(RUNTIME, done, len(tasks))
        cell = _cell(RUNTIME, task)
        values = store.finished(cell)
        if values is None:
            values = store.keep(cell, alone(task))
        seconds[task.method, task.array] = float(values["seconds"])
    advance(RUNTIME, len(tasks), len(tasks))
    return seconds


def _time(contender: Contender, ref: FrameRef) -> Values:
    frame = load_frame(ref)
    contender.answer.image(frame.range_channel[0], frame.noise_power)
    seconds = []
    for _ in range(RUNTIME_REPEATS):
        start = time.perf_counter()
        contender.answer.image(frame.range_channel[0], frame.noise_power)
        seconds.append(time.perf_counter() - start)
    return {"seconds": np.asarray(min(seconds))}
