"""``trainer evaluate``: columns, resume, determinism, what is left out, worker processes that none outlive.

Its refusals stand in ``tests/trainer/cli/test_refusals.py``.
"""

import multiprocessing
import os
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from command_line import ended
from small_evaluation import RADAR, make_data, run_all
from tiny_radar import RADAR as SHORT_RADAR
from tiny_radar import frame, write_dataset
from troubled_experiment import Troubled

from shared.physics.errors import InputError
from trainer.errors import Stopped
from trainer.evaluation.evaluate import EXPERIMENTS, NAMES, choose_experiments, open_bench
from trainer.evaluation.experiments.bench import Bench
from trainer.evaluation.options import EvaluationConfig
from trainer.evaluation.report.tables import SECONDS
from trainer.evaluation.store import Values
from trainer.evaluation.workers import Workers


def deterministic(table):
    """All that does not belong to the machine's clock."""
    return [
        {name: value for name, value in row.items() if name != SECONDS}
        for row in table.to_pylist()
        if row["experiment"] != "runtime"
    ]


def test_every_experiment_leaves_numbers_and_figures(evaluation):
    table, out = evaluation
    assert pq.read_table(out / "metrics.parquet").equals(table)
    assert table.column_names[:8] == ["experiment", "method", "array", "metric", "condition", "value", "low", "high"]
    # A street scene is to be looked at.
    assert set(table["experiment"].to_pylist()) == {*NAMES, "runtime"} - {"street"}
    lines = (out / "metrics.csv").read_text().splitlines()
    assert len(lines) == len(table) + 1
    assert lines[0].replace('"', "").startswith("experiment,method,array,metric,condition,value,low,high")
    pictures = {path.stem for path in (out / "figures").glob("*.png")}
    assert pictures >= {*NAMES, "detection-probability", "street-thin", "street-full"} - {"street"}
    for name in pictures:
        assert (out / f"figures/{name}.png").read_bytes()[:4] == b"\x89PNG"
        assert (out / f"figures/{name}.svg").read_bytes().startswith(b"<?xml")
    assert not list(out.rglob("*.partial"))


def test_each_contender_has_its_runtime_beside_every_number(evaluation):
    table = evaluation[0].to_pylist()
    # Of ml, the ceiling, and of the measured snapshot's arrays no image of the dataset is made.
    of_images = [row for row in table if row["method"] in ("das", "omp", "unet") and row["array"] in ("thin", "full")]
    assert all(row[SECONDS] > 0 for row in of_images)
    assert {(row["method"], row["array"]) for row in of_images} == {
        ("das", "thin"), ("das", "full"), ("omp", "thin"), ("omp", "full"), ("unet", "thin"),
    }  # fmt: skip


def test_the_truth_is_ranked_beside_the_methods_for_each_array(evaluation):
    rows = [row for row in evaluation[0].to_pylist() if row["metric"] in ("average precision", "detection probability")]
    detection = {(row["method"], row["array"], row["condition"]) for row in rows if row["experiment"] == "detection"}
    contenders = [("das", "thin"), ("das", "full"), ("omp", "thin"), ("omp", "full"), ("unet", "thin")]
    conditions = ["", *(f"false alarms={count} a frame" for count in (1, 10, 100))]
    assert detection == {
        (*one, condition) for one in [*contenders, ("truth", "thin"), ("truth", "full")] for condition in conditions
    }
    assert {row["condition"].split(",")[0] for row in rows if row["experiment"] == "generalisation"} == {
        "scene=hall", "scene=none",
    }  # fmt: skip
    truth = [row["value"] for row in rows if row["method"] == "truth"]
    assert truth
    assert all(value is None or value == 1.0 for value in truth)


def test_intervals_hold_their_values(evaluation):
    rows = [row for row in evaluation[0].to_pylist() if row["low"] is not None]
    assert len(rows) > 100
    for row in rows:
        assert row["low"] <= row["value"] + 1e-12, row
        assert row["value"] <= row["high"] + 1e-12, row


