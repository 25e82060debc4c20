"""What an experiment of ``trainer evaluate`` is made of: contenders, tasks that fill cells, rows of the metrics
table."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import ArrayLike
from pydantic import BaseModel, ConfigDict, Field

from shared.dataset.locations import Location
from shared.processes.defaults import LARGEST_SEED
from shared.radar import Radar
from trainer.data.arrays import ArrayChoice
from trainer.evaluation.experiments.contenders import Contender
from trainer.evaluation.report.tables import TRUTH, Condition, MetricRow, SummaryColumn, condition_text
from trainer.evaluation.store import Values, digest
from trainer.metrics.bootstrap import UNDEFINED, Interval, bootstrap_mean, bootstrap_ratio, wilson
from trainer.run.folder import SceneRecord

KEPT = 2
"""Frames or simulated scenes that an experiment holds while its contenders take turns."""


DEFAULT_ARRAYS = ("sparse6", "sparse4", "full")


class EvaluationConfig(BaseModel):
    """Who is compared by what, and how much is computed.

    :param runs: run folders of trainer fit, each evaluated on its own array
    :param methods: names of estimators, "cnn" and "unet" for the runs; None for those of
        :func:`trainer.evaluation.experiments.contenders.gather`, of a measured row alone for all
    :param arrays: see :func:`trainer.data.arrays.choose_array`
    :param experiments: some of :data:`trainer.evaluation.evaluate.NAMES`; None for all that apply
    :param frames: most frames of the test split that are scored, 50 as in the paper
    :param shown: frames that the report shows
    :param trials: simulated trials of each condition
    :param seed: of trials, noise and bootstrap
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    runs: tuple[Path, ...] = ()
    methods: tuple[str, ...] | None = None
    arrays: tuple[str, ...] = DEFAULT_ARRAYS
    experiments: tuple[str, ...] | None = None
    frames: int = Field(default=50, ge=1, le=10**6)
    shown: int = Field(default=3, ge=1, le=1000)
    trials: int = Field(default=120, ge=2, le=10**5)
    seed: int = Field(default=0, ge=0, le=LARGEST_SEED)


@dataclass(frozen=True)
class FrameRef:
    """Where a frame stands, and what it is of.

    :param path: of its shard
    :param row: in the shard
    """

    path: Location
    row: int
    frame_id: int
    kind: str
    scene: str

    @property
    def condition(self) -> str:
        return f"frame={self.frame_id}"


@dataclass(frozen=True, eq=False)
class Bench:
    """What every experiment works on.

    :param data_sha256: fingerprint of its shards, as runs hold it
    :param frames: of the test split, that are scored
    :param training_scenes: scenes with frames in the dataset's training split
    :param scenes: that the dataset is of; None where it does not say
    :param seconds: for one image by (method, array), measured
    """

    data_sha256: str
    radar: Radar
    frames: tuple[FrameRef, ...]
    training_scenes: frozenset[str]
    contenders: tuple[Contender, ...]
    config: EvaluationConfig
    seconds: Mapping[tuple[str, str], float] = field(default_factory=dict)
    scenes: tuple[SceneRecord, ...] | None = None

    @property
    def arrays(self) -> tuple[ArrayChoice, ...]:
        """The arrays of its contenders, each once."""
        return tuple({contender.array.name: contender.array for contender in self.contenders}.values())


@dataclass(frozen=True)
class Task:
    """One cell to be filled.

    :param method: contender's method, "truth" for what belongs to none
    :param array: its array's name
    :param condition: what was varied, as text
    :param inputs: fingerprint of what the cell depends on besides its names
    :param compute: the work
    :param device: that the work needs, "cpu" or "cuda"
    """

    method: str
    array: str
    condition: str
    inputs: str
    compute: Callable[[], Values]
    device: str = "cpu"

    @property
    def key(self) -> tuple[str, str, str]:
        return self.method, self.array, self.condition


def task_of(
    bench: Bench,
    contender: Contender | None,
    condition: str,
    inputs: object,
    compute: Callable[[], Values],
    array: str = "",
) -> Task:
    """A task whose cell depends on the radar, the contender and ``inputs``, of plain JSON types.

    :param contender: None for what belongs to none, the truth
    :param array: of the truth's task, if it belongs to one
    """
    radar = bench.radar.model_dump(mode="json")
    if contender is None:
        return Task(TRUTH, array, condition, digest([radar, inputs]), compute)
    return Task(*contender.key, condition, digest([contender.inputs, radar, inputs]), compute, contender.device)


Results = Mapping[tuple[str, str, str], Values]
"""The filled cells of one experiment by (method, array, condition)."""


