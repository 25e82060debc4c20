"""The unrolled network: plain iterations and their view until it has learned, finite gradients wherever rows are hard,
one set of weights for all arrays."""

import numpy as np
import pytest
import torch

from shared.radar import Radar
from shared.radar.arrays import AVR_QDM_110_THINNED_RX
from shared.signal.adaptive import (
    AdaptiveTables,
    adaptive_forms,
    adaptive_powers,
    adaptive_tables,
    bounded_power,
    likes_ratio,
    view_table,
    virtual_view,
)
from shared.signal.features import snapshot_features
from trainer.networks.real_unrolled import RealUnrolledNetwork, inverted
from trainer.networks.unrolled import LARGEST_CORRECTION, LEAST_RATIO, RARE, SMALLEST, UnrolledNetwork
from trainer.run.folder import load_imager
from trainer.run.pretrained import pretrained_run

RADAR = Radar()
BINS = RADAR.grid.bins
EXPONENT, PLAIN, LEARNED = 0.5, 2, 2


def chosen(name):
    return RADAR.array.channel_indices(AVR_QDM_110_THINNED_RX[name])


def network(name="sparse4", seed=0, trained=False, plain=PLAIN, learned=LEARNED, detects=True, told=False):
    """Fresh, or with weights as training may leave them."""
    torch.manual_seed(seed)
    made = UnrolledNetwork(RADAR, chosen(name), "taylor-30", EXPONENT, (plain, learned), 4, detects, told)
    if trained:
        with torch.no_grad():
            for parameter in made.parameters():
                parameter.add_(0.05 * torch.randn_like(parameter))
    return made


def rows(count, name="sparse4", noise_power=1e-2, seed=0):
    """([1, R, C] complex64 of two echoes and noise in each row, [1] noise power)."""
    generator = np.random.default_rng(seed)
    y = RADAR.array.virtual[chosen(name), 1]
    u = generator.uniform(-0.8, 0.8, (count, 2))
    amplitude = np.exp(2j * np.pi * generator.random((count, 2)))
    x = np.einsum("rk,rkc->rc", amplitude, np.exp(-2j * np.pi / RADAR.waveform.wavelength_m * u[..., None] * y))
    x = x + np.sqrt(noise_power / 2) * (generator.standard_normal((*x.shape, 2)) @ np.array([1.0, 1.0j]))
    return torch.from_numpy(x.astype(np.complex64))[None], torch.tensor([noise_power])


def features(range_channel, noise_power):
    return snapshot_features(range_channel, noise_power)[0]


def plain_powers(given, name="sparse4"):
    """(snapshot [R, C], noise [R], tables, powers [R, N] of the iterations without weights) of features [1, 2 C + 1, R,
    1]."""
    channels = chosen(name)
    row = given[0, :, :, 0].T
    snapshot, noise = torch.complex(row[:, : len(channels)], row[:, len(channels) : -1]), row[:, -1]
    tables = AdaptiveTables(*(torch.from_numpy(table) for table in adaptive_tables(RADAR, channels)))
    return snapshot, noise, tables, adaptive_powers(snapshot, noise, tables, PLAIN)


def without_heads(made):
    """The same network, its answer the base alone."""
    for head in (made.context.head, made.row):
        torch.nn.init.zeros_(head.weight)
        torch.nn.init.zeros_(head.bias)
    return made


def known_powers(made, given):
    """[B, R, U] powers after the last learned step, as the network's U-Net is told them."""
    told = []
    handle = made.context.register_forward_pre_hook(lambda _, arguments: told.append(arguments[0]))
    with torch.no_grad():
        made(given)
    handle.remove()
    return torch.pow(10.0, 4.0 * (told[0][:, 0] - 0.5))


