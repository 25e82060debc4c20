"""What training begins with where nobody says: the weights that come with the package if they fit, else random ones."""

import hashlib
from dataclasses import replace

import pytest
import torch
from tiny_radar import RADAR, TINY, frame, tiny, write_dataset
from tiny_run import run, run_of

from shared.physics.errors import InputError
from shared.radar import load_radar
from trainer.data.arrays import ArrayChoice, choose_array
from trainer.run.configuration import FitConfig
from trainer.run.folder import WEIGHTS, load_imager, read_run
from trainer.run.imager import Imager
from trainer.run.pretrained import pretrained_run
from trainer.training.fit import FURTHER_RATE
from trainer.training.options import SHIPPED
from trainer.training.start import begin_with, shipped_start

BOARD = load_radar("avr-qdm-110")


@pytest.fixture
def shipped(tmp_path, monkeypatch):
    """A run of the tiny radar, with random weights, as the only one that comes with the package."""
    path = run_of(tmp_path / "ours", RADAR, tiny(truth_window="none"))  # as the dataset has it
    monkeypatch.setattr("trainer.training.start.pretrained_names", lambda: ("ours",))
    monkeypatch.setattr("trainer.training.start.pretrained_run", {"ours": path}.__getitem__)
    return path


@pytest.mark.parametrize(
    ("board", "array", "name"),
    [
        (BOARD, choose_array("sparse6", BOARD), "sparse6"),
        (BOARD, choose_array("sparse4", BOARD), "sparse4"),
        (BOARD, choose_array("full", BOARD), "sparse6"),
        (BOARD, ArrayChoice(name="mine", rx=(0, 3, 9)), "sparse4"),
        (load_radar("iwr1843"), choose_array("full", load_radar("iwr1843")), "sparse4"),
    ],
)
def test_any_array_begins_with_the_weights_of_the_nearest_number_of_channels(board, array, name):
    path, said = shipped_start(FitConfig(), board, array)
    assert path == pretrained_run(name)
    assert f"come with the package for {name}" in said
    imager = Imager(FitConfig(), board, array)
    begin_with(imager, FitConfig(), path)  # no weight knows the array
    weights = load_imager(path)[1].network.state_dict()
    assert all(torch.equal(tensor, weights[key]) for key, tensor in imager.network.state_dict().items())


def test_a_field_of_another_network_does_not_keep_weights_out():
    other = FitConfig(hidden=7, threshold_db=20.0)
    path, _ = shipped_start(other, BOARD, choose_array("sparse6", BOARD))
    assert path == pretrained_run("sparse6")
    begin_with(Imager(other, BOARD, choose_array("sparse6", BOARD)), other, path)


@pytest.mark.parametrize(
    ("changes", "radar", "said"),
    [
        ({"width": 24}, BOARD, "width = 12, not 24"),
        ({"truth_window": "hann"}, BOARD, "truth_window = 'taylor-30', not 'hann'"),
        ({"model": "spectral-unet", "features": "adaptive"}, BOARD, "model = 'unrolled', not 'spectral-unet'"),
        ({}, BOARD.model_copy(update={"grid": RADAR.grid}), "another angle grid"),
        ({}, BOARD.model_copy(update={"virtual_sensor": RADAR.virtual_sensor}), "another virtual sensor"),
    ],
)
def test_a_network_grid_or_truth_of_another_kind_begins_with_random_weights(changes, radar, said):
    array = ArrayChoice(name="mine", rx=(0, 1, 2))
    start, line = shipped_start(FitConfig.model_validate(changes), radar, array)
    assert start is None
    assert line.endswith(said)


def test_a_fit_that_is_not_told_begins_with_them_and_says_so(dataset, tmp_path, shipped):
    still = TINY.model_copy(update={"learning_rate": 1e-30, "weight_decay": 0.0})
    result, lines = run(dataset, tmp_path / "run", still)
    assert "begins with the weights that come with the package for ours; --from none: with random ones" in lines
    assert result.start is not None
    assert result.start.name == "ours"
    assert result.start.sha256 == hashlib.sha256((shipped / WEIGHTS).read_bytes()).hexdigest()
    assert read_run(tmp_path / "run").start == result.start
    weights = [load_imager(path)[1].network.state_dict() for path in (shipped, tmp_path / "run")]
    assert all(torch.equal(tensor, weights[1][key]) for key, tensor in weights[0].items())
    run(dataset, tmp_path / "run", still, start=SHIPPED, resume=True)
    with pytest.raises(InputError, match=r"start is random weights, but the run in .* had ours \("):
        run(dataset, tmp_path / "run", still, start=None, resume=True)


def test_a_network_that_is_told_the_motion_begins_with_weights_of_one_that_is_not(tmp_path, shipped):
    """The prior's own weights begin at zero and are trained by the frames that are told."""
    config = tiny(model="unrolled", target="row", truth_window="none", told=0.5)
    weights = load_imager(shipped)[1].network.state_dict()
    imager = Imager(config, RADAR, choose_array("full", RADAR))
    begin_with(imager, config, shipped)
    begun = imager.network.state_dict()
    assert not begun.pop("prior.weight").any()
    assert all(torch.equal(tensor, weights[key]) for key, tensor in begun.items())
    velocity = (5.0 * RADAR.waveform.velocity_step_mps, 0.0, 0.0)
    frames = [replace(frame(index), sensor_velocity=velocity) for index in range(4)]
    drive = write_dataset(tmp_path / "drive", {"train": frames, "validation": frames[:1], "test": frames[1:2]})
    result, _ = run(drive, tmp_path / "run", config, start=SHIPPED)
    assert result.config.told == 0.5
    assert load_imager(tmp_path / "run")[1].network.get_parameter("prior.weight").any()


@pytest.mark.parametrize(
    ("stated", "start", "rate"),
    [({}, SHIPPED, FURTHER_RATE), ({}, None, 1e-3), ({"learning_rate": 1e-3}, SHIPPED, 1e-3)],
)
def test_further_training_is_gentler_unless_told(dataset, tmp_path, shipped, stated, start, rate):
    fields = TINY.model_dump(exclude_unset=True)
    del fields["learning_rate"]
    config = FitConfig.model_validate(fields | stated)
    result, _ = run(dataset, tmp_path / "run", config, start=start)
    assert result.config.learning_rate == rate


def test_a_run_from_none_is_resumed_as_such(dataset, tmp_path, shipped):
    run(dataset, tmp_path / "run", start=None)
    _, lines = run(dataset, tmp_path / "run", resume=True)
    assert read_run(tmp_path / "run").start is None
    assert not [line for line in lines if line.startswith("begins with")]
