"""A measured row: a snapshot, a cube, the real pair of reflectors and its twin; what is read, and what is refused."""

from dataclasses import replace
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
import scipy.io
from captured_cubes import other_radar, write_capture, write_plain_cube
from command_line import ended
from numpy.typing import NDArray
from oracles import reference_file
from small_evaluation import QUICK
from tiny_radar import RADAR
from tiny_run import make_run

from shared.physics.errors import InputError
from shared.radar.arrays import AntennaArray, line
from trainer import evaluate
from trainer.estimators.baselines import DelayAndSum, Music
from trainer.estimators.ml import MaximumLikelihood
from trainer.evaluation.experiments.bench import Bench
from trainer.evaluation.experiments.measured import Measured
from trainer.evaluation.experiments.measured_input import (
    MeasuredInput,
    half_wavelength_line,
    read_measured,
    read_snapshot,
)
from trainer.evaluation.options import EvaluationConfig
from trainer.evaluation.report.tables import Numbers
from trainer.metrics.peaks import strongest_peaks


def test_a_measured_pair_is_found_where_it_stands(evaluation):
    rows = {
        (row["method"], row["array"], row["metric"]): row["value"]
        for row in evaluation[0].to_pylist()
        if row["experiment"] == "measured"
    }
    assert rows["ml", "reference", "angle 1 [deg]"] == pytest.approx(-4.0, abs=0.1)
    assert rows["ml", "reference", "angle 2 [deg]"] == pytest.approx(5.0, abs=0.1)
    assert rows["omp", "all 40", "both within 1 deg"] == 1.0
    assert {method for method, _, _ in rows} == {"ml", "das", "omp", "unet"}  # those asked for, and the ceiling
    assert ("das", "thin of 8", "angle 1 [deg]") in rows


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.npy", np.ones(40), "complex vectors"),
        ("a.npy", np.ones((3, 3), complex), "complex vectors"),
        ("a.npy", np.ones(4, complex), "4 elements; expected more than 4"),
        ("a.npy", np.full(40, np.nan + 0j), "40 elements; expected more than 4 finite"),
        ("a.npy", np.zeros(40, complex), "all elements are 0; expected a snapshot with an echo"),
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


TWINS = 300


def values(out):
    """Of the metrics table, by (method, array, metric)."""
    rows = pq.read_table(out / "metrics.parquet").to_pylist()
    return {(row["method"], row["array"], row["metric"]): row["value"] for row in rows}


def test_a_snapshot_needs_no_dataset(inputs, tmp_path):
    out = tmp_path / "out"
    given = ["--measured", inputs[3], "--targets", "2", "--methods", "das,iaa,likes,ml,line-fit", "--workers", "1"]
    code, _, said = ended("trainer", "evaluate", *given, "--out", out)
    assert (code, said) == (0, "")
    found = values(out)
    for method in ("likes", "ml", "line-fit"):
        assert found[method, "all 40", "angle 1 [deg]"] == pytest.approx(-4.0, abs=0.15)
        assert found[method, "all 40", "angle 2 [deg]"] == pytest.approx(5.0, abs=0.15)
        # Noise of 0.0018 beside 1.64 in 40 elements, of which two lines take 3 / 40; within three deviations.
        assert found[method, "all 40", "power left [dB]"] == pytest.approx(-29.9, abs=2.1)
        assert found[method, "all 40", "both within 1 deg"] == 1.0
    assert found["iaa", "all 40", "both within 1 deg"] == 1.0
    assert ("likes", "first 10", "angle 1 [deg]") in found
    assert ("das", "sparse4 of 48", "angle 1 [deg]") not in found  # the snapshot ends before
    lines = (out / "lines.md").read_text()
    angles = [found["ml", "reference", f"angle {n} [deg]"] for n in (1, 2)]
    assert f"2 told (maximum likelihood of as many on all elements: {angles[0]:.3f}, {angles[1]:.3f} deg)" in lines
    listed = ", ".join(
        f"{found['likes', 'all 40', f'angle {n} [deg]']:.2f} ({found['likes', 'all 40', f'level {n} [dB]']:.1f})"
        for n in (1, 2)
    )
    assert f"| likes | {listed} | {found['likes', 'all 40', 'power left [dB]']:.1f} |" in lines
    assert (out / "figures/measured.png").read_bytes()[:4] == b"\x89PNG"
    assert (out / "report.html").is_file()
    assert not (out / "summary.md").exists()


