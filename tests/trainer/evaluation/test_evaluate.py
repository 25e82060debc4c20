"""``trainer evaluate``: columns, resume, determinism, scores of images whose score is known, and what is refused."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
import scipy.io
import torch
from tiny_radar import RADAR as SHORT_RADAR
from tiny_radar import TINY, frame, write_dataset

from shared.dataset import Target
from shared.dataset.folder import open_dataset
from shared.physics.errors import InputError
from shared.radar import load_radar
from shared.signal import if_signal
from shared.signal.spectrum import range_doppler
from shared.signal.windows import cell_noise_power
from trainer.cli import main
from trainer.data.arrays import ArrayChoice
from trainer.data.pairs import Condition, simulate
from trainer.data.simulation import in_plane, snapshot, truth_image
from trainer.estimators.das import DelayAndSum
from trainer.evaluation.evaluate import EXPERIMENTS, choose_experiments, evaluate, open_bench
from trainer.evaluation.experiments.bench import FrameRef, Settings
from trainer.evaluation.experiments.contenders import estimator_contender, gather
from trainer.evaluation.experiments.doppler import score_peaks
from trainer.evaluation.experiments.frames import one_of_each_scene, score_frame
from trainer.evaluation.experiments.measured import half_wavelength_line, read_snapshot, reference_degrees
from trainer.evaluation.experiments.robustness import Impairment, channel_factors, displaced
from trainer.evaluation.report.levels import from_bytes, scene_levels, to_bytes
from trainer.evaluation.report.tables import SECONDS
from trainer.metrics.resolution import strongest_peaks
from trainer.run.folder import Fingerprint, Run, save_weights, write_run
from trainer.run.imager import Imager

RADAR = SHORT_RADAR.model_copy(
    update={"waveform": SHORT_RADAR.waveform.model_copy(update={"samples": 64, "range_bins": 48})}
)
"""Sees to 7 m: the cylinders of the paper stand at 5.7 m."""
FULL = ArrayChoice(name="full", rx=tuple(range(6)))
THIN = ArrayChoice(name="thin", rx=(0, 1, 2, 5))
SETTINGS = Settings(frames=3, shown=2, trials=2)
REFERENCE = Path(__file__).resolve().parents[4] / "shared" / "data" / "measured" / "two_reflectors"


def make_data(directory, radar=RADAR):
    """Two training frames and four test frames, of which three are of a scene."""
    frames = [replace(frame(index, radar), kind="scene", scene="hall") for index in range(6)]
    frames[5] = replace(frames[5], kind="points", scene="none")
    return write_dataset(directory, {"train": frames[:2], "test": frames[2:]}, radar)


def make_run(directory, array=THIN, radar=RADAR, datasets=(), **changes):
    """A run with random weights: what is tested here does not depend on what they learned."""
    config = TINY.model_copy(update=changes)
    torch.manual_seed(0)
    directory.mkdir()
    write_run(directory, Run(config=config, radar=radar, array=array, datasets=datasets))
    save_weights(directory, Imager(config, radar, array))
    return directory


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    """(dataset, run, array file, measured snapshot)."""
    folder = tmp_path_factory.mktemp("inputs")
    data = make_data(folder / "data")
    fingerprint = Fingerprint.of(data, open_dataset(data).records, {})
    run = make_run(folder / "run", datasets=(fingerprint,))
    (folder / "thin.toml").write_text("rx = [0, 1, 2, 5]\n")
    generator = np.random.default_rng(5)
    line = half_wavelength_line(np.arange(40))
    noise = 0.03 * (generator.standard_normal((40, 2)) @ np.array([1.0, 1.0j]))
    np.save(folder / "pair.npy", line.manifold(np.sin(np.deg2rad([-4.0, 5.0]))) @ np.array([1.0, 0.8j]) + noise)
    return data, run, folder / "thin.toml", folder / "pair.npy"


def run_all(inputs, out, **changes):
    data, run, thin, measured = inputs
    arguments = {
        "runs": [run], "methods": ["das", "omp", "unet"], "arrays": [str(thin), "full"], "settings": SETTINGS,
        "measured": measured, "announce": lambda _: None,
    }  # fmt: skip
    return evaluate(data, out, **(arguments | changes))


@pytest.fixture(scope="module")
def evaluation(inputs, tmp_path_factory):
    out = tmp_path_factory.mktemp("evaluation") / "out"
    return run_all(inputs, out), out


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
    assert set(table["experiment"].to_pylist()) == {*EXPERIMENTS, "runtime"} - {"street"}
    lines = (out / "metrics.csv").read_text().splitlines()
    assert len(lines) == len(table) + 1
    assert lines[0].replace('"', "").startswith("experiment,method,array,metric,condition,value,low,high")
    for name in EXPERIMENTS:
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
    said = []
    again = {"resume": True, "announce": said.append, "experiments": chosen, "measured": None}
    assert deterministic(run_all(inputs, out, **again)) == [
        row for row in deterministic(evaluation[0]) if row["experiment"] in chosen
    ]
    assert f", {len(finished)} kept;" in said[-1]
    assert all(path.read_bytes() == content for path, content in finished.items())
    assert not list(out.rglob("*.partial"))
    # Nothing is left to do, and all is written again as it was.
    files = {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}
    run_all(inputs, out, **again)
    assert said[-1].startswith("0 cells computed")
    assert {path: path.read_bytes() for path in out.rglob("*") if path.is_file()} == files


def test_two_evaluations_make_the_same_figures(inputs, evaluation, tmp_path):
    out = tmp_path / "out"
    run_all(inputs, out, experiments=["detection", "noise-only"], measured=None)
    for name in ("detection.png", "detection.svg", "noise-only.png", "noise-only.svg"):
        assert (out / "figures" / name).read_bytes() == (evaluation[1] / "figures" / name).read_bytes()


def test_the_numbers_do_not_depend_on_the_number_of_workers(inputs, evaluation, tmp_path):
    out, chosen = tmp_path / "out", ["two-reflectors", "detection", "noise-only", "measured"]
    steps = []
    table = run_all(inputs, out, experiments=chosen, workers=2, progress=lambda *step: steps.append(step))
    assert deterministic(table) == [row for row in deterministic(evaluation[0]) if row["experiment"] in chosen]
    for path in (out / "cells").glob("*.npz"):
        if not path.name.startswith("runtime"):
            assert path.read_bytes() == (evaluation[1] / "cells" / path.name).read_bytes()
    # Progress is that of single cells.
    done = [done for name, done, total in steps if name == "detection"]
    assert done == list(range(len(done)))
    assert len(done) > 10


def test_other_settings_are_computed_anew_and_what_is_left_is_said(inputs, tmp_path):
    out, said = tmp_path / "out", []
    chosen = {"methods": ["das"], "runs": [], "experiments": ["noise-only"], "measured": None, "announce": said.append}
    run_all(inputs, out, **chosen)
    run_all(inputs, out, **chosen, resume=True, settings=SETTINGS.model_copy(update={"seed": 1}))
    # Two frames and two arrays; the images of the report and the runtimes depend on no seed.
    assert said[-1].startswith("4 cells computed")
    assert any(line.startswith("4 cells in") and "of other arguments" in line for line in said)
    run_all(inputs, out, **chosen, resume=True, settings=SETTINGS.model_copy(update={"frames": 1}))
    assert "2 scene frames of the test split are left out: --frames 1" in said


def test_a_damaged_cell_is_named(inputs, tmp_path):
    out = tmp_path / "out"
    chosen = {"methods": ["das"], "runs": [], "experiments": ["noise-only"], "measured": None}
    run_all(inputs, out, **chosen)
    cell = sorted((out / "cells").glob("noise-only-*.npz"))[0]
    cell.write_bytes(cell.read_bytes()[:100])
    with pytest.raises(InputError, match=f"{cell.name}: damaged.*delete the file"):
        run_all(inputs, out, **chosen, resume=True)


def known(image):
    """A contender that answers with this image."""
    return replace(estimator_contender("das", FULL, RADAR), imaging=lambda _snapshot, _noise: image)


def test_the_truth_scores_one_an_empty_image_nothing_and_noise_between():
    made = frame(3, RADAR)
    truth = made.image.astype(np.float64) * made.image_peak
    perfect = score_frame(RADAR, known(truth), lambda: made)
    tp, fp, fn = perfect["strict"][0]
    assert tp > 10
    assert (fp, fn) == (0, 0)
    assert perfect["nmse"] == perfect["scaled_nmse"] == 0.0
    assert perfect["ssim"] == 1.0
    assert perfect["psnr"] == np.inf
    assert not perfect["gospa"].any()
    empty = score_frame(RADAR, known(np.zeros_like(truth)), lambda: made)
    assert empty["strict"][0].tolist() == [0, 0, tp + fn]
    assert empty["nmse"] == empty["scaled_nmse"] == 1.0
    assert empty["gospa"][1] == 8.0 * (tp + fn)  # c^2 / 2 for each missed one
    noise = np.random.default_rng(0).rayleigh(truth.max(), truth.shape)
    white = score_frame(RADAR, known(noise), lambda: made)
    assert white["strict"][0][1] > fp
    assert 0.5 < white["scaled_nmse"] < 1.0
    assert white["ssim"] < 0.5


def test_an_empty_truth_has_no_image_errors_and_every_detection_is_false():
    made = replace(frame(3, RADAR), image=np.zeros((48, 20), np.float32))
    scores = score_frame(RADAR, estimator_contender("das", FULL, RADAR), lambda: made)
    assert np.isnan([scores[name] for name in ("nmse", "scaled_nmse", "psnr", "ssim")]).all()
    assert scores["strict"][0][0] == 0
    assert scores["strict"][0][1] > 0


def test_one_chirp_stands_for_the_frame_of_resting_targets():
    radar = load_radar("avr-qdm-110")
    radar = radar.model_copy(update={"waveform": radar.waveform.model_copy(update={"chirps": 8, "samples": 128,
                                                                                   "range_bins": 64})})  # fmt: skip
    positions = in_plane(np.array([3.03, 7.1]), np.array([0.2, -0.4]))
    amplitudes = np.array([1.0, 0.3j])
    cube = if_signal(radar, positions, np.zeros((2, 3)), amplitudes)
    expected = range_doppler(cube.astype(np.complex64), radar)[:, radar.waveform.chirps // 2]
    np.testing.assert_allclose(snapshot(radar, positions, amplitudes, None), expected, atol=2e-6)
    noise = snapshot(radar, positions[:0], amplitudes[:0], np.random.default_rng(1))
    # 64 x 48 cells, of which the range window leaves two thirds independent: a standard error of 2.2 %.
    assert np.mean(np.abs(noise) ** 2) == pytest.approx(cell_noise_power(radar), rel=0.09)


def test_a_simulated_target_reads_its_amplitude_in_the_truth():
    row, column = 40, 12
    position = in_plane(np.array([row * RADAR.waveform.range_step_m]), np.array([RADAR.grid.u[column]]))
    truth = truth_image(RADAR, position, np.array([2e-6 + 0j]))
    assert np.unravel_index(truth.argmax(), truth.shape) == (row, column)
    assert truth.max() == pytest.approx(2e-6, rel=0.02)


def test_trials_have_the_separation_the_ratio_and_the_noise_that_they_say():
    condition = Condition(separation_cells=2.0, snr_db=200.0, ratio_db=6.0)
    trials = simulate(RADAR, condition, 5, [0])
    images, rows, channels = trials.snapshots.shape
    assert (rows, channels) == (48, 6)
    assert len(trials.u) == images * len(trials.rows) >= 5
    line = estimator_contender("das", FULL, RADAR).line
    np.testing.assert_allclose(np.diff(trials.u, axis=1), 2.0 * line.resolution)
    flat = trials.snapshots[:, trials.rows].reshape(len(trials.u), -1)
    for x, u, phase in zip(flat, trials.u, trials.phase_rad, strict=True):
        amplitude = np.linalg.lstsq(line.manifold(u), x, rcond=None)[0]
        ratio_db = 20.0 * np.log10(np.abs(amplitude))
        assert abs(ratio_db[1] - ratio_db[0]) == pytest.approx(6.0, abs=0.3)
        middle = 0.5 * (line.positions_m.min() + line.positions_m.max())
        turned = amplitude * np.exp(-2j * np.pi / line.wavelength_m * middle * u)
        assert np.angle(turned[1] / turned[0] * np.exp(-1j * phase)) == pytest.approx(0.0, abs=0.1)


def test_impairments_do_what_they_say():
    generator = np.random.default_rng(2)
    array = load_radar("avr-qdm-110").array
    sparse = ArrayChoice(name="sparse4", rx=(0, 1, 10, 15))
    assert np.all(channel_factors(Impairment("SNR", 20.0), array, sparse, generator) == 1.0)
    dead = channel_factors(Impairment("dead RX", 2.0), array, sparse, generator)
    assert np.count_nonzero(dead == 0) == 2 * 3
    assert set(array.channel_rx[dead == 0]) < set(sparse.rx)
    phases = np.stack([channel_factors(Impairment("phase error", 10.0), array, sparse, generator) for _ in range(50)])
    assert np.allclose(np.abs(phases), 1.0)
    assert np.rad2deg(np.angle(phases)).std() == pytest.approx(10.0, rel=0.07)
    gains = np.stack([channel_factors(Impairment("gain error", 2.0), array, sparse, generator) for _ in range(50)])
    assert (20.0 * np.log10(np.abs(gains))).std() == pytest.approx(2.0, rel=0.07)
    moved = displaced(array, 0.5, generator)
    difference = moved.rx - array.rx
    assert not difference[:, [0, 2]].any()
    assert 0.2e-3 < difference[:, 1].std() < 0.9e-3
    assert displaced(array, 0.0, generator) == array


def test_what_moves_is_found_in_its_own_doppler_cell_only():
    """The second peak holds a target at 1 m/s that the first, at 0, does not."""
    made = frame(3, RADAR)
    row, column = 12, 5
    images = np.full((3, 48, 20), 1e-9)
    images[1, row, column] = 1.0
    calls = iter(images)
    contender = replace(known(None), imaging=lambda _snapshot, _noise: next(calls))
    mover = Target(row * RADAR.waveform.range_step_m, float(RADAR.grid.u[column]), 1.0, -100.0, "truck")
    wide = RADAR.model_copy(update={"waveform": RADAR.waveform.model_copy(update={"chirps": 512})})
    found = score_peaks(wide, contender, replace(made, targets=(mover,)), keep=False)["found"]
    assert found.tolist() == [[0, 0, 0], [1, 0, 1]]


def test_levels_keep_their_scale_as_bytes():
    image = np.outer(np.arange(1.0, 30.0), np.ones(4))
    levels = scene_levels(image, "sqrt(W)", 10.0 * image)
    assert levels.max() == pytest.approx(-20.0)
    assert np.abs(from_bytes(to_bytes(levels)) - levels).max() <= 0.5 * 60.0 / 255 + 1e-9
    assert scene_levels(image, "relative to the image's peak", 10.0 * image).max() == 0.0


def test_frames_shown_are_of_all_scenes_first():
    refs = [FrameRef(Path("p"), row, row, "scene", scene) for row, scene in enumerate("aaabbc")]
    assert [ref.frame_id for ref in one_of_each_scene(refs, 4)] == [0, 3, 5, 1]


def test_the_table_says_on_what_a_network_was_trained(inputs, evaluation, tmp_path):
    def words(table):
        rows = [row for row in table.to_pylist() if row["experiment"] == "generalisation"]
        return {(row["method"], row["condition"].split(",d_max")[0]) for row in rows}

    assert {
        ("unet", "scene=hall,trained on it=yes"), ("unet", "scene=none,trained on it=no"),
        ("das", "scene=hall,trained on it=nothing"),
    } <= words(evaluation[0])  # fmt: skip
    other = make_run(tmp_path / "other", datasets=(Fingerprint(name="else", sha256="0" * 64, frames={}),))
    chosen = {"runs": [other], "methods": ["unet"], "experiments": ["generalisation"], "measured": None}
    assert ("unet", "scene=hall,trained on it=unknown") in words(run_all(inputs, tmp_path / "out", **chosen))


def test_a_network_of_angles_takes_rows_alone_and_was_trained_on_no_scene(tmp_path):
    array = RADAR.array.model_copy(update={"tx_m": ((0.0, 0.0, 0.0), (0.0, 0.024, 0.0))})
    radar = RADAR.model_copy(update={"array": array})
    changes = {"model": "doa-cnn", "features": "covariance", "target": "doa"}
    seen = (Fingerprint(name="data", sha256="0" * 64, frames={}),)
    run = make_run(tmp_path / "run", FULL, radar, seen, **changes)
    (cnn,) = gather(["cnn"], [run], [FULL], radar, tmp_path)
    assert (cnn.name, cnn.unit, cnn.trained_on) == ("cnn full", "probability of a target", ())
    generator = np.random.default_rng(1)
    snapshots = (generator.standard_normal((48, 12, 2)) @ np.array([1.0, 1.0j])).astype(np.complex64)
    image = cnn.image(snapshots, 1e-3)
    assert image.shape == (48, 20)
    assert 0.0 < image.min() < image.max() < 1.0
    rows = np.array([4, 40])
    np.testing.assert_allclose(cnn.image_rows(snapshots, 1e-3, rows), image[rows], rtol=1e-5)


def test_contenders_stand_in_the_order_of_methods_and_arrays_whatever_that_of_the_runs(tmp_path):
    doa = {"model": "doa-cnn", "features": "covariance", "target": "doa"}
    runs = [make_run(tmp_path / "c", THIN), make_run(tmp_path / "b", FULL, **doa), make_run(tmp_path / "a", FULL)]
    names = [contender.name for contender in gather(["cnn", "das", "unet"], runs, [FULL, THIN], RADAR, tmp_path)]
    assert names == ["das full", "das thin", "cnn full", "unet full", "unet thin"]


def test_a_measured_pair_is_found_where_it_stands(evaluation):
    rows = {
        (row["method"], row["array"], row["metric"]): row["value"]
        for row in evaluation[0].to_pylist()
        if row["experiment"] == "measured"
    }
    assert rows["ml", "reference", "angle 1 [deg]"] == pytest.approx(-4.0, abs=0.1)
    assert rows["ml", "reference", "angle 2 [deg]"] == pytest.approx(5.0, abs=0.1)
    assert rows["iaa", "all 40", "both within 1 deg"] == 1.0
    assert ("das", "thin of 8", "angle 1 [deg]") in rows


@pytest.mark.skipif(not REFERENCE.is_dir(), reason="the reference data's measured snapshot is not beside the checkout")
def test_the_real_snapshot_shows_what_is_known_of_it():
    """Numbers of the README beside the file: two-source ML -0.006 and 6.985 degrees on all 86 elements."""
    measured = read_snapshot(REFERENCE / "realData_demo.mat")
    assert len(measured) == 86
    np.testing.assert_allclose(reference_degrees(measured), [-0.006, 6.985], atol=2e-3)
    axis = np.sin(np.deg2rad(np.arange(-20.0, 20.0, 0.02)))
    line = half_wavelength_line(np.arange(48))
    image = DelayAndSum().image(measured[None, :48], line, axis, 0.0)
    np.testing.assert_allclose(np.rad2deg(np.arcsin(strongest_peaks(image, axis, 2)[0])), [-0.08, 7.00], atol=0.03)


@pytest.mark.skipif(not REFERENCE.is_dir(), reason="the reference data's measured snapshot is not beside the checkout")
def test_the_experiment_on_the_real_snapshot_has_the_stated_angles(inputs):
    """10 elements, smoothed MUSIC of two targets: -0.16 and 6.68 degrees; every method on all 86: the reference."""
    bench, _ = open_bench(inputs[0], [], ["das"], ["full"], SETTINGS, REFERENCE / "realData_demo.mat")
    tasks = EXPERIMENTS["measured"].tasks(bench)
    results = {task.key: task.compute() for task in tasks if task.array in ("first 10", "all 86")}
    angles = {
        (row.method, row.array, row.metric): row.value for row in EXPERIMENTS["measured"].rows(bench, results)
    }  # fmt: skip
    for metric, ten, reference in (("angle 1 [deg]", -0.16, -0.006), ("angle 2 [deg]", 6.68, 6.985)):
        assert angles["music-fbss", "first 10", metric] == pytest.approx(ten, abs=0.02)
        for method in {task.method for task in tasks}:
            # A line stands in a bin of 0.03 degrees; the grid of omp and the widest main lobes are no finer than this.
            assert angles[method, "all 86", metric] == pytest.approx(reference, abs=0.08), method


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.npy", np.ones(40), "complex vectors"),
        ("a.npy", np.ones((3, 3), complex), "complex vectors"),
        ("a.npy", np.ones(4, complex), "4 elements; expected more than 4"),
        ("a.npy", np.full(40, np.nan + 0j), "40 elements; expected more than 4 finite"),
        ("a.npy", b"no array", "not readable"),
        ("a.mat", {"x": np.ones(40, complex), "y": np.ones(40, complex)}, "complex vectors"),
        ("a.mat", b"MATLAB 7.3 MAT-file, which is HDF5" + bytes(200), "not readable"),
        ("a.txt", b"1+2j", "a .mat or .npy file"),
    ],
)
def test_a_snapshot_that_is_none_is_refused(tmp_path, name, content, message):
    path = tmp_path / name
    if isinstance(content, bytes):
        path.write_bytes(content)
    elif isinstance(content, dict):
        scipy.io.savemat(path, content)
    else:
        np.save(path, content)
    with pytest.raises(InputError, match=message):
        read_snapshot(path)


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


@pytest.mark.parametrize("case", REFUSALS)
def test_a_user_s_error_is_one_line_and_status_2(inputs, tmp_path, capsys, monkeypatch, case):
    data, run, thin, measured = inputs
    given, message = REFUSALS[case]
    if "OTHER" in given:
        make_run(tmp_path / "other", radar=SHORT_RADAR)
    places = {"RUN": run, "OTHER": tmp_path / "other", "DATA": data, "PAIR": measured}
    arguments = [str(places.get(word, word)) for word in given]
    if "--arrays" not in given:
        arguments += ["--arrays", f"{thin},full"]
    if "--out" not in given:
        arguments += ["--out", str(tmp_path / "out")]
    for word, place in places.items():
        message = message.replace(word, str(place))
    code, line = status(capsys, monkeypatch, data, *arguments)
    assert code == 2
    assert line.startswith(f"trainer: {message}"), line
    assert line.count("\n") == 1


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


def status(capsys, monkeypatch, *arguments):
    """(exit status, standard error) of the command."""
    monkeypatch.setattr("sys.argv", ["trainer", "evaluate", *map(str, arguments)])
    with pytest.raises(SystemExit) as caught:
        main()
    return caught.value.code, capsys.readouterr().err


def test_a_radar_that_does_not_see_so_far_leaves_experiments_out_and_says_so(tmp_path):
    data = make_data(tmp_path / "data", SHORT_RADAR)
    bench, _ = open_bench(data, [], ["das"], ["full"], SETTINGS, None)
    chosen, lines = choose_experiments(None, bench)
    reason = "the radar sees to 3.4 m, the targets stand at 5.7 m"
    assert lines == [
        f"experiment point-spread is left out: {reason}", f"experiment two-reflectors is left out: {reason}",
        "experiment measured is left out: no --measured file",
    ]  # fmt: skip
    names = {experiment.name for experiment in chosen}
    assert names == EXPERIMENTS.keys() - {"point-spread", "two-reflectors", "measured"}
    with pytest.raises(InputError, match=f"point-spread: {reason}"):
        choose_experiments(["point-spread"], bench)


def test_two_networks_of_one_kind_are_told_apart(inputs, tmp_path):
    runs = [make_run(tmp_path / name) for name in ("wide", "deep")]
    table = run_all(
        inputs, tmp_path / "out", runs=runs, methods=["unet"], experiments=["tradeoff"], measured=None,
    )  # fmt: skip
    assert set(table["method"].to_pylist()) == {"unet:wide", "unet:deep"}
    copy = tmp_path / "else" / "wide"
    copy.parent.mkdir()
    with pytest.raises(InputError, match="two runs are named 'unet:wide thin'"):
        run_all(inputs, tmp_path / "no", runs=[runs[0], make_run(copy)], methods=["unet"], measured=None)