class Numbers:
    """The rows of the metrics table that an experiment finds.

    :param experiment: its name
    :param seed: of the bootstrap
    :ivar rows: in the order in which they were found
    """

    def __init__(self, experiment: str, seed: int) -> None:
        self.rows: list[MetricRow] = []
        self._experiment, self._seed = experiment, seed

    def add(self, key: tuple[str, str], metric: str, condition: Condition, found: Interval, samples: int = 1) -> None:
        """A number whose interval is known.

        :param key: (method, array)
        :param samples: what it is a mean of
        """
        value, low, high = found.value, found.low, found.high
        self.rows.append(MetricRow(self._experiment, *key, metric, condition, value, low, high, samples))

    def mean(self, contender: Contender, metric: str, condition: Condition, samples: ArrayLike) -> None:
        """The mean of samples with its bootstrap interval.

        Samples that are not finite (a metric that is not defined) do not count; the row says how many did.
        """
        values = np.asarray(samples, dtype=np.float64)
        values = values[np.isfinite(values)]
        found = bootstrap_mean(values, self._seed) if len(values) else UNDEFINED
        self.add(contender.key, metric, condition, found, len(values))

    def ratio(
        self, contender: Contender, metric: str, condition: Condition, parts: ArrayLike, wholes: ArrayLike
    ) -> None:
        """A ratio of sums over frames with its bootstrap interval over the frames; NaN where the whole is nothing."""
        part, whole = np.asarray(parts, dtype=np.float64), np.asarray(wholes, dtype=np.float64)
        found = bootstrap_ratio(part, whole, self._seed) if whole.sum() > 0 else UNDEFINED
        self.add(contender.key, metric, condition, found, len(whole))

    def share(self, contender: Contender, metric: str, condition: Condition, successes: ArrayLike) -> None:
        """A share of trials with its Wilson interval, which keeps a width where all trials end alike."""
        outcomes = np.asarray(successes, dtype=bool)
        self.add(contender.key, metric, condition, wilson(int(outcomes.sum()), len(outcomes)), len(outcomes))


def values_of(rows: Sequence[MetricRow]) -> dict[tuple[str, str, str, str], float]:
    """The numbers by (method, array, metric, condition as text)."""
    return {(row.method, row.array, row.metric, condition_text(row.condition)): row.value for row in rows}


def known(value: float) -> Interval:
    """Of a number that is not estimated."""
    return Interval(value, value, value)


class Experiment(ABC):
    """One question, its cells, its numbers and its figure.

    :cvar name: as ``--experiments`` takes it
    :cvar cells: name under which its cells are kept, its own where empty; experiments that evaluate the same cells
        share it
    :cvar title: one line for report and help
    :cvar caption: below its figures
    :cvar summary: the columns that it has in the summary
    """

    name: str
    cells: str = ""
    title: str
    caption: str
    summary: tuple[SummaryColumn, ...] = ()

    def obstacle(self, bench: Bench) -> str | None:
        """Why the experiment does not apply to what is given; None where it does."""
        return None

    @abstractmethod
    def tasks(self, bench: Bench) -> Sequence[Task]:
        """The cells that the experiment needs, in an order that the bench alone decides; those that share a frame or a
        simulated scene follow each other."""

    def rows(self, bench: Bench, results: Results) -> list[MetricRow]:
        """The numbers."""
        found = Numbers(self.name, bench.config.seed)
        self.count(bench, results, found)
        return found.rows

    @abstractmethod
    def count(self, bench: Bench, results: Results, found: Numbers) -> None:
        """Put the numbers into ``found``."""

    @abstractmethod
    def figures(self, bench: Bench, results: Results, rows: Sequence[MetricRow]) -> dict[str, Figure]:
        """The figures by the name of their files.

        :param rows: of :meth:`rows`
        """

    def texts(self) -> dict[str, str]:
        """What is written beside the figures, by the name of its file."""
        return {}


class Simulated(Experiment):
    """Every contender on the same simulated scenes: a cell is what one of them makes of one scene."""

    @abstractmethod
    def conditions(self, bench: Bench) -> Sequence[str]:
        """The scenes, as text that tells them apart."""

    @abstractmethod
    def scene(self, bench: Bench, place: int) -> Any:
        """The scene of a condition; it is kept while the contenders take turns."""

    @abstractmethod
    def score(self, bench: Bench, contender: Contender, place: int, scene: Any) -> Values:
        """The cell of a contender."""

    def entrants(self, bench: Bench) -> tuple[Contender, ...]:
        """Who takes part."""
        return bench.contenders

    def inputs(self, bench: Bench) -> list[int]:
        """What a cell depends on besides contender, radar and condition."""
        return [bench.config.seed]

    def tasks(self, bench: Bench) -> Sequence[Task]:
        kept = lru_cache(maxsize=KEPT)(partial(self.scene, bench))

        def cell(contender: Contender, place: int) -> Values:
            return self.score(bench, contender, place, kept(place))

        return [
            task_of(bench, contender, condition, self.inputs(bench), partial(cell, contender, place))
            for place, condition in enumerate(self.conditions(bench))
            for contender in self.entrants(bench)
        ]