def test_the_base_is_what_the_virtual_sensor_sees_of_the_plain_iterations():
    """With the heads at zero the answer is the base, whatever the learned steps do."""
    given = features(*rows(5))
    with torch.no_grad():
        answer = without_heads(network(trained=True))(given)
    snapshot, noise, tables, power = plain_powers(given)
    filtered, _ = adaptive_forms(power, snapshot, noise, tables)
    view = torch.from_numpy(view_table(RADAR, chosen("sparse4"), "taylor-30"))
    seen = virtual_view(power, filtered, view)
    torch.testing.assert_close(answer[0, 0], (seen + SMALLEST) ** EXPONENT, rtol=0, atol=1e-5)
    assert not answer[0, 1].any()
    # The base is neither that of other iterations nor without the phases of the echoes.
    for other in (PLAIN - 1, PLAIN + 1):
        power = adaptive_powers(snapshot, noise, tables, other)
        different = virtual_view(power, adaptive_forms(power, snapshot, noise, tables)[0], view)
        assert (answer[0, 0] - (different + SMALLEST) ** EXPONENT).abs().max() > 0.01


def test_before_training_the_answer_is_the_base_and_detection_rare():
    given = features(*rows(5))
    with torch.no_grad():
        answer, base = network()(given), without_heads(network(trained=True))(given)
    assert torch.equal(answer[:, 0], base[:, 0])
    assert (answer[:, 1] == RARE).all()


@pytest.mark.parametrize("learned", [0, 1, 3])
def test_learned_steps_without_correction_are_plain_ones_from_the_plain_powers(learned):
    given = features(*rows(5))
    snapshot, noise, tables, power = plain_powers(given)
    for _ in range(learned):
        power = bounded_power(power * likes_ratio(*adaptive_forms(power, snapshot, noise, tables)))
    found = known_powers(network(learned=learned), given)
    torch.testing.assert_close(found[0].sqrt(), power[:, :BINS].clamp_min(1e-10).sqrt(), rtol=1e-3, atol=1e-5)


def test_a_correction_is_an_exponent_and_a_factor():
    """A step with given (beta, delta): P <- P (|q|^2 / s)^(1 + beta) 10^delta inside the image."""
    beta, delta = 0.25, -0.3
    made = network(learned=1)
    with torch.no_grad():
        made.steps[0].last.bias.copy_(torch.tensor([beta, delta]))
    given = features(*rows(5))
    snapshot, noise, tables, power = plain_powers(given)
    q, s = adaptive_forms(power, snapshot, noise, tables)
    ratio = q.abs().square() / s
    change = (beta * ratio.clamp_min(LEAST_RATIO).log10() + delta).clamp(-LARGEST_CORRECTION, LARGEST_CORRECTION)
    expected = bounded_power(power * ratio * torch.pow(10.0, change))[:, :BINS]
    torch.testing.assert_close(known_powers(made, given)[0].sqrt(), expected.sqrt(), rtol=1e-3, atol=1e-5)


def hard_rows(kind):
    """([1, R, C], [1]) as an array measures them; zeros, and extremes of level and of noise."""
    snapshots, noise_power = rows(6)
    if kind == "zeros":
        snapshots[:, ::2] = 0
    elif kind == "nothing but zeros":
        snapshots[:] = 0
    elif kind == "1e-20":
        snapshots, noise_power = snapshots * 1e-20, noise_power * 1e-38
    elif kind == "1e20":
        snapshots = snapshots * 1e18
    elif kind == "noise alone":
        snapshots, noise_power = rows(6, noise_power=1.0)[0] * 1e-9, torch.tensor([1.0])
    elif kind == "one target at 80 dB":
        y = torch.from_numpy(RADAR.array.virtual[chosen("sparse4"), 1])
        echo = torch.polar(torch.ones_like(y), -2 * np.pi / RADAR.waveform.wavelength_m * 0.2345 * y)
        noise = 1e-4 * torch.randn(1, 6, len(y), dtype=torch.complex64, generator=torch.Generator().manual_seed(0))
        snapshots, noise_power = (echo.to(torch.complex64) + noise), torch.tensor([1e-8])
    else:
        noise_power = torch.zeros(1)
    return snapshots, noise_power


HARD = ("zeros", "nothing but zeros", "1e-20", "1e20", "noise alone", "one target at 80 dB", "no noise")


