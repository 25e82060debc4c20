"""``trainer evaluate``: columns, resume, determinism, workers."""

import pyarrow.parquet as pq
import pytest
from small_evaluation import run_all

from shared.physics.errors import InputError
from trainer.evaluation.evaluate import NAMES
from trainer.evaluation.report.tables import SECONDS


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
