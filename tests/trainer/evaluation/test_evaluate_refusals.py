"""What ``trainer evaluate`` refuses, in one line, and what it leaves out."""

import shutil
from dataclasses import replace

import pytest
from captured_cubes import other_radar, write_capture
from small_evaluation import QUICK, RADAR, make_data, make_run, status
from tiny_radar import RADAR as SHORT_RADAR
from tiny_radar import frame, write_dataset

from shared.physics.errors import InputError
from trainer.evaluation.evaluate import EXPERIMENTS, NAMES, choose_experiments, open_bench

REFUSALS = {
    "an unknown method": (["--methods", "das,best"], "--methods: 'best'; expected some of das"),
    "a method twice": (["--methods", "das,das"], "--methods: 'das' twice"),
    "a network without a run": (["--methods", "das,cnn"], "--methods: 'cnn' without a run of that kind"),
    "an unknown experiment": (["--experiments", "fig8"], "--experiments: 'fig8'; expected some of point-spread"),
    "an experiment that does not apply": (["--experiments", "measured"], "--experiments: measured: no --measured file"),
    "an array that is no subset": (["--arrays", "sparse6"], "--array: sparse6 uses RX 15; expected RX 0 to 5"),
    "an array that is not there": (["--arrays", "none.toml"], "--array: no named array and no file 'none.toml'"),
    "an array twice": (["--arrays", "full,full"], "--arrays: 'full' twice"),
    "no array": (["--arrays", ","], "--arrays: none; expected some of"),
    "no frames": (["--frames", "0"], "trainer evaluate: frames = 0; expected input should be greater than or equal"),
    "no run": (["--run", "nothing"], "nothing: no run.json; expected a run folder"),
    "a run of another array": (["--run", "RUN", "--arrays", "full"], "--run: RUN was trained for array 'thin'"),
    "a run of another radar": (["--run", "OTHER"], "DATA: radar 'tiny', waveform.samples = 64; expected 32"),
    "a run that no method stands for": (["--run", "RUN", "--methods", "das"], "--run: RUN is a 'unet', not among"),
    "a snapshot nobody asked for": (
        ["--measured", "PAIR", "--experiments", "detection"], "--measured: PAIR without the experiment",
    ),
    "a file for a folder": (["--out", "PAIR"], "--out: PAIR: File exists"),
}  # fmt: skip
ALONE = {
    "nothing to look at": ([], "arguments: neither a dataset nor --measured; expected one of both, or both"),
    "a range of a snapshot": (["PAIR", "--range", "3"], "--range: 3 m of a snapshot; expected no --range"),
    "no targets": (["PAIR", "--targets", "0"], "--targets: 0; expected 1 or more"),
    "too many targets": (["PAIR", "--targets", "6"], "--targets: 6 with 10 elements; expected at most 5"),
    "too large an error": (["PAIR", "--model-error", "3"], "model_error_db: 3.0; expected at most 0 dB"),
    "another experiment": (["PAIR", "--experiments", "detection"], "--experiments: detection; expected measured alone"),
    "no such estimator": (["PAIR", "--methods", "capon"], "--methods: 'capon'; expected some of das, "),
    "a run that is none": (["PAIR", "--run", "none"], "none: no run.json; expected a run folder"),
    "a file that is none": (["none.npz"], "--measured: none.npz; expected a .mat or .npy file"),
    "a range beyond": (["CUBE", "--range", "30"], "--range: 30 m; expected 0 to "),
}
"""Of a measured row without a dataset."""


@pytest.mark.parametrize("case", [*REFUSALS, *ALONE])
def test_a_user_s_error_is_one_line_and_status_2(inputs, tmp_path, capsys, monkeypatch, case):
    data, run, thin, measured = inputs
    monkeypatch.chdir(tmp_path)
    given, message = {**REFUSALS, **ALONE}[case]
    places = {"RUN": run, "OTHER": tmp_path / "other", "DATA": data, "PAIR": measured, "CUBE": tmp_path / "cube.npz"}
    if "OTHER" in given:
        make_run(tmp_path / "other", radar=SHORT_RADAR)
    if "CUBE" in given:
        write_capture(tmp_path / "cube.npz", other_radar())
    arguments = [str(places.get(word, word)) for word in given]
    if case in ALONE:
        arguments = ["--measured", *arguments] if arguments else []
    else:
        arguments = [data, *arguments, *([] if "--arrays" in given else ["--arrays", f"{thin},full"])]
    if "--out" not in given:
        arguments += ["--out", tmp_path / "out"]
    for word, place in places.items():
        message = message.replace(word, str(place))
    code, line = status(capsys, monkeypatch, *arguments)
    assert code == 2
    assert line.startswith(f"trainer: {message}"), line
    assert line.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_data_without_a_test_split_and_folders_in_use_are_refused(inputs, tmp_path, capsys, monkeypatch):
    data = write_dataset(tmp_path / "data", {"train": [frame(0, RADAR)]}, RADAR)
    code, line = status(capsys, monkeypatch, data, "--out", tmp_path / "out", "--arrays", "full")
    assert (code, line) == (2, f"trainer: {data}: no frames in split 'test'; expected one of ['train']\n")
    code, line = status(capsys, monkeypatch, tmp_path, "--out", tmp_path / "out")
    assert code == 2
    assert line.startswith(f"trainer: {tmp_path}/manifest.json: no such file")
    used = tmp_path / "used"
    used.mkdir()
    (used / "thesis.txt").write_text("mine")
    for more, problem in (([], "is not empty"), (["--resume"], "holds no cells/")):
        code, line = status(capsys, monkeypatch, inputs[0], "--out", used, "--arrays", "full", *more)
        assert code == 2
        assert line.startswith(f"trainer: --out: {used} {problem}")
    assert [path.name for path in used.iterdir()] == ["thesis.txt"]


def test_a_radar_that_does_not_see_so_far_leaves_experiments_out_and_says_so(tmp_path):
    data = make_data(tmp_path / "data", SHORT_RADAR)
    bench, _ = open_bench(data, QUICK.model_copy(update={"methods": ("das",), "arrays": ("full",)}))
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
def test_names_in_the_data_are_text_wherever_they_are_shown(inputs, tmp_path, capsys, monkeypatch):
    """A scene named like markup, a formula, a command of the terminal; drawn in every figure that names a scene."""
    name = "<!--<script>$x^{$ \x1b[31m\u202e \u65e5\u672c"
    frames = [replace(frame(index, RADAR), kind="scene", scene=name) for index in range(4)]
    data = write_dataset(tmp_path / "$data$", {"train": frames[:2], "test": frames[2:]}, RADAR)
    array = tmp_path / "$a{$|.toml"
    array.write_text("rx = [0, 1, 2, 5]\n")
    out = tmp_path / "out"
    measured = shutil.copy(inputs[3], tmp_path / "$m{$.npy")
    arguments = [data, "--out", out, "--arrays", array, "--methods", "das", "--trials", "2", "--measured", measured]
    assert status(capsys, monkeypatch, *arguments, "--workers", "1") == (0, "")
    # One figure an experiment, and a second one of detection; of a street one an array.
    expected = {*NAMES, "detection-probability", "street-$a{$|"} - {"street"}
    assert {path.stem for path in (out / "figures").glob("*.png")} == expected
    page = (out / "report.html").read_text()
    assert page.count("<script") == page.count("</script") == 4  # two shown frames
    assert "<!--" not in page
    assert "\x1b" not in page
    assert page.count("\n| ") == 0