@pytest.mark.parametrize("trained", [False, True])
@pytest.mark.parametrize("kind", HARD)
def test_images_and_gradients_of_hard_rows_are_finite(kind, trained):
    made = network(trained=trained)
    given = features(*hard_rows(kind))
    answer = made(given)
    assert torch.isfinite(answer).all()
    with torch.no_grad():
        assert torch.isfinite(RealUnrolledNetwork(made)(given)).all()
    if not trained and kind == "nothing but zeros":
        assert answer[:, 0].detach().abs().max() < 2.0
    answer.square().sum().backward()
    gradients = {name: parameter.grad for name, parameter in made.named_parameters()}
    assert [name for name, value in gradients.items() if value is None or not torch.isfinite(value).all()] == []


def test_gradients_reach_every_parameter():
    made = network(trained=True)
    made(features(*rows(5))).square().sum().backward()
    without = [name for name, value in made.named_parameters() if value.grad is None or not value.grad.any()]
    assert without == []
    # All last layers start at zero. The heads learn from the first step on, the others from the second.
    fresh = network()
    given = features(*rows(5))
    fresh(given)[:, 0].square().sum().backward()
    assert fresh.row.weight.grad.any()
    assert fresh.context.head.weight.grad.any()
    with torch.no_grad():
        for head in (fresh.row, fresh.context.head):
            head.weight -= 1e-3 * head.weight.grad
    fresh.zero_grad()
    fresh(given)[:, 0].square().sum().backward()
    for step in fresh.steps:
        assert step.last.weight.grad.any()


def test_no_weight_knows_the_array():
    one, other = network("sparse4", trained=True), network("sparse6", seed=1)
    other.load_state_dict(one.state_dict())
    again = network("sparse4", seed=2)
    again.load_state_dict(other.state_dict())
    given = features(*rows(3))
    with torch.no_grad():
        assert torch.equal(again(given), one(given))
        assert other(features(*rows(3, "sparse6"))).shape == (1, 2, 3, BINS)


@pytest.mark.parametrize(
    ("count", "detects", "plain", "learned"), [(1, True, PLAIN, LEARNED), (3, False, 1, 0), (6, True, 0, 1)]
)
def test_any_number_of_rows_and_of_steps_and_one_or_two_outputs(count, detects, plain, learned):
    made = network(detects=detects, plain=plain, learned=learned)
    given = features(*rows(count))
    with torch.no_grad():
        answer = made(torch.cat([given, given]))
    assert answer.shape == (2, 2 if detects else 1, count, BINS)
    assert torch.isfinite(answer).all()


def test_an_image_may_have_fewer_angles_than_the_network_looks_aside():
    few = RADAR.model_copy(update={"grid": RADAR.grid.model_copy(update={"bins": 5})})
    made = UnrolledNetwork(few, chosen("sparse4"), "taylor-30", EXPONENT, (PLAIN, LEARNED), 4, True, False)
    with torch.no_grad():
        assert made(features(*rows(3))).shape == (1, 2, 3, 5)


def test_bfloat16_stays_near_single_precision():
    made = network(trained=True)
    given = features(*rows(8))
    with torch.no_grad():
        exact = made(given)
        with torch.autocast("cpu", torch.bfloat16):
            half = made(given).float()
    assert (half - exact).norm() < 0.02 * exact.norm()
    assert not torch.equal(half, exact)


def test_a_common_phase_changes_nothing():
    """Neither does the scale, which the features take out."""
    made = network(trained=True)
    snapshots, noise_power = rows(4)
    turned = snapshots * complex(np.exp(1.3j)) * 4.0
    with torch.no_grad():
        one, other = made(features(snapshots, noise_power)), made(features(turned, 16.0 * noise_power))
    torch.testing.assert_close(one, other, rtol=0, atol=5e-3)


