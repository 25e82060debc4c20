"""Order, augmentation, targets, spots and losses: what a training step is made of."""

import math

import numpy as np
import pytest
import torch
from tiny_radar import NOISE_POWER, RADAR, TINY, frame, tiny

from shared.signal.imaging import steering_weights
from shared.signal.signal import manifold
from trainer.data.arrays import ArrayChoice
from trainer.data.dataset import BatchOrder
from trainer.metrics.cells import truth_cells
from trainer.run.configuration import FitConfig
from trainer.run.imager import Imager, decode, encode
from trainer.training.augmentation import AngularAugmentation, Draw, draw
from trainer.training.losses import SIGMA_BINS, SIGMA_ROWS, frame_losses, scene_spots, spot_image
from trainer.training.task import ImagingTask

UNTOLD = np.ones(1)


def test_an_epoch_sees_every_frame_once_and_the_next_in_another_order():
    batches = list(BatchOrder([5, 3], None, batch=4, seed=1, batches=4))
    first, second = batches[0] + batches[1], batches[2] + batches[3]
    assert sorted(first) == sorted(second) == list(range(8))
    assert first != second
    assert batches == list(BatchOrder([5, 3], None, batch=4, seed=1, batches=4))
    assert batches != list(BatchOrder([5, 3], None, batch=4, seed=2, batches=4))


def test_a_run_taken_up_sees_what_it_would_have_seen():
    whole = list(BatchOrder([7], None, batch=3, seed=0, batches=9))
    assert list(BatchOrder([7], None, batch=3, seed=0, batches=9, first=4)) == whole[4:]
    assert all(len(batch) == 3 for batch in whole)


def test_processes_share_every_batch():
    whole = list(BatchOrder([8], None, batch=4, seed=0, batches=4))
    parts = [list(BatchOrder([8], None, batch=4, seed=0, batches=4, rank=rank, world=2)) for rank in (0, 1)]
    assert [one + other for one, other in zip(*parts, strict=True)] == whole


def test_weights_set_the_shares_of_the_datasets():
    indices = np.concatenate(list(BatchOrder([30, 10], [1.0, 3.0], batch=4, seed=0, batches=10)))
    assert len(indices) == 40
    assert (indices >= 30).sum() == 30
    assert set(indices[indices >= 30]) == set(range(30, 40))


def test_a_shift_in_angle_is_that_of_a_target_seen_elsewhere():
    weights = steering_weights(RADAR, np.arange(6))
    echoes = torch.from_numpy(np.conj(weights * 6).T.copy())  # (U, C)
    image = torch.eye(20)[None]  # row r holds one target at column r
    drawn = Draw(torch.tensor([3]), torch.tensor([False]), 0.0, UNTOLD)
    moved, (truth, again), known = AngularAugmentation(RADAR)(echoes[None], [image, 2.0 * image], drawn)
    torch.testing.assert_close(moved[0, :17], echoes[3:], rtol=0, atol=1e-5)
    assert torch.equal(truth[0, :17, 3:], torch.eye(17))
    assert torch.equal(again, 2.0 * truth)
    assert known[0, 0].tolist() == [0.0] * 3 + [1.0] * 17


def test_a_mirrored_frame_is_that_of_targets_on_the_other_side():
    weights = steering_weights(RADAR, np.arange(6))
    echoes = torch.from_numpy(np.conj(weights * 6).T.copy())
    drawn = Draw(torch.tensor([0]), torch.tensor([True]), 0.0, UNTOLD)
    moved, (truth,), known = AngularAugmentation(RADAR)(echoes[None], [torch.eye(20)[None]], drawn)
    # u_10 = 0 is its own mirror image; u_0 = -0.5 has no partner on the grid.
    for column in range(1, 20):
        torch.testing.assert_close(moved[0, column], echoes[20 - column], rtol=0, atol=1e-5)
        assert truth[0, column].argmax() == 20 - column
    assert known[0, 0].tolist() == [0.0] + [1.0] * 19


@pytest.mark.parametrize("mirror", [False, True])
def test_a_prior_moves_with_the_echoes(mirror):
    """What stood at u stands where its origin is u: an echo at the new angle is what the echo at the old one became."""
    u = np.array([-0.3, 0.1, 0.95])
    drawn = Draw(torch.tensor([3]), torch.tensor([mirror]), 0.0, UNTOLD)
    augment = AngularAugmentation(RADAR)
    y, wavelength_m = RADAR.array.virtual[:, 1], RADAR.waveform.wavelength_m
    old = torch.from_numpy(manifold(y, wavelength_m, augment.origins(u, drawn)[0]).T.astype(np.complex64))
    moved, _, _ = augment(old[None], [], drawn)
    new = torch.from_numpy(manifold(y, wavelength_m, u).T.astype(np.complex64))
    torch.testing.assert_close(moved[0], new, rtol=0, atol=1e-5)
    assert np.abs(augment.origins(u, drawn)).max() <= 1.0


