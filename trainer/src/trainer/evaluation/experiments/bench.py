"""What an experiment of ``trainer evaluate`` is made of: contenders, tasks that fill cells, rows of the metrics
table."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache, partial
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from shared.dataset.documents import digest
from shared.dataset.locations import Location
from shared.radar import Radar
from trainer.data.arrays import ArrayChoice
from trainer.evaluation.experiments.contenders import Contender
from trainer.evaluation.options import EvaluationConfig
from trainer.evaluation.report.tables import TRUTH, Condition, Numbers, SummaryColumn, condition_text
from trainer.evaluation.store import Values
from trainer.run.folder import SceneRecord

KEPT = 2
"""Frames or simulated scenes that an experiment holds while its contenders take turns."""


@dataclass(frozen=True)
class FrameRef:
    """Where a frame stands, its shard and the row there, and what it is of."""

    path: Location
    row: int
    frame_id: int
    kind: str
    scene: str

    @property
    def named(self) -> Condition:
        return {"frame": self.frame_id}

    @property
    def condition(self) -> str:
        return condition_text(self.named)


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

    :param key: contender's method, "truth" for what belongs to none, its array's name, and what was varied, as text
    :param inputs: fingerprint of what the cell depends on besides its names
    :param device: that the work needs, "cpu" or "cuda"
    """

    key: tuple[str, str, str]
    inputs: str
    compute: Callable[[], Values]
    device: str = "cpu"


Results = Mapping[tuple[str, str, str], Values]
"""The filled cells of one experiment by (method, array, condition)."""


class Experiment:
    """One question, its cells, its numbers and its figure.

    Every contender images the same scenes, simulated ones or frames: a cell is what one of them makes of one.

    :cvar name: as ``--experiments`` takes it
    :cvar cells: name under which its cells are kept, its own where empty; experiments that evaluate the same cells
        share it
    :cvar title: one line for report and help
    :cvar caption: below its figures
    :cvar summary: the columns that it has in the summary
    :cvar metrics: what is counted, one figure for each trial of a scene, by its name in cells and table
    """

    name: str
    cells: str = ""
    title: str
    caption: str
    summary: tuple[SummaryColumn, ...] = ()
    metrics: tuple[str, ...] = ()

    def obstacle(self, bench: Bench) -> str | None:
        """Why the experiment does not apply to what is given; None where it does."""
        return None

    def conditions(self, bench: Bench) -> Sequence[Condition]:
        """The scenes, by what tells them apart."""
        return ()

    def scene(self, bench: Bench, place: int) -> Any:
        """The scene of a condition; it is kept while the contenders take turns."""

    def score(self, bench: Bench, contender: Contender, place: int, scene: Any) -> Values:
        """The cell of a contender, :attr:`metrics` among it."""
        return {}

    def entrants(self, bench: Bench) -> tuple[Contender, ...]:
        """Who takes part."""
        return bench.contenders

    def truths(self, bench: Bench, place: int) -> Mapping[str, Callable[[Any], Values]]:
        """Of a scene the cells that belong to no contender but to the truth, by array, if they belong to one."""
        return {}

    def inputs(self, bench: Bench) -> object:
        """What a cell depends on besides contender, radar and condition; of plain JSON types."""
        return [bench.config.seed]

    def tasks(self, bench: Bench) -> Sequence[Task]:
        """The cells that the experiment needs, in an order that the bench alone decides; those that share a frame or a
        simulated scene follow each other."""
        kept = lru_cache(maxsize=KEPT)(partial(self.scene, bench))

        def cell(score: Callable[[Any], Values], place: int) -> Values:
            return score(kept(place))

        tasks = []
        given = [bench.radar.model_dump(mode="json"), self.inputs(bench)]
        for place, condition in enumerate(map(condition_text, self.conditions(bench))):
            for contender in self.entrants(bench):
                inputs, score = digest([*given, contender.inputs]), partial(self.score, bench, contender, place)
                key, compute = (*contender.key, condition), partial(cell, score, place)
                tasks.append(Task(key, inputs, compute, contender.device))
            for array, scored in self.truths(bench, place).items():
                rx = [list(one.rx) for one in bench.arrays if one.name == array]
                tasks.append(Task((TRUTH, array, condition), digest([*given, rx]), partial(cell, scored, place)))
        return tasks

    def pooled(self, contender: Contender) -> Condition | None:
        """Under what the trials of all scenes count as one sample; None where every scene has a number of its own."""
        return None

    def count(self, bench: Bench, results: Results, found: Numbers) -> None:
        """Put the numbers into ``found``: mean or share of each metric."""
        scenes = self.conditions(bench)
        for contender in self.entrants(bench):
            of_all = self.pooled(contender)
            samples = [(scene, [scene]) for scene in scenes] if of_all is None else [(of_all, scenes)]
            for condition, members in samples:
                cells = [results[*contender.key, condition_text(scene)] for scene in members]
                for metric in self.metrics:
                    found.mean(contender.key, metric, condition, np.hstack([cell[metric] for cell in cells]))

    def figures(self, bench: Bench, results: Results, found: Numbers) -> dict[str, Figure]:
        """The figures by the name of their files.

        :param found: after :meth:`count`
        """
        return {}

    def texts(self) -> dict[str, str]:
        """What is written beside the figures, by the name of its file."""
        return {}
