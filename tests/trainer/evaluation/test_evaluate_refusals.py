"""What ``trainer evaluate`` leaves out, and names that are no plain text.

Its other refusals stand in ``tests/trainer/cli/test_refusals.py``.
"""

import shutil
from dataclasses import replace

import pytest
from command_line import ended
from small_evaluation import RADAR, make_data
from tiny_radar import RADAR as SHORT_RADAR
from tiny_radar import frame, write_dataset

from shared.physics.errors import InputError
from trainer.evaluation.evaluate import EXPERIMENTS, NAMES, choose_experiments, open_bench
from trainer.evaluation.options import EvaluationConfig


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