def test_draws_depend_on_seed_and_step_alone_and_are_dealt_out():
    whole = draw(1, 5, 4, 0, 4, 30)
    parts = [draw(1, 5, 4, first, 2, 30) for first in (0, 2)]
    assert torch.cat([part.shift for part in parts]).equal(whole.shift)
    assert torch.cat([part.mirror for part in parts]).equal(whole.mirror)
    assert {part.crop for part in parts} == {whole.crop}
    assert not draw(1, 6, 4, 0, 4, 30).shift.equal(whole.shift)
    assert not draw(1, 5, 4, 0, 4, 0).mirror.any()


def truth_and_scale():
    made = frame(0)
    image = torch.from_numpy(made.image)[None]
    scale = torch.from_numpy(np.sqrt((np.abs(made.range_channel[0]) ** 2).mean(-1)))[None]
    return image, torch.tensor([made.image_peak], dtype=torch.float64), scale


def test_the_row_target_is_invertible_and_level_over_range():
    image, peak, scale = truth_and_scale()
    target = encode(TINY, image, peak, scale)
    back = decode(TINY, target[:, None], scale)
    torch.testing.assert_close(back, image * peak.float(), rtol=1e-4, atol=1e-14)
    with_targets = target[0].amax(dim=1)[1::3]
    assert with_targets.min() > 0.4
    assert with_targets.max() < 1.6


def test_the_paper_s_target_is_min_max_times_beta():
    image, peak, _ = truth_and_scale()
    config = tiny(model="spectral-unet", features="paper", target="paper")
    target = encode(config, image + 0.25, peak, None)
    assert target.min() == 0
    assert target.max() == 10.0
    flat = encode(config, torch.ones(1, 3, 4), peak, None)
    assert torch.equal(flat, torch.zeros(1, 3, 4))
    torch.testing.assert_close(decode(config, encode(config, image, peak, None)[:, None], None), image - image.min())


def test_the_class_target_holds_what_is_above_the_stated_level():
    config = tiny(model="spectral-unet", target="class", threshold_db=20.0)
    image = torch.tensor([[[1.0, 0.11, 0.09, 0.0]]])
    assert encode(config, image, torch.ones(1), None).tolist() == [[[1.0, 1.0, 0.0, 0.0]]]
    probability = decode(config, torch.tensor([[[[0.0]], [[math.log(3.0)]]]]), None)
    assert probability.item() == pytest.approx(0.75)


def test_a_row_without_signal_asks_for_nothing():
    target = encode(TINY, torch.ones(1, 2, 3), torch.tensor([1e-7]), torch.tensor([[0.0, 1e-7]]))
    assert target[0].tolist() == [[0.0] * 3, [1.0] * 3]


def test_losses_are_those_of_table_2():
    target = torch.tensor([[[0.0, 1.0]]])
    answer = torch.tensor([[[[0.5, 0.0]]]])
    config = tiny(model="spectral-unet", foreground=3.0, alpha=0.1)
    everything = torch.ones(1, 1, 2)
    assert frame_losses(config, answer, target, everything, None).item() == pytest.approx((0.25 + 4.0 + 0.05) / 2)
    known = torch.tensor([[[1.0, 0.0]]])
    assert frame_losses(config, answer, target, known, None).item() == pytest.approx(0.25 + 0.05)
    # Two classes, logits 0 and log 3: p(target) = 3/4; the loss is positive and falls as p(class) rises.
    logits = torch.tensor([[[[0.0, 0.0]], [[math.log(3.0), math.log(3.0)]]]])
    config = tiny(model="spectral-unet", target="class", foreground=0.0, alpha=0.1)
    expected = -(math.log(0.25) + math.log(0.75)) / 2
    assert frame_losses(config, logits, target, everything, None).item() == pytest.approx(expected)


