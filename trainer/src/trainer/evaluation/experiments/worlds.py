"""Networks that were trained on one, two, more scenes, tested on others: is a further world worth simulating?"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from matplotlib.figure import Figure

from trainer.data.scene_records import SceneRecord
from trainer.evaluation.experiments.bench import Bench, Results, Task
from trainer.evaluation.experiments.contenders import Contender
from trainer.evaluation.experiments.detection import scene_frames
from trainer.evaluation.experiments.frames import CELLS, frame_tasks, ranking, too_small
from trainer.evaluation.experiments.generalisation import trained_on
from trainer.evaluation.report import worlds as report
from trainer.evaluation.report.style import counted
from trainer.evaluation.report.worlds import BARE, MIXED, OVER_BARE, OVER_FEWEST, POPULATED, TrainedOn
from trainer.evaluation.rows import AVERAGE_PRECISION, MetricRow, SummaryColumn
from trainer.metrics.ranking import Ranking, mean_average_precision
from trainer.run.configuration import FitConfig

MAY_DIFFER = ("seed", "frames")
"""Of the configurations of networks that are compared."""
Points = dict[TrainedOn, list[Contender]]
"""The networks of each point of the chart."""


class Worlds:
    """What is a further scene to train on worth, and what is one with traffic?"""

    name = report.NAME
    cells = CELLS
    title = report.TITLE
    caption = (
        "Average precision on scene frames over the number of scenes that a network was trained on, as its run says "
        "it, all with as many frames; networks of other seeds are one point, their mean, and a small dot each. Bars: "
        "95 % intervals over the test frames. Below: what is gained over the network of the fewest scenes, on the same "
        "test frames. Dashed: methods that are trained on nothing."
    )
    summary: tuple[SummaryColumn, ...] = ()

    def obstacle(self, bench: Bench) -> str | None:
        if not scene_frames(bench):
            return "the test split has no scene frames"
        arrays = [_points(bench, array.name) for array in bench.arrays]
        if not any(len({of.scenes for of in points}) > 1 for points in arrays):
            return "no two runs of one array say that they were trained on different numbers of scenes"
        if silent := [one.method for one in bench.contenders if one.parameters and _scenes(one) is None]:
            return f"{silent[0]} does not say on which scenes it was trained; leave its run out to see the others"
        for points in arrays:
            if len(frames := sorted({of.frames for of in points})) > 1:
                return (
                    f"runs of one array were trained on {frames[0]} and on {frames[-1]} frames, which is a difference "
                    "of its own; trainer fit --frames makes them equal"
                )
            if difference := _difference(_networks(points)):
                return difference
        for contender in [contender for points in arrays for contender in _networks(points)]:
            for scene in _tested_scenes(bench):
                if trained_on(bench, contender, scene) != "no":
                    return f"{contender.method} may have been trained on scene {scene!r}, which is not unseen then"
        return too_small(bench)

    def tasks(self, bench: Bench) -> Sequence[Task]:
        return frame_tasks(bench)

    def rows(self, bench: Bench, results: Results) -> list[MetricRow]:
        return [
            row for array in bench.arrays if _points(bench, array.name) for row in _rows(bench, results, array.name)
        ]

    def figures(self, bench: Bench, results: Results) -> dict[str, Figure]:
        return {self.name: report.figure(report.panels(self.rows(bench, results)))}


def _networks(points: Points) -> list[Contender]:
    return [contender for of_point in points.values() for contender in of_point]


def _difference(contenders: Sequence[Contender]) -> str | None:
    """Which networks were trained in another way than the first, beyond seed and frames; None where none was."""
    for contender in contenders[1:]:
        for name in (name for name in FitConfig.model_fields if name not in MAY_DIFFER):
            one, other = (getattr(each.config, name, None) for each in (contenders[0], contender))
            if one != other:
                return (
                    f"{contenders[0].method} was trained with {name} = {one} and {contender.method} with {other}, "
                    "which is a difference of its own"
                )
    return None


def _rows(bench: Bench, results: Results, array: str) -> list[MetricRow]:
    refs, tested_on = scene_frames(bench), _tested_on(bench)
    points = _points(bench, array)
    found = []

    def rankings(contenders: Sequence[Contender]) -> list[Ranking]:
        return [ranking(results, contender.method, array, refs) for contender in contenders]

    def add(
        method: str, metric: str, of: TrainedOn | None, contenders: Sequence[Contender], less: Sequence[Contender] = ()
    ) -> None:
        interval = mean_average_precision(rankings(contenders), rankings(less), bench.config.seed)
        where = report.condition(tested_on, of)
        found.append(
            MetricRow(Worlds.name, method, array, metric, where, interval.value, interval.low, interval.high, len(refs))
        )

    for contender in bench.contenders:
        if contender.array.name == array and not contender.parameters:
            add(contender.method, AVERAGE_PRECISION, None, [contender])
    for of, networks in points.items():
        kind = networks[0].method.partition(":")[0]
        add(kind, AVERAGE_PRECISION, of, networks)
        if len(networks) > 1:
            for contender in networks:
                add(contender.method, AVERAGE_PRECISION, TrainedOn(of.kind, of.scenes, of.frames, 0), [contender])
        fewest = next(other for other in points if other.kind == of.kind)
        if fewest != of:
            add(kind, OVER_FEWEST, of, networks, points[fewest])
        bare = [other for other in points if (other.kind, other.scenes) == (BARE, of.scenes)]
        if of.kind == POPULATED and bare:
            add(kind, OVER_BARE, of, networks, points[bare[0]])
    return found


def _points(bench: Bench, array: str) -> Points:
    """The networks of an array whose runs say on which scenes they were trained, by what these are, in its order."""
    found: dict[tuple[str, int, int], list[Contender]] = {}
    for contender in bench.contenders:
        scenes = _scenes(contender)
        if contender.array.name != array or not scenes:
            continue
        frames = sum(fingerprint.frames.get("train", 0) for fingerprint in contender.trained_on)
        found.setdefault((_kind(scenes), len(scenes), frames), []).append(contender)
    return {TrainedOn(*of, len(networks)): networks for of, networks in sorted(found.items(), key=lambda one: one[0])}


def _scenes(contender: Contender) -> tuple[SceneRecord, ...] | None:
    """Those that a network was trained on; None where one of its datasets was not noted with its scenes."""
    found = {}
    for fingerprint in contender.trained_on:
        if fingerprint.scenes is None:
            return None
        found.update({scene.content_sha256: scene for scene in fingerprint.scenes})
    return tuple(found.values())


def _kind(scenes: Iterable[SceneRecord]) -> str:
    populated = {scene.populate is not None for scene in scenes}
    return MIXED if len(populated) > 1 else POPULATED if True in populated else BARE


def _tested_scenes(bench: Bench) -> tuple[str, ...]:
    return tuple(dict.fromkeys(ref.scene for ref in scene_frames(bench)))


def _tested_on(bench: Bench) -> str:
    names = _tested_scenes(bench)
    records = [record for record in bench.scenes or () if record.name in names]
    return counted(len(names), f"{_kind(records)} scene" if records else "scene")