def test_a_killed_evaluation_goes_on_and_ends_in_the_same_numbers(inputs, evaluation, tmp_path):
    class Killed(Exception):
        pass

    def kill(name, done, total):
        if name == "detection" and done == 4:
            raise Killed

    out, chosen = tmp_path / "out", ["detection", "noise-only"]
    with pytest.raises(Killed):
        run_all(inputs, out, progress=kill, experiments=chosen, measured=None)
    assert not (out / "metrics.csv").exists()
    finished = {path: path.read_bytes() for path in (out / "cells").glob("*.npz")}
    (out / "cells/left-behind.partial").write_bytes(b"half a cell")
    lines: list[str] = []
    again = {"resume": True, "announce": lines.append, "experiments": chosen, "measured": None}
    assert deterministic(run_all(inputs, out, **again)) == [
        row for row in deterministic(evaluation[0]) if row["experiment"] in chosen
    ]
    assert f", {len(finished)} kept;" in lines[-1]
    assert all(path.read_bytes() == content for path, content in finished.items())
    assert not list(out.rglob("*.partial"))
    # Nothing is left to do, and all is written again as it was.
    files = {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}
    run_all(inputs, out, **again)
    assert lines[-1].startswith("0 cells computed")
    assert {path: path.read_bytes() for path in out.rglob("*") if path.is_file()} == files


def test_numbers_and_figures_do_not_depend_on_the_number_of_workers(inputs, evaluation, tmp_path):
    out, chosen = tmp_path / "out", ["two-reflectors", "detection", "noise-only", "measured"]
    steps = []
    table = run_all(inputs, out, experiments=chosen, workers=2, progress=lambda *step: steps.append(step))
    assert deterministic(table) == [row for row in deterministic(evaluation[0]) if row["experiment"] in chosen]
    for path in (out / "cells").glob("*.npz"):
        if not path.name.startswith("runtime"):
            assert path.read_bytes() == (evaluation[1] / "cells" / path.name).read_bytes()
    for name in ("detection.png", "detection.svg", "noise-only.png", "noise-only.svg"):
        assert (out / "figures" / name).read_bytes() == (evaluation[1] / "figures" / name).read_bytes()
    # Progress is that of single cells.
    done = [done for name, done, total in steps if name == "detection"]
    assert done == list(range(len(done)))
    assert len(done) > 10


def test_other_settings_are_computed_anew_and_what_is_left_is_said(inputs, tmp_path):
    out = tmp_path / "out"
    lines: list[str] = []
    chosen = {"methods": ["das"], "run": [], "experiments": ["noise-only"], "measured": None, "announce": lines.append}
    run_all(inputs, out, **chosen)
    run_all(inputs, out, **chosen, resume=True, seed=1)
    # Two frames and two arrays; the images of the report and the runtimes depend on no seed.
    assert lines[-1].startswith("4 cells computed")
    assert any(line.startswith("4 cells in") and "of other arguments" in line for line in lines)
    run_all(inputs, out, **chosen, resume=True, frames=1)
    assert "2 scene frames of the test split are left out: --frames 1" in lines


def test_a_damaged_cell_is_named(inputs, tmp_path):
    out = tmp_path / "out"
    chosen = {"methods": ["das"], "run": [], "experiments": ["noise-only"], "measured": None}
    run_all(inputs, out, **chosen)
    cell = sorted((out / "cells").glob("noise-only-*.npz"))[0]
    cell.write_bytes(cell.read_bytes()[:100])
    with pytest.raises(InputError, match=f"{cell.name}: damaged.*delete the file"):
        run_all(inputs, out, **chosen, resume=True)


def test_a_radar_that_does_not_see_so_far_leaves_experiments_out_and_says_so(tmp_path):
    data = make_data(tmp_path / "data", SHORT_RADAR)
    bench, _ = open_bench(data, EvaluationConfig(frames=3, methods=("das",), arrays=("full",)))
    chosen, lines = choose_experiments(None, bench, None)
    reason = "the radar sees to 3.4 m, the targets stand at 5.7 m"
    assert lines == [
        f"experiment point-spread is left out: {reason}", f"experiment two-reflectors is left out: {reason}",
        "experiment measured is left out: no --measured file",
    ]  # fmt: skip
    names = {experiment.name for experiment in chosen}
    assert names == EXPERIMENTS.keys() - {"point-spread", "two-reflectors"}
    with pytest.raises(InputError, match=f"point-spread: {reason}"):
        choose_experiments(["point-spread"], bench, None)