def test_the_linear_loss_is_the_error_over_the_energy_of_truth_and_noise():
    """Of four frames: a usual one, one below its noise, one whose truth is empty, and one of nothing at all."""
    config = tiny(linear=0.5)
    task = ImagingTask(config, RADAR, ArrayChoice(name="full", rx=tuple(range(6))))
    generator = torch.Generator().manual_seed(2)
    image, answer = (torch.rand(4, *shape, generator=generator) for shape in ((24, 20), (2, 24, 20)))
    peak, noise = (
        torch.tensor(levels, dtype=torch.float64) for levels in ([2e-7, 3e-9, 0, 0], [1e-18, 1e-14, 1e-18, 0])
    )
    image[2:], answer[3] = 0.0, 0.0
    scale = torch.full((4, 24), 1e-8)
    known = torch.ones(4, 1, 20)
    known[:, :, :3] = 0.0
    batch = {"image": image, "image_peak": peak, "noise_power": noise}
    found = task._linear_losses(batch, answer, scale, known)
    estimate, truth = decode(config, answer, scale).double()[..., 3:], (image * peak[:, None, None])[..., 3:]
    energy = truth.square() + noise[:, None, None] / 6
    expected = 0.5 * (estimate - truth).square().sum(dim=(1, 2)) / energy.sum(dim=(1, 2))
    torch.testing.assert_close(found[:3], expected[:3].float(), rtol=1e-5, atol=0)
    assert found[3] == 0.0
    assert not task._linear_losses(batch, torch.zeros_like(answer), scale, known)[2:].any()


def test_a_network_has_features_of_its_own_where_none_are_stated():
    models = {"unrolled": "snapshots", "spectral-unet": "adaptive", "attention-unet": "adaptive"}
    for model, features in models.items():
        assert FitConfig.model_validate({"model": model}).features == features
    assert FitConfig().features == "snapshots"
    assert (
        FitConfig.model_validate({"model": "spectral-unet", "features": "paper", "target": "class"}).features == "paper"
    )


def test_delay_and_sum_of_the_imager_is_in_input_units():
    imager = Imager(TINY, RADAR, ArrayChoice(name="full", rx=tuple(range(6))))
    weights = steering_weights(RADAR, np.arange(6))
    echo = torch.from_numpy(3e-7 * np.conj(weights[:, 4] * 6))[None, None]
    assert imager.das(echo)[0, 0].max().item() == pytest.approx(3e-7, rel=1e-5)
    assert imager.das(echo)[0, 0].argmax() == 4
    assert NOISE_POWER < 1e-14


ROWS, BINS = 12, 20


def test_a_spot_is_its_equation_written_out():
    row, place = np.array([4.3, 9.0]), np.array([11.7, 3.0])
    image = spot_image(ROWS, BINS, row, place)
    assert image.dtype == np.float32
    for r in range(ROWS):
        for b in range(BINS):
            expected = np.exp(-0.5 * ((r - row) / SIGMA_ROWS) ** 2 - 0.5 * ((b - place) / SIGMA_BINS) ** 2).max()
            # What lies farther away than a spot reaches is left out.
            assert abs(image[r, b] - expected) < 0.01 or (image[r, b] == 0.0 and expected < 0.14)
    assert image[9, 3] == 1.0


def test_targets_three_bins_apart_are_two_maxima_and_two_at_one_place_are_one_spot():
    row = np.array([5.0, 5.0])
    line = spot_image(ROWS, BINS, row, np.array([8.0, 11.0]))[5]
    assert line[8] == line[11] == 1.0
    assert line[9:11].max() < 0.5
    np.testing.assert_array_equal(
        spot_image(ROWS, BINS, row, np.array([8.0, 8.0])), spot_image(ROWS, BINS, row[:1], row[:1] + 3)
    )


def test_a_target_at_the_edge_or_outside_leaves_the_rest_of_its_spot():
    image = spot_image(ROWS, BINS, np.array([-0.4, 3.0, 50.0]), np.array([0.0, BINS + 0.4, 3.0]))
    assert image[0, 0] > 0.5
    assert 0.1 < image[3, BINS - 1] < 0.5
    assert not image[5:].any()
    assert not spot_image(ROWS, BINS, np.empty(0), np.empty(0)).any()


def test_the_spots_of_a_scene_stand_on_the_cells_of_its_truth():
    made = frame(0)
    given = torch.from_numpy(made.image)[None], torch.tensor([made.image_peak]), torch.tensor([NOISE_POWER])
    image = scene_spots(*given, 6, RADAR)
    cells = truth_cells(made.image * made.image_peak, NOISE_POWER, 6, RADAR.waveform.range_step_m)
    assert image.shape == (1, *made.image.shape)
    assert np.argwhere(image[0].numpy() == 1.0).tolist() == cells.tolist()
    loud = scene_spots(given[0], given[1], given[2] * 1e20, 6, RADAR)
    assert not loud.any()
