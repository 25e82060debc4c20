"""Networks of one, two and four scenes: rows, chart and table of what more scenes are worth."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from small_evaluation import FULL, QUICK, RADAR, THIN, make_run, strong_frame
from tiny_radar import write_dataset

from shared.physics.errors import InputError
from trainer.data.scene_records import SceneRecord
from trainer.evaluation.evaluate import evaluate
from trainer.evaluation.experiments.ranking import OVER_NEXT
from trainer.evaluation.report import worlds as report
from trainer.evaluation.report.worlds import OVER_BARE, OVER_FEWEST, TrainedOn, read_panels
from trainer.evaluation.rows import AVERAGE_PRECISION, MetricRow
from trainer.run.folder import Fingerprint, load_imager, save_weights

POINTS = {("populated", 4): [0], ("populated", 1): [0], ("bare", 4): [0, 1], ("bare", 1): [0]}
"""Seeds of the networks by kind and number of scenes. Their order is not that of the chart."""
SCENES = [{"name": "munich", "content_sha256": "m"}, {"name": "etoile", "content_sha256": "e"}]
CARS = {"population": {"populate": "cars=20"}}


def unseen(directory, entries=SCENES):
    """Four test frames of two scenes, and a close-target frame that belongs to none."""
    frames = [replace(strong_frame(index), kind="scene", scene=SCENES[index % 2]["name"]) for index in range(4)]
    data = write_dataset(directory, {"test": [*frames, strong_frame(9)]}, RADAR)
    manifest = json.loads((data / "manifest.json").read_text())
    (data / "manifest.json").write_text(json.dumps({**manifest, "scenes": entries}))
    return data


def seen(kind, count, **changes):
    """Fingerprints of a city each, as many frames for every number of them."""
    populate = "cars=20" if kind == "populated" else None
    return tuple(
        Fingerprint(
            name=f"{kind}-city{index}", sha256=f"{kind} {index}", frames={"train": 8 // count, "validation": 1},
            scenes=(SceneRecord(name=f"city-{index}", content_sha256=f"{kind} {index}", populate=populate),),
        ).model_copy(update=changes)
        for index in range(1, count + 1)
    )  # fmt: skip


def network(directory, datasets, seed=0, array=THIN, **changes):
    """A run whose weights are all random, its last layers too."""
    path = make_run(directory, array, datasets=datasets, **changes)
    imager = load_imager(path)[1]
    torch.manual_seed(seed)
    with torch.no_grad():
        for parameter in imager.parameters():
            parameter.add_(0.05 * torch.randn_like(parameter))
    save_weights(path, imager)
    return path


def assess(data, out, runs, **changes):
    arguments: dict[str, Any] = {
        "methods": ["das", "unet"], "arrays": [str(data.parent / "thin.toml")], "experiments": ["worlds", "detection"],
        "config": QUICK.model_copy(update={"frames": 4, "shown": 1}), "announce": lambda _: None,
    }  # fmt: skip
    return evaluate(data, out, runs, **(arguments | changes))


@pytest.fixture(scope="module")
def tested(tmp_path_factory):
    """(table, folder) of the evaluation on bare scenes, and on populated ones."""
    folder = tmp_path_factory.mktemp("worlds")
    (folder / "thin.toml").write_text("rx = [0, 1, 2, 5]\n")
    runs = [
        network(folder / f"{kind}-{scenes}-seed{seed}", seen(kind, scenes), seed + 10 * scenes + 100 * len(kind))
        for (kind, scenes), seeds in POINTS.items()
        for seed in seeds
    ]
    found = []
    for name, more in (("bare", {}), ("populated", CARS)):
        data = unseen(folder / f"unseen-{name}", [{**entry, **more} for entry in SCENES])
        found.append((assess(data, folder / f"report-{name}", runs), folder / f"report-{name}"))
    return found


def of_worlds(table):
    return [row for row in table.to_pylist() if row["experiment"] == "worlds"]


def test_the_gain_of_a_network_is_over_the_best_of_all_other_methods(tested):
    rows = [row for row in tested[0][0].to_pylist() if row["experiment"] == "detection"]
    precision = {row["method"]: row["value"] for row in rows if row["metric"] == AVERAGE_PRECISION}
    gains = {row["method"]: row for row in rows if row["metric"] == OVER_NEXT}
    assert set(gains) == {method for method in precision if method.startswith("unet")}
    for method, gain in gains.items():
        best = max((value, other) for other, value in precision.items() if other not in (method, "truth"))
        assert gain["condition"] == f"over={best[1]}"
        assert gain["value"] == pytest.approx(precision[method] - best[0])
        assert gain["low"] <= gain["value"] <= gain["high"]


def test_a_point_is_the_mean_of_its_runs_and_a_gain_the_difference_of_points(tested):
    table = tested[0][0]
    alone = {
        row["method"].removeprefix("unet:"): row["value"]
        for row in table.to_pylist()
        if (row["experiment"], row["metric"]) == ("detection", AVERAGE_PRECISION)
    }
    assert len({round(value, 6) for value in alone.values()}) == 7, "networks that differ in nothing"
    rows = {(row["method"], row["metric"], row["condition"]): row for row in of_worlds(table)}
    means = {}
    for kind in ("bare", "populated"):
        for scenes in (1, 4):
            seeds = POINTS[kind, scenes]
            of_point = f"tested on=2 bare scenes,trained on={kind},scenes={scenes},frames=8"
            where = f"{of_point},runs={len(seeds)}"
            means[kind, scenes] = rows.pop(("unet", AVERAGE_PRECISION, where))["value"]
            of_runs = {f"{kind}-{scenes}-seed{seed}": alone[f"{kind}-{scenes}-seed{seed}"] for seed in seeds}
            assert means[kind, scenes] == pytest.approx(np.mean(list(of_runs.values())))
            for name, value in of_runs.items() if len(seeds) > 1 else ():
                assert rows.pop((f"unet:{name}", AVERAGE_PRECISION, of_point))["value"] == value
        gain = rows.pop(("unet", OVER_FEWEST, where))
        assert gain["value"] == pytest.approx(means[kind, 4] - means[kind, 1])
        assert gain["low"] <= gain["value"] <= gain["high"]
    for scenes in (1, 4):
        where = f"tested on=2 bare scenes,trained on=populated,scenes={scenes},frames=8,runs=1"
        gain = rows.pop(("unet", OVER_BARE, where))["value"]
        assert gain == pytest.approx(means["populated", scenes] - means["bare", scenes])
    # What is left is the method that is trained on nothing.
    ((method, metric, where), row) = rows.popitem()
    assert (method, metric, where) == ("das", AVERAGE_PRECISION, "tested on=2 bare scenes")
    assert row["value"] == alone["das"]
    assert not rows


def test_close_targets_are_of_no_scene_and_do_not_count(tested):
    assert {row["samples"] for row in of_worlds(tested[0][0])} == {4}


def test_the_order_of_the_runs_is_not_that_of_the_points(tested):
    (panel,) = read_panels(tested[0][1])
    assert list(panel.of(AVERAGE_PRECISION)) == [
        TrainedOn(kind, scenes, 8, len(POINTS[kind, scenes])) for kind in ("bare", "populated") for scenes in (1, 4)
    ]


def test_the_chart_has_a_column_for_each_evaluation_and_a_line_for_each_kind(tested):
    panels = [panel for _, out in tested for panel in read_panels(out)]
    assert [panel.title for panel in panels] == [f"thin: 4 frames of 2 {kind} scenes" for kind in ("bare", "populated")]
    figure = report.figure(panels)
    assert len(figure.axes) == 4
    for axis, panel in zip(figure.axes[:2], panels, strict=True):
        expected = panel.of(AVERAGE_PRECISION)
        for kind in ("bare", "populated"):
            line = next(line for line in axis.lines if line.get_color() == report.KIND_COLOURS[kind])
            values = [row.value for of, row in expected.items() if of.kind == kind]
            x, y = np.transpose(np.asarray(line.get_xydata()))
            np.testing.assert_allclose(x, [1, 4], rtol=0.05)
            np.testing.assert_array_equal(y, values)
        assert {text.get_text() for text in axis.texts} == {"trained on bare", "trained on populated", "das"}
    for axis in figure.axes[2:]:
        assert [label.get_text() for label in axis.get_xticklabels()] == ["1", "4"]
        assert {text.get_text() for text in axis.texts} == {"trained on bare", "trained on populated"}


def test_chart_and_table_are_written_and_the_page_has_the_chart(tested, tmp_path, capsys):
    report.main([str(tested[0][1]), str(tested[1][1]), "--out", str(tmp_path / "out")])
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"worlds.png", "worlds.svg", "worlds.md"}
    text = (tmp_path / "out" / "worlds.md").read_text()
    assert capsys.readouterr().out == text
    head, _, *lines = ([cell.strip() for cell in line.strip().strip("|").split("|")] for line in text.splitlines())
    assert head == [
        "thin, trained on", "scenes", "frames", "runs",
        "AP, 4 frames of 2 bare scenes", "over the fewest", "over bare",
        "AP, 4 frames of 2 populated scenes", "over the fewest", "over bare",
    ]  # fmt: skip
    assert [line[:4] for line in lines] == [
        ["bare", "1", "8", "1"], ["bare", "4", "8", "2"], ["populated", "1", "8", "1"], ["populated", "4", "8", "1"],
        ["nothing: das", "", "", ""],
    ]  # fmt: skip
    filled = [[bool(cell) for cell in line[4:7]] for line in lines]
    assert filled == [[1, 0, 0], [1, 1, 0], [1, 0, 1], [1, 1, 1], [1, 0, 0]]
    assert all(line[4:7] != line[7:] or line[4] for line in lines)
    assert (tested[0][1] / "figures" / "worlds.png").is_file()


def test_panels_of_other_numbers_of_scenes_have_one_axis_with_all_of_them():
    panels = [
        panel
        for array, counts in (("one", (1, 2, 8)), ("two", (1, 4)))
        for panel in report.panels(
            MetricRow("worlds", "unet", array, AVERAGE_PRECISION, condition, 0.5, 0.4, 0.6, 2)
            for condition in (report.condition("1 bare scene", TrainedOn("bare", count, 8, 1)) for count in counts)
        )
    ]
    for axis in report.figure(panels).axes[2:]:
        assert [label.get_text() for label in axis.get_xticklabels()] == ["1", "2", "4", "8"]
        assert axis.get_xlabel() == "scenes trained on"


def test_the_same_evaluations_are_the_same_chart(tested, tmp_path):
    for name in ("a", "b"):
        report.main([str(tested[0][1]), "--out", str(tmp_path / name)])
    for kind in ("png", "svg", "md"):
        assert (tmp_path / "a" / f"worlds.{kind}").read_bytes() == (tmp_path / "b" / f"worlds.{kind}").read_bytes()


def test_the_name_of_an_array_is_text():
    row = MetricRow("worlds", "das", "$a|<b>{", AVERAGE_PRECISION, report.condition("1 scene", None), 0.5, 0.4, 0.6, 2)
    panels = report.panels([row])
    assert report.table(panels).startswith(r"| $a\|&lt;b&gt;{, trained on | scenes |")
    report.figure(panels).draw_without_rendering()


def test_what_is_not_defined_is_left_open():
    nan = float("nan")
    conditions = [report.condition("1 bare scene", TrainedOn("bare", scenes, 8, 1)) for scenes in (1, 2)]
    panels = report.panels(
        MetricRow("worlds", "unet", "thin", AVERAGE_PRECISION, condition, value, nan, nan, 1)
        for condition, value in zip(conditions, (0.5, nan), strict=True)
    )
    assert "| bare | 1 | 8 | 1 | 0.500 |  |  |" in report.table(panels)
    assert "| bare | 2 | 8 | 1 |  |  |  |" in report.table(panels)
    assert panels[0].title == "thin: 1 frame of 1 bare scene"
    report.figure(panels).draw_without_rendering()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"scenes": None}, "no two runs of one array say that they were trained on different numbers of scenes"),
        ({"scenes": (SceneRecord(name="city-1", content_sha256="m"),)}, "no two runs of one array"),
        ({"frames": {"train": 8}}, "were trained on 8 and on 16 frames, .* trainer fit --frames makes them equal"),
    ],
)
def test_runs_that_differ_in_nothing_else_are_needed(tmp_path, changes, message):
    (tmp_path / "thin.toml").write_text("rx = [0, 1, 2, 5]\n")
    runs = [network(tmp_path / str(scenes), seen("bare", scenes, **changes)) for scenes in (1, 2)]
    with pytest.raises(InputError, match=message):
        assess(unseen(tmp_path / "data"), tmp_path / "out", runs)


def test_networks_of_another_kind_are_not_runs_of_other_seeds(tmp_path):
    (tmp_path / "thin.toml").write_text("rx = [0, 1, 2, 5]\n")
    runs = [
        network(tmp_path / f"{scenes}-{steps}", seen("bare", scenes), seed=steps, steps=steps, frames=8 // scenes)
        for scenes, steps in ((1, 4), (2, 4), (2, 8))
    ]
    with pytest.raises(InputError, match="unet:1-4 was trained with steps = 4 and unet:2-8 with 8"):
        assess(unseen(tmp_path / "data"), tmp_path / "out", runs)


def test_a_run_that_does_not_say_its_scenes_is_named(tmp_path):
    (tmp_path / "thin.toml").write_text("rx = [0, 1, 2, 5]\n")
    runs = [network(tmp_path / str(scenes), seen("bare", scenes)) for scenes in (1, 2)]
    runs.append(network(tmp_path / "old", seen("bare", 2, scenes=None)))
    with pytest.raises(InputError, match="unet:old does not say on which scenes it was trained"):
        assess(unseen(tmp_path / "data"), tmp_path / "out", runs)


@pytest.mark.parametrize(
    "met", [SceneRecord(name="else", content_sha256="m"), SceneRecord(name="munich", content_sha256="with cars")]
)
def test_a_scene_that_a_network_may_have_seen_is_not_unseen(tmp_path, met):
    """The same content by another name; another content of the same name, which may be the same streets with cars."""
    (tmp_path / "thin.toml").write_text("rx = [0, 1, 2, 5]\n")
    more = (*seen("bare", 2), *seen("bare", 1, scenes=(met,), frames={}))
    runs = [network(tmp_path / "one", seen("bare", 1)), network(tmp_path / "two", more)]
    with pytest.raises(InputError, match="unet:two may have been trained on scene 'munich'"):
        assess(unseen(tmp_path / "data"), tmp_path / "out", runs)


def test_networks_of_two_arrays_are_two_panels(tmp_path):
    (tmp_path / "thin.toml").write_text("rx = [0, 1, 2, 5]\n")
    runs = [
        network(tmp_path / f"{array.name}-{scenes}", seen("bare", scenes), scenes, array)
        for array in (THIN, FULL)
        for scenes in (1, 2)
    ]
    arrays = [str(tmp_path / "thin.toml"), "full"]
    assess(unseen(tmp_path / "data"), tmp_path / "out", runs, arrays=arrays, experiments=["worlds"])
    panels = read_panels(tmp_path / "out")
    assert [panel.array for panel in panels] == ["thin", "full"]
    assert report.table(panels).count("| bare | 2 | 8 | 1 |") == 2


def test_a_file_where_the_chart_shall_go_is_refused(tested, tmp_path, capsys):
    (tmp_path / "out").write_text("mine")
    with pytest.raises(SystemExit) as caught:
        report.main([str(tested[0][1]), "--out", str(tmp_path / "out")])
    assert caught.value.code == 2
    assert "expected a folder" in capsys.readouterr().err
    assert (tmp_path / "out").read_text() == "mine"


def test_an_evaluation_without_the_experiment_is_refused(tmp_path, capsys):
    with pytest.raises(SystemExit) as caught:
        report.main([str(tmp_path), "--out", str(tmp_path / "out")])
    assert caught.value.code == 2
    assert "the folder of a finished trainer evaluate" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
