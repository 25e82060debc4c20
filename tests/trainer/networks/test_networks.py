"""Networks: every parameter is used and trains, images stay in place, half precision stays close."""

import numpy as np
import pytest
import torch
from jaxtyping import TypeCheckError
from tiny_radar import RADAR, tiny

from trainer.networks.convolutional import AttentionUNet, DoaCnn, SpectralUNet, crop_like, pad_to_multiple
from trainer.networks.unrolled import UnrolledNetwork
from trainer.run.imager import build_network

BINS, CHANNELS = RADAR.grid.bins, np.arange(6)


def networks():
    torch.manual_seed(0)
    return {
        "attention": AttentionUNet(5, 1, width=4),
        "attention, two classes": AttentionUNet(5, 2, width=4),
        "spectral": SpectralUNet(5, 1, BINS, width=4, hidden=8),
        "spectral, two classes": SpectralUNet(5, 2, BINS, width=4, hidden=8),
        "spectral, from an estimate": SpectralUNet(5, 1, BINS, width=4, hidden=8, start=4),
        "doa": DoaCnn(channels=9, bins=BINS, width=8),
    }


@pytest.mark.parametrize("name", networks())
def test_gradients_reach_every_parameter_and_the_shape_is_kept(name):
    network = networks()[name]
    answer = network(torch.randn(2, 3, 30, 81) if name == "doa" else torch.randn(2, 5, 30, BINS))
    assert answer.shape == (2, 2 if "classes" in name else 1, 30, BINS)
    answer.square().sum().backward()
    without = [key for key, value in network.named_parameters() if value.grad is None or not value.grad.any()]
    assert without == []


def test_the_doa_network_looks_at_one_range_bin_at_a_time():
    torch.manual_seed(0)
    network = DoaCnn(channels=9, bins=BINS, width=8).eval()
    data = torch.randn(1, 3, 10, 81)
    other = data.clone()
    other[:, :, 4] = torch.randn(3, 81)
    with torch.no_grad():
        changed = (network(other) != network(data)).any(dim=-1)[0, 0]
    assert changed.tolist() == [row == 4 for row in range(10)]


def test_the_doa_network_has_papageorgiou_s_layers():
    with torch.device("meta"):
        network = DoaCnn(channels=18, bins=450, width=256)
    dense = [layer.out_features for layer in network.dense if isinstance(layer, torch.nn.Linear)]
    assert dense == [4096, 2048, 1024, 450]
    assert network.dense[0].in_features == 5 * 5 * 256


def test_the_paper_s_network_has_its_size():
    with torch.device("meta"):
        network = AttentionUNet(5, 1, width=64)
    first = [next(layer.parameters()) for layer in network.encoder]
    assert [len(weights) for weights in first] == [64, 128, 256, 512]
    # 8.05 million in the notes of the published architecture's used part; here with a convolution after upsampling.
    assert 7e6 < sum(parameter.numel() for parameter in network.parameters()) < 9e6


def test_padding_and_cropping_leave_an_image_in_place():
    image = torch.randn(1, 1, 630, 450)
    padded = pad_to_multiple(image, 8)
    assert padded.shape == (1, 1, 632, 456)
    assert torch.equal(crop_like(padded, image), image)
    assert padded[..., 630:, :].abs().max() == 0


@pytest.mark.parametrize("name", ["attention", "spectral", "spectral, from an estimate"])
def test_a_shifted_input_shifts_the_output(name):
    """By a whole number of the coarsest level's pixels; in range, where both networks are convolutions."""
    network = networks()[name].eval().double()
    image = torch.zeros(1, 5, 150, BINS, dtype=torch.float64)
    image[:, :, 60:64] = torch.randn(1, 5, 4, BINS, dtype=torch.float64)
    with torch.no_grad():
        moved = network(image.roll(8, dims=2))
        answer = network(image)
    # Away from both ends, where the padding is seen.
    torch.testing.assert_close(moved[:, :, 50:102], answer[:, :, 42:94], rtol=0, atol=1e-12)
    assert (answer[:, :, 60:64] - answer[:, :, 52:56]).abs().max() > 1e-3


@pytest.mark.parametrize(("name", "tolerance"), [("attention", 0.15), ("spectral", 0.02)])
def test_bfloat16_stays_near_single_precision(name, tolerance):
    """Untrained, on white noise: batch normalisation lifts what cancels, and the rounding with it."""
    network = networks()[name].to(memory_format=torch.channels_last)
    data = torch.randn(4, 5, 64, BINS)
    with torch.no_grad():
        exact = network(data)
        with torch.autocast("cpu", torch.bfloat16):
            half = network(data).float()
    assert (half - exact).norm() < tolerance * exact.norm()
    assert not torch.equal(half, exact)


def test_the_answer_is_added_to_the_estimate_that_the_input_holds():
    torch.manual_seed(0)
    without = SpectralUNet(5, 1, BINS, width=4, hidden=8)
    beside = SpectralUNet(5, 1, BINS, width=4, hidden=8, start=3)
    beside.load_state_dict(without.state_dict())
    data = torch.randn(1, 5, 14, BINS)
    with torch.no_grad():
        torch.testing.assert_close(beside(data) - without(data), data[:, 3:4])


@pytest.mark.parametrize(
    ("changes", "inputs", "start"),
    [
        ({}, 5, 4),
        ({"target": "class"}, 5, None),
    ],
)
def test_only_an_answer_of_the_same_kind_starts_from_the_adaptive_spectrum(changes, inputs, start):
    network = build_network(tiny(model="spectral-unet", **changes), RADAR, CHANNELS)
    assert isinstance(network, SpectralUNet)
    assert network.context.inputs == inputs + 3
    assert network.start == start


def test_a_configuration_chooses_network_inputs_and_outputs():
    assert isinstance(build_network(tiny(), RADAR, CHANNELS), UnrolledNetwork)
    assert isinstance(build_network(tiny(model="spectral-unet"), RADAR, CHANNELS), SpectralUNet)
    changed = tiny(model="attention-unet", features="paper", target="class")
    network = build_network(changed, RADAR, CHANNELS)
    assert isinstance(network, AttentionUNet)
    assert network(torch.zeros(1, 5, 8, BINS)).shape == (1, 2, 8, BINS)


def test_arrays_that_are_not_those_of_the_signature_are_refused_in_tests():
    """tests/conftest.py holds every call of trainer.networks to its annotations."""
    network = networks()["spectral"]
    for wrong in (torch.zeros(1, 6, 8, BINS), torch.zeros(5, 8, BINS), torch.zeros(1, 5, 8, BINS, dtype=torch.int64)):
        with pytest.raises(TypeCheckError, match="features"):
            network(wrong)
