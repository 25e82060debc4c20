"""Who is compared, in which order, and on what it was trained."""

from dataclasses import replace

import numpy as np
import pytest
from small_evaluation import FULL, RADAR, THIN, make_run, run_all

from shared.physics.errors import InputError
from shared.signal.windows import cell_noise_power
from trainer.evaluation.experiments.bench import Bench
from trainer.evaluation.experiments.contenders import estimator_contender, gather
from trainer.evaluation.experiments.generalisation import trained_on
from trainer.evaluation.experiments.noise_only import NoiseOnly
from trainer.evaluation.options import EvaluationConfig
from trainer.metrics.peaks import noise_level
from trainer.metrics.residual import of_one_cell
from trainer.run.folder import Fingerprint, SceneRecord, Start, read_run, write_run

TWO_TX = RADAR.model_copy(
    update={"array": RADAR.array.model_copy(update={"tx_m": ((0.0, 0.0, 0.0), (0.0, 0.024, 0.0))})}
)
"""Twelve channels: what the network of angles needs at least is nine."""
DOA = {"model": "doa-cnn", "features": "covariance", "target": "doa"}


def test_the_table_says_on_what_a_network_was_trained(inputs, evaluation, tmp_path):
    def words(table):
        rows = [row for row in table.to_pylist() if row["experiment"] == "generalisation"]
        return {(row["method"], row["condition"].split(",d_max")[0]) for row in rows}

    assert {
        ("unet", "scene=hall,trained on it=yes"), ("unet", "scene=none,trained on it=no"),
        ("das", "scene=hall,trained on it=nothing"),
    } <= words(evaluation[0])  # fmt: skip
    other = make_run(tmp_path / "other", datasets=(Fingerprint(name="else", sha256="0" * 64, frames={}),))
    chosen = {"run": [other], "methods": ["unet"], "experiments": ["generalisation"], "measured": None}
    assert ("unet", "scene=hall,trained on it=unknown") in words(run_all(inputs, tmp_path / "out", **chosen))


@pytest.mark.parametrize(
    ("met", "answer"),
    [
        ([], "no"),
        ([("street", "s"), ("canyon", "c")], "no"),
        ([("street", "s"), ("another name", "h")], "yes"),
        ([("hall", "h with cars")], "unknown"),
        (None, "unknown"),
    ],
)
def test_scenes_of_other_datasets_are_known_by_what_is_in_them(met, answer):
    scenes = None if met is None else tuple(SceneRecord(name=name, content_sha256=content) for name, content in met)
    other = Fingerprint(name="else", sha256="0" * 64, frames={}, scenes=scenes)
    network = replace(estimator_contender("das", FULL, RADAR), parameters=1, trained_on=(other,))
    hall = (SceneRecord(name="hall", content_sha256="h"),)
    bench = Bench("f" * 64, RADAR, (), frozenset(), (network,), EvaluationConfig(), scenes=hall)
    assert trained_on(bench, network, "hall") == answer
    assert trained_on(bench, network, "none") == "unknown"  # close targets are of no scene
    # What one of its datasets may have held, the network may have seen; what one held, it has.
    unknown = Fingerprint(name="older", sha256="1" * 64, frames={})
    both = replace(network, trained_on=(other, unknown))
    assert trained_on(bench, both, "hall") == ("yes" if answer == "yes" else "unknown")
    assert trained_on(replace(bench, scenes=None), network, "hall") == "unknown"


@pytest.mark.parametrize(
    ("scene", "answer"), [("hall", "yes"), ("canyon", "no"), ("tested alone", "no"), ("none", "yes")]
)
def test_of_the_first_frames_of_a_dataset_a_run_has_seen_some_scenes(scene, answer):
    records = tuple(SceneRecord(name=name, content_sha256=name) for name in ("hall", "canyon", "tested alone"))
    run = Fingerprint(name="data", sha256="f" * 64, frames={}, scenes=records[:1])
    network = replace(estimator_contender("das", FULL, RADAR), parameters=1, trained_on=(run,))
    training = frozenset({"hall", "canyon", "none"})
    bench = Bench("f" * 64, RADAR, (), training, (network,), EvaluationConfig(), scenes=records)
    assert trained_on(bench, network, scene) == answer