def test_nobody_needs_to_know_how_many_there_are(inputs, tmp_path):
    said: list[str] = []
    evaluate(None, out=tmp_path / "out", **QUICK, methods=["likes", "das"], measured=inputs[3], announce=said.append)
    found = values(tmp_path / "out")
    metrics = {metric for method, array, metric in found if (method, array) == ("likes", "all 40")}
    assert metrics == {
        "angle 1 [deg]", "angle 2 [deg]", "level 1 [dB]", "level 2 [dB]", "power left [dB]",
    }  # fmt: skip
    assert found["likes", "all 40", "angle 1 [deg]"] == pytest.approx(-4.0, abs=0.15)  # the strongest first
    assert not any(method == "ml" for method, *_ in found)


def test_a_cube_is_cut_at_a_range_and_seen_from_above(tmp_path):
    radar = other_radar()
    places = [(1.5, 0.3, 0.0), (2.4, -0.6, 0.0)]
    cube = write_capture(tmp_path / "cube.npz", radar, places, model_error_db=-20.0, dead_channels=(2,))
    run, out = make_run(tmp_path / "run"), tmp_path / "out"
    (tmp_path / "few.toml").write_text("rx = [0, 1, 3, 4]\n")
    given: dict[str, Any] = {
        "measured": cube,
        "methods": ["das", "likes"],
        "arrays": ["full", str(tmp_path / "few.toml"), "sparse6"],
    }
    said: list[str] = []
    evaluate(None, out=out, **QUICK, run=[run], announce=said.append, **given)
    assert any("sparse6 uses RX 15" in line for line in said)
    found = values(out)
    assert {(method, array) for method, array, _ in found} == {
        ("das", "full"), ("likes", "full"), ("das", "few"), ("likes", "few"), ("unet", "mine"),
    }  # fmt: skip
    # The farther one: amplitudes are weighted by range, as in the pictures. Near the array the wave is curved.
    strongest = np.rad2deg(np.arctan2(-0.6, 2.4))
    assert found["likes", "full", "angle 1 [deg]"] == pytest.approx(strongest, abs=1.5)
    for name in ("measured", "measured-picture"):
        assert (out / f"figures/{name}.png").read_bytes()[:4] == b"\x89PNG"
    evaluate(None, out=tmp_path / "near", **QUICK, range_m=np.hypot(1.5, 0.3), announce=said.append, **given)
    nearer = values(tmp_path / "near")["likes", "full", "angle 1 [deg]"]
    assert nearer == pytest.approx(np.rad2deg(np.arctan2(0.3, 1.5)), abs=1.5)
    dead = make_run(tmp_path / "other")
    cube = write_capture(tmp_path / "dead.npz", radar, places, dead_channels=(1,))
    evaluate(None, out=tmp_path / "no-run", **QUICK, run=[dead], announce=said.append, **(given | {"measured": cube}))
    assert any("a channel of 'mine' is dead or off the line" in line for line in said)


@pytest.fixture(scope="module")
def reflectors() -> MeasuredInput:
    return read_measured(reference_file("measured", "two_reflectors", "realData_demo.mat"), targets=2)