def test_the_base_of_a_conjugated_snapshot_is_mirrored():
    """Targets on the other side, from delay-and-sum to the virtual view; what is learned has no such symmetry."""
    made = without_heads(network())
    snapshots, noise_power = rows(4)
    with torch.no_grad():
        one, other = (made(features(x, noise_power))[0, 0] for x in (snapshots, snapshots.conj().resolve_conj()))
    mirror = RADAR.grid.mirror
    assert mirror is not None
    bins = [place for place in range(BINS) if 0 <= mirror - place < BINS]
    # The scanned axis ends one step apart on its two sides.
    torch.testing.assert_close(other[:, bins], one[:, [mirror - place for place in bins]], rtol=0, atol=0.02)


def test_sweeps_invert():
    generator = torch.Generator().manual_seed(0)
    factors = torch.randn(20, 12, 24, generator=generator, dtype=torch.float64)
    matrices = factors @ factors.transpose(1, 2) / 24 + 1e-3 * torch.eye(12, dtype=torch.float64)
    torch.testing.assert_close(inverted(matrices), torch.linalg.inv(matrices), rtol=1e-9, atol=1e-9)
    single = inverted(matrices.float())
    assert (single - inverted(matrices)).abs().max() < 1e-4 * single.abs().max()


@pytest.mark.parametrize(("noise_power", "bound"), [(1.0, 1e-4), (1e-2, 1e-4), (1e-5, 2e-3)])
@pytest.mark.parametrize(("name", "plain", "learned"), [("sparse4", 8, 0), ("sparse6", 5, 2)])
def test_real_arithmetic_answers_what_complex_arithmetic_does(name, noise_power, bound, plain, learned):
    """To the rounding of single precision, which the inverse of a row of 40 dB and more multiplies."""
    made = network(name, trained=True, plain=plain, learned=learned)
    given = features(*rows(7, name, noise_power=noise_power))
    with torch.no_grad():
        expected, found = made(given), RealUnrolledNetwork(made)(given)
    assert (found - expected).norm() < bound * expected.norm()


@pytest.mark.parametrize("array", ["sparse4", "sparse6"])
def test_a_flat_prior_gives_todays_answer_of_the_shipped_weights_to_the_bit(array):
    """Weights that were trained without a prior load as they are; another prior changes the answer."""
    _, imager = load_imager(pretrained_run(array))
    generator, rows = np.random.default_rng(6), 3
    x = generator.standard_normal((1, rows, RADAR.array.channels, 2)) @ np.array([1.0, 1.0j])
    given, noise = torch.from_numpy(x.astype(np.complex64)), torch.tensor([1e-2])
    with torch.no_grad():
        today, sure = imager.detect(given, noise)
        angles = imager.network.get_buffer("view").shape[0]
        flat, as_sure = imager.detect(given, noise, prior=torch.ones(1, rows, angles))
        left = torch.cat([torch.full((1, rows, BINS // 2), 0.1), torch.ones(1, rows, angles - BINS // 2)], dim=2)
        other, _ = imager.detect(given, noise, prior=left)
    assert sure is not None
    assert as_sure is not None
    assert torch.equal(flat, today)
    assert torch.equal(as_sure, sure)
    lower = other[..., : BINS // 2].square().sum() / today[..., : BINS // 2].square().sum()
    higher = other[..., BINS // 2 :].square().sum() / today[..., BINS // 2 :].square().sum()
    assert lower < 0.8 * higher


def test_a_prior_is_an_input_whose_weights_begin_at_zero():
    """Until they are trained a network that is told answers as one that is not; a flat prior never adds anything."""
    plain, told = network(seed=2, trained=True), network(told=True)
    kept = told.load_state_dict(plain.state_dict(), strict=False)
    assert kept.missing_keys == ["prior.weight"]
    assert not kept.unexpected_keys
    given = features(*rows(5))
    flat = torch.ones(1, 5, told.get_buffer("view").shape[0])
    prior = flat.clone()
    prior[..., : BINS // 2] = 0.1
    with torch.no_grad():
        assert torch.equal(told(given, prior), plain(given, prior))
        assert told.prior is not None
        told.prior.weight.add_(0.1)
        assert torch.equal(told(given, flat), plain(given))
        assert torch.equal(told(given), plain(given))
        assert not torch.equal(told(given, prior), plain(given, prior))