def test_a_network_has_seen_what_the_run_that_it_began_with_has(tmp_path):
    met = tuple(Fingerprint(name=name, sha256=64 * name[0], frames={"train": 4}) for name in ("a", "b", "c"))
    first = make_run(tmp_path / "first", FULL, datasets=met[:1])
    second = make_run(tmp_path / "second", FULL, datasets=met[1:2])
    write_run(second, read_run(second).model_copy(update={"start": Start.of(first)}))
    third = make_run(tmp_path / "third", FULL, datasets=met[2:])
    write_run(third, read_run(third).model_copy(update={"start": Start.of(second)}))
    (network,) = gather(["unet"], [third], [FULL], RADAR, tmp_path)
    assert network.trained_on == met


def test_a_network_is_told_the_noise_of_the_data_and_not_of_its_own_radar(tmp_path):
    front_end = RADAR.front_end.model_copy(update={"noise_figure_db": RADAR.front_end.noise_figure_db + 30.0})
    noisy = RADAR.model_copy(update={"front_end": front_end})
    (network,) = gather(["unet"], [make_run(tmp_path / "run", FULL)], [FULL], noisy, tmp_path)
    assert network.answer.radar.front_end == noisy.front_end
    assert cell_noise_power(network.answer.radar) == pytest.approx(1e3 * cell_noise_power(RADAR), rel=1e-9, abs=0.0)


def test_a_network_of_angles_takes_rows_alone_and_was_trained_on_no_scene(tmp_path):
    seen = (Fingerprint(name="data", sha256="0" * 64, frames={}),)
    run = make_run(tmp_path / "run", FULL, TWO_TX, seen, **DOA)
    (cnn,) = gather(["cnn"], [run], [FULL], TWO_TX, tmp_path)
    assert (cnn.name, cnn.answer.unit, cnn.trained_on) == ("cnn full", "probability of a target", ())
    generator = np.random.default_rng(1)
    snapshots = (generator.standard_normal((48, 12, 2)) @ np.array([1.0, 1.0j])).astype(np.complex64)
    image = cnn.answer.image(snapshots, 1e-3)
    assert image.shape == (48, 20)
    assert 0.0 < image.min() < image.max() < 1.0
    rows = np.array([4, 40])
    np.testing.assert_allclose(cnn.answer.of_rows(snapshots, 1e-3, rows)[0], image[rows], rtol=1e-5)


def test_contenders_stand_in_the_order_of_methods_and_arrays_whatever_that_of_the_runs(tmp_path):
    arrays = {"c": (THIN, {}), "b": (FULL, DOA), "a": (FULL, {})}
    runs = [make_run(tmp_path / name, array, TWO_TX, **changes) for name, (array, changes) in arrays.items()]
    names = [contender.name for contender in gather(["cnn", "das", "unet"], runs, [FULL, THIN], TWO_TX, tmp_path)]
    assert names == ["das full", "das thin", "cnn full", "unet full", "unet thin"]


def test_delay_and_sum_of_noise_exceeds_the_level_as_rarely_as_stated():
    """In rows of the strongest of all Doppler cells, as datasets hold them, and not of any one."""
    bench, noise_only = Bench("f" * 64, RADAR, (), frozenset(), (), EvaluationConfig()), NoiseOnly()
    das = estimator_contender("das", FULL, RADAR)
    power = cell_noise_power(RADAR)
    images = np.stack([das.answer.image(noise_only.scene(bench, place), power) for place in range(40)])
    for probability, within in ((1e-2, (0.2, 1.0)), (1e-1, (0.2, 1.0))):
        level = noise_level(das.answer.line, power, of_one_cell(probability, RADAR.waveform.chirps))
        assert within[0] * probability < np.mean(images > level) < within[1] * probability


def test_two_networks_of_one_kind_are_told_apart(inputs, tmp_path):
    runs = [make_run(tmp_path / name) for name in ("wide", "deep")]
    table = run_all(
        inputs, tmp_path / "out", run=runs, methods=["unet"], experiments=["tradeoff"], measured=None,
    )  # fmt: skip
    assert set(table["method"].to_pylist()) == {"unet:wide", "unet:deep"}
    copy = tmp_path / "else" / "wide"
    copy.parent.mkdir()
    with pytest.raises(InputError, match="two runs are named 'unet:wide thin'"):
        run_all(inputs, tmp_path / "no", run=[runs[0], make_run(copy)], methods=["unet"], measured=None)