def test_the_real_reflectors_have_their_stated_angles(reflectors, tmp_path):
    """By the command of docs/measured.md; the numbers are those of the README beside the file."""
    given: dict[str, Any] = {"methods": ["das", "likes", "omp-cfar", "ml", "music-fbss", "line-fit"], "arrays": []}
    evaluate(None, out=tmp_path / "out", **QUICK, measured=reflectors.path, targets=2, **given)
    found = values(tmp_path / "out")
    stated = {
        ("ml", "reference"): ([-0.006, 6.985], 0.002), ("das", "first 48"): ([-0.08, 7.00], 0.02),
        ("music-fbss", "first 10"): ([-0.16, 6.68], 0.02),
    }  # fmt: skip
    for one, (angles, within) in stated.items():
        seen = [found[(*one, f"angle {n} [deg]")] for n in (1, 2)]
        np.testing.assert_allclose(seen, angles, atol=within)
    # One peak; what is next is a sidelobe.
    levels = [found["das", "first 10", f"level {n} [dB]"] for n in (1, 2)]
    assert found["das", "first 10", f"angle {1 + int(np.argmax(levels))} [deg]"] == pytest.approx(3.3, abs=0.05)
    assert min(levels) < -13.0
    for method in ("likes", "omp-cfar", "ml", "line-fit"):
        assert found[method, "first 10", "both within 1 deg"] == 1.0


def test_every_method_on_all_of_the_real_snapshot_has_the_stated_angles(reflectors):
    assert len(reflectors.snapshot) == 86
    chosen = replace(reflectors, elements={"all 86": reflectors.elements["all 86"]})
    no_data = Bench("", RADAR, (), frozenset(), (), EvaluationConfig())
    found = Numbers("measured", 0)
    Measured(chosen).count(no_data, {}, found)
    angles = {(row.method, row.array, row.metric): row.value for row in found.rows}
    for metric, reference in (("angle 1 [deg]", -0.006), ("angle 2 [deg]", 6.985)):
        for method in {method for method, array, _ in angles if array == "all 86"}:
            # A line stands in a bin of 0.03 degrees; the grid of omp and the widest main lobes are no finer than this.
            assert angles[method, "all 86", metric] == pytest.approx(reference, abs=0.08), method


@pytest.mark.parametrize("name", ["sparse6", "sparse4"])
def test_a_shipped_network_resolves_the_real_reflectors(reflectors, tmp_path, name):
    """It was trained on simulated cities alone, for an array 3 % wider; its elements are 18 and 12 of the 86."""

    given: dict[str, Any] = {"methods": ["das"], "arrays": [], "targets": 2}
    evaluate(None, out=tmp_path / "out", **QUICK, pretrained=[name], measured=reflectors.path, **given)
    found = values(tmp_path / "out")
    assert {method for method, _, _ in found} == {"das", "ml", "unet"}
    np.testing.assert_allclose([found["unet", name, f"angle {n} [deg]"] for n in (1, 2)], [0.0, 7.0], atol=0.2)