@pytest.mark.slow
def test_names_in_the_data_are_text_wherever_they_are_shown(inputs, tmp_path):
    """A scene named like markup, a formula, a command of the terminal; drawn in every figure that names a scene."""
    name = "<!--<script>$x^{$ \x1b[31m\u202e \u65e5\u672c"
    frames = [replace(frame(index, RADAR), kind="scene", scene=name) for index in range(4)]
    data = write_dataset(tmp_path / "$data$", {"train": frames[:2], "test": frames[2:]}, RADAR)
    array = tmp_path / "$a{$|.toml"
    array.write_text("rx = [0, 1, 2, 5]\n")
    out = tmp_path / "out"
    measured = shutil.copy(inputs[3], tmp_path / "$m{$.npy")
    arguments = [data, "--out", out, "--arrays", array, "--methods", "das", "--trials", "2", "--measured", measured]
    code, _, said = ended("trainer", "evaluate", *arguments, "--workers", "1")
    assert (code, said) == (0, "")
    # One figure an experiment, and a second one of detection; of a street one an array.
    expected = {*NAMES, "detection-probability", "street-$a{$|"} - {"street"}
    assert {path.stem for path in (out / "figures").glob("*.png")} == expected
    page = (out / "report.html").read_text()
    assert page.count("<script") == page.count("</script") == 4  # two shown frames
    assert "<!--" not in page
    assert "\x1b" not in page
    assert page.count("\n| ") == 0


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Bench:
    data = write_dataset(tmp_path_factory.mktemp("data") / "data", {"test": [frame(0, SHORT_RADAR)]}, SHORT_RADAR)
    return open_bench(data, EvaluationConfig(methods=("das",), arrays=("full",), seed=7))[0]


def results(pool: Workers, *work: str) -> Iterator[tuple[int, Values]]:
    experiment = Troubled(work, name="-".join(work))
    return pool.results(experiment, experiment.tasks(pool.bench), range(len(work)))


def test_cells_are_computed_elsewhere_and_no_worker_outlives_the_context(bench: Bench, tmp_path: Path) -> None:
    """One thread a worker, deaf to the terminal's Ctrl-C; an input error is one line; the next cells go on after it."""
    with Workers(bench, 2, tmp_path / "workers") as pool:
        found = dict(results(pool, "report", "gpu", "report", "report", "report"))
        assert sorted(found) == [0, 1, 2, 3, 4]
        # A GPU is one: what needs it stays here.
        assert [place for place, values in found.items() if values["pid"] == os.getpid()] == [1]
        for place in (0, 2, 3, 4):
            assert (found[place]["deaf"], found[place]["threads"], found[place]["seed"]) == (True, 1, 7)
        with pytest.raises(InputError, match=r"^part-00000\.parquet: row 3: damaged; expected a whole row$"):
            dict(results(pool, "report", "refuse"))
        assert list(dict(results(pool, "report"))) == [0]
        assert multiprocessing.active_children()
    assert not multiprocessing.active_children()
    assert not (tmp_path / "workers").exists()


def test_one_worker_is_this_process_with_one_thread(bench: Bench, tmp_path: Path) -> None:
    with Workers(bench, 1, tmp_path / "workers") as pool:
        ((_, values),) = results(pool, "report")
        assert not (tmp_path / "workers").exists()
    assert (values["pid"], values["threads"], values["deaf"]) == (os.getpid(), 1, False)


@pytest.mark.slow
def test_a_cell_that_three_workers_die_of_is_one_line_here(bench: Bench, tmp_path: Path) -> None:
    line = r"^report-die-report die place=1: three worker processes died of it, its process ended by SIGKILL.*--resume"
    with pytest.raises(Stopped, match=line), Workers(bench, 2, tmp_path / "workers") as pool:
        list(results(pool, "report", "die", "report"))
    assert not multiprocessing.active_children()