def stated_numbers(rows: NDArray[np.complex128]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """([R, 3] delay-and-sum angles of 48 and 10 elements [deg], [R, U] delay-and-sum magnitude of 48)."""
    u = np.sin(np.deg2rad(np.arange(-20.0, 20.0, 0.02)))
    many, few = half_wavelength_line(np.arange(48)), half_wavelength_line(np.arange(10))
    image = DelayAndSum().image(rows[:, :48], many, u, 0.0)
    one = DelayAndSum().image(rows[:, :10], few, u, 0.0)
    peaks = np.concatenate([strongest_peaks(image, u, 2), strongest_peaks(one, u, 1)], axis=1)
    return np.rad2deg(np.arcsin(peaks)), image


def twins_of(measured: MeasuredInput, change_db: float = 0.0) -> NDArray[np.complex128]:
    """[TWINS, C] the same angles and amplitudes through channels whose gain and phase errors leave as much power.

    The measured noise, some 60 dB below, adds nothing to what calibration leaves.
    """
    line = measured.line(np.arange(len(measured.snapshot)))
    u, amplitude = MaximumLikelihood(2).locate(measured.snapshot[None], line)
    clean = line.manifold(u[0]) @ amplitude[0]
    left = np.sum(np.abs(measured.snapshot - clean) ** 2) / np.sum(np.abs(clean) ** 2)
    deviation = np.sqrt(0.5 * left * 10.0 ** (change_db / 10.0))
    gain, phase = deviation * np.random.default_rng(0).standard_normal((2, TWINS, len(clean)))
    return np.asarray(clean * (1.0 + gain) * np.exp(1j * phase))


def test_the_twin_gives_the_measured_image_within_what_its_calibration_allows(reflectors):
    angles, image = stated_numbers(reflectors.snapshot[None])
    of_twins, images = stated_numbers(twins_of(reflectors))
    assert np.abs((angles[0] - of_twins.mean(axis=0)) / of_twins.std(axis=0)).max() < 3.0
    # Some twenty resolution cells: 3.9 deviations are left in one image of 500.
    assert np.abs((image[0] - images.mean(axis=0)) / images.std(axis=0)).max() < 3.9
    smoothed = Music("forward-backward", targets=2)
    u = np.sin(np.deg2rad(np.arange(-10.0, 15.0, 0.02)))
    few = half_wavelength_line(np.arange(10))
    pair = strongest_peaks(smoothed.image(twins_of(reflectors)[:, :10], few, u, 0.0), u, 2)
    low, high = np.nanpercentile(np.rad2deg(np.arcsin(pair)), [0.5, 99.5], axis=0)
    assert (low < [-0.16, 6.68]).all()
    assert (high > [-0.16, 6.68]).all()


def test_a_twin_calibrated_better_would_not(reflectors):
    _, image = stated_numbers(reflectors.snapshot[None])
    _, images = stated_numbers(twins_of(reflectors, change_db=-10.0))
    assert np.abs((image[0] - images.mean(axis=0)) / images.std(axis=0)).max() > 3.9


def test_the_first_frame_that_is_not_empty_is_taken_and_told(tmp_path):
    radar, said = other_radar(), list[str]()
    with np.load(write_capture(tmp_path / "one.npz", radar, [(1.5, 0.3, 0.0)])) as stored:
        echo = stored["cube"]
    cube = write_plain_cube(tmp_path / "drive.npz", np.stack([0.0 * echo, echo, echo]), radar)
    evaluate(None, out=tmp_path / "out", **QUICK, measured=cube, methods=["das"], announce=said.append)
    angle = values(tmp_path / "out")["das", "full", "angle 1 [deg]"]
    assert angle == pytest.approx(np.rad2deg(np.arctan2(0.3, 1.5)), abs=1.5)
    place = f"frame 1, range {read_measured(cube).row * radar.waveform.range_step_m:.2f} m"
    assert f"{cube}: {place} is looked at; other frames are not" in said
    assert (tmp_path / "out/lines.md").read_text().startswith(f"Measured row, {place}, ")
    empty = write_plain_cube(tmp_path / "empty.npz", np.stack([0.0 * echo] * 2), radar)
    code, _, error = ended("trainer", "evaluate", "--measured", empty, "--out", tmp_path / "none")
    assert (code, error) == (2, f"trainer: {empty}: all samples are 0; expected a frame with an echo\n")
    assert not (tmp_path / "none").exists()


def test_channels_that_coincide_are_one_element(tmp_path):
    """Three TX two steps apart and four RX one step apart: 12 channels at 8 places, on which smoothing is possible."""
    half = 0.5 * RADAR.waveform.wavelength_m
    array = AntennaArray(tx_m=line(half * np.array([0.0, 2.0, 4.0])), rx_m=line(half * np.arange(4.0)))
    radar = RADAR.model_copy(update={"array": array})
    place = (2.4, -0.6, 0.0)
    cube = write_capture(tmp_path / "cube.npz", radar, [place], dead_channels=(0, 3))
    found = read_measured(cube, targets=1)
    # Channel = 3 rx + tx: 0 is alone at the first place and dead, 3 at the second.
    assert found.element.tolist() == [-1, 0, 2, -1, 1, 3, 0, 2, 4, 1, 3, 5]
    assert len(found.snapshot) == 6
    assert found.frame is not None
    expected = found.frame.cells.range_channel[0][found.row][[1, 6]].mean()
    assert found.snapshot[0] == pytest.approx(complex(expected), rel=1e-5)
    evaluate(None, out=tmp_path / "out", **QUICK, measured=cube, targets=1, methods=["music-fbss"])
    angle = values(tmp_path / "out")["music-fbss", "full", "angle 1 [deg]"]
    assert angle == pytest.approx(np.rad2deg(np.arctan2(-0.6, 2.4)), abs=1.5)
