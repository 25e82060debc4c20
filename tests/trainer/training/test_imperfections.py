"""Boards: each part against its slow reference, their model errors, and the same board for the same place."""

import numpy as np
import pytest
import torch
from pydantic import ValidationError

from shared.radar import Radar
from shared.radar.front_end import Converter, PhaseNoise
from shared.radar.receiver import digitised, with_phase_noise
from shared.radar.waveform import Waveform
from shared.signal.signal import manifold
from shared.signal.spectrum import range_doppler
from shared.signal.windows import hann
from trainer.run.configuration import CALIBRATED, FitConfig, Imperfections
from trainer.training.imperfections import Board, BoardErrors

RADAR = Radar()
ALL = np.arange(RADAR.array.channels)
SPARSE = RADAR.array.channel_indices((0, 1, 6, 10, 13, 15))
IDEAL = Imperfections(
    perfect=0.0, gain_db=(0, 0), phase_deg=(0, 0), delay_s=(0, 0), position_m=(0, 0), coupling_db=None, dead=0.0,
    leakage_db=None, bits=None, phase_noise=None, reported_db=0.0,
)  # fmt: skip
ROWS = 12


def boards(channels=SPARSE, radar=RADAR, **changes):
    return BoardErrors(IDEAL.model_copy(update=changes), radar, channels)


def draws(made, count=200):
    return [made.draw(np.random.default_rng(seed)) for seed in range(count)]


def snapshots(count=1, rows=ROWS, channels=RADAR.array.channels, seed=0):
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(count, rows, channels, dtype=torch.complex64, generator=generator)


def see(made, given, places=(0,), first_row=200.0, noise_power=1.0, seed=3, step=5):
    count = len(given)
    return made(seed, step, places, given, torch.full((count,), noise_power), np.full(count, first_row))


def test_a_perfect_board_and_one_without_errors_change_nothing():
    given = snapshots(3)
    seen, error = see(boards(perfect=1.0, gain_db=(1.0, 1.0)), given, range(3))
    assert torch.equal(seen, given)
    assert not error.any()
    seen, error = see(boards(), given, range(3))
    torch.testing.assert_close(seen, given, rtol=1e-5, atol=1e-5)
    assert error.max() < 1e-6


def test_gains_and_phases_have_their_root_mean_square_and_are_sums_of_tx_and_rx():
    made = boards(gain_db=(1.2, 1.2), phase_deg=(4.0, 4.0))
    factors = np.array([np.diag(board.matrix) for board in draws(made, 400)])
    gain_db, phase = 20 * np.log10(np.abs(factors)), np.rad2deg(np.angle(factors))
    assert np.sqrt(np.mean(gain_db**2)) == pytest.approx(1.2, rel=0.05)
    assert np.sqrt(np.mean(phase**2)) == pytest.approx(4.0, rel=0.05)
    for part in (gain_db, phase):
        tx, rx = part.reshape(400, 16, 3).mean(axis=1), part.reshape(400, 16, 3).mean(axis=2)
        both = rx[:, :, None] + tx[:, None, :] - part.mean(axis=1)[:, None, None]
        np.testing.assert_allclose(both, part.reshape(400, 16, 3), atol=1e-9)
        assert np.std(tx) > 0.4 * np.std(part) > 0.1 * np.std(rx)


def test_displaced_elements_see_the_phases_of_where_they_stand():
    """To 8 % of what the displacement changes: the operators leave 5 %, the phase's third order some more."""
    made = boards(position_m=(5e-5, 5e-5))
    y, wavelength = RADAR.array.virtual[:, 1], RADAR.waveform.wavelength_m
    u = np.linspace(-0.8, 0.8, 33)
    ideal = manifold(y, wavelength, u)
    found = np.array([board.matrix @ ideal for board in draws(made, 40)])
    expected = np.array([manifold(y + board.moved_m, wavelength, u) for board in draws(made, 40)])
    assert np.linalg.norm(found - expected) < 0.08 * np.linalg.norm(ideal - expected)
    moved_m = np.array([board.moved_m.reshape(16, 3) for board in draws(made)])
    # Each element's own is stated: an RX and a TX make root 2 of it.
    assert np.sqrt(np.mean(moved_m**2)) == pytest.approx(np.sqrt(2.0) * 5e-5, rel=0.05)


def test_coupling_adds_the_neighbours_of_each_line():
    board = draws(boards(coupling_db=(-20.0, -20.0)), 1)[0]
    x = snapshots(rows=1)[0, 0].numpy().reshape(16, 3)
    found = (board.matrix @ x.ravel()).reshape(16, 3)
    rx, tx = board.matrix[0, 3], board.matrix[0, 1]  # from RX 1 and the same TX, from TX 1 and the same RX
    assert abs(rx) == pytest.approx(0.1)
    assert abs(tx) == pytest.approx(0.1)
    expected = np.zeros_like(x)
    for r in range(16):
        for t in range(3):
            for other_r, c_r in ((r, 1.0), (r - 1, rx), (r + 1, rx)):
                for other_t, c_t in ((t, 1.0), (t - 1, tx), (t + 1, tx)):
                    if 0 <= other_r < 16 and 0 <= other_t < 3:
                        expected[r, t] += c_r * c_t * x[other_r, other_t]
    np.testing.assert_allclose(found, expected, rtol=1e-5)


def test_a_dead_receiver_is_silent_in_all_its_channels():
    made = boards(dead=0.3, leakage_db=(20.0, 20.0))
    silent = 0
    for place in range(40):
        seen = see(made, snapshots(), (place,), first_row=0.0)[0][0].numpy()
        energy = (np.abs(seen) ** 2).sum(axis=0).reshape(16, 3)
        dead = energy == 0
        assert (dead.all(axis=1) == dead.any(axis=1)).all()
        silent += int(dead[:, 0].sum())
    assert silent / 640 == pytest.approx(0.3, abs=0.06)


def test_delays_turn_each_row_by_its_beat_frequency_and_nothing_at_the_calibrated_range():
    made = boards(delay_s=(2e-9, 2e-9))
    board = draws(made, 1)[0]
    given = snapshots()[0]
    rows = 400.0 + np.arange(ROWS)
    seen = made._recorded(board, given, torch.tensor(1.0), rows).numpy()
    for row, (found, ideal) in zip(rows, zip(seen, given.numpy(), strict=True), strict=True):
        beat_hz = (row - board.calibrated_row) / RADAR.waveform.chirp_duration_s
        expected = [x * np.exp(-2j * np.pi * beat_hz * t) for x, t in zip(ideal, board.delay_s, strict=True)]
        np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-5)
    assert np.std(board.delay_s) == pytest.approx(2e-9, rel=0.5)
    there = made._turned(board, np.array([board.calibrated_row]))
    np.testing.assert_allclose(there, 1.0)
    assert 3.0 <= board.calibrated_row * RADAR.waveform.range_step_m <= 10.0


def test_leakage_stands_in_the_nearest_rows_alone():
    made = boards(leakage_db=(30.0, 30.0))
    quiet = torch.zeros(1, ROWS, 48, dtype=torch.complex64)
    near = see(made, quiet + 1e-12, first_row=0.0, noise_power=4.0)[0][0].numpy()
    near = np.mean(np.abs(near) ** 2, axis=1) / 4.0
    assert 10 * np.log10(near[0]) == pytest.approx(30.0, abs=0.01)
    assert 10 * np.log10(near[1]) == pytest.approx(24.0, abs=0.1)  # the Hann window's neighbour
    assert near[8:].max() < 1e-2
    far = see(made, quiet, first_row=300.0, noise_power=4.0)[0]
    assert far.abs().max() < 1e-3


def test_sidebands_are_those_of_the_receiver():
    """The mean power that one tone of the full chain gives to other rows, in its own Doppler cell."""
    noise = PhaseNoise(level_dbc_per_hz=-70.0)
    waveform = Waveform(chirps=8, samples=128, range_bins=100)
    radar = Radar(waveform=waveform)
    row = np.arange(40.0, 72.0)
    tone = np.zeros((8, 128, RADAR.array.channels), np.complex64)
    tone[:] = np.exp(2j * np.pi * 60 * np.arange(128) / 128)[:, None]
    window = hann(8)[:, None] / hann(8).sum()
    whole, short = [], []
    made = boards(radar=radar, phase_noise=noise)
    for seed in range(60):
        cube = with_phase_noise(tone, radar, noise, np.random.default_rng(seed))
        spectrum = np.fft.fft(cube[:, :, 0], axis=1) / 128  # no range window: a tone stands in one row
        whole.append(np.abs((window * spectrum).sum(axis=0)[40:72]) ** 2)
        given = torch.zeros(1, 32, 48, dtype=torch.complex64)
        given[0, 20] = 1.0
        board = draws(made, 1)[0]
        board = Board(**{**vars(board), "seed": seed})
        short.append(made._recorded(board, given[0], torch.tensor(0.0), row)[:, 0].abs().square().numpy())
    beside = np.arange(32) != 20
    levels = [np.mean(of, axis=0)[beside] for of in (short, whole)]
    assert 0.75 < np.mean(levels[0]) / np.mean(levels[1]) < 1.33
    # Near the tone it cancels, in both.
    assert levels[0][19:21].max() < 0.2 * levels[0].max()


def test_all_channels_share_the_sidebands():
    made = boards(phase_noise=PhaseNoise(level_dbc_per_hz=-60.0))
    given = torch.zeros(1, ROWS, 48, dtype=torch.complex64)
    given[0, 4] = snapshots(rows=1)[0, 0]
    seen = see(made, given)[0][0].numpy()
    np.testing.assert_allclose(np.linalg.matrix_rank(seen, tol=1e-6), 1)


def test_quantisation_is_the_noise_of_a_converter():
    """Against samples that are rounded: in a cell the power of Bennett's noise after both windows."""
    waveform = Waveform(chirps=16, samples=256, range_bins=200)
    radar = Radar(waveform=waveform)
    generator = np.random.default_rng(0)
    cycles = generator.uniform(10, 190, 6)
    time = np.arange(256) / 256
    chirp = np.exp(2j * np.pi * (cycles[:, None] * time + generator.random((6, 1)))).sum(axis=0) / np.sqrt(6)
    doppler = np.exp(2j * np.pi * generator.random(16))
    cube = (doppler[:, None, None] * chirp[None, :, None] * np.ones(48)).astype(np.complex64)
    full_scale = 4.0
    converter = Converter(bits=6, full_scale_dbm=float(10 * np.log10(full_scale**2) + 30))
    rounded = digitised(cube, converter)
    assert rounded.saturated == 0
    error = range_doppler(rounded.cube, radar) - range_doppler(cube, radar)
    expected = np.mean(np.abs(error) ** 2)
    made = boards(radar=radar, bits=6, headroom_db=0.0)
    assert made._quantisation * full_scale**2 == pytest.approx(expected, rel=0.2)
    given = torch.zeros(1, 200, 48, dtype=torch.complex64)
    given[0, 50] = full_scale
    seen = see(made, given)[0][0].numpy()
    assert np.mean(np.abs(seen[60:]) ** 2) == pytest.approx(made._quantisation * full_scale**2, rel=0.05)


@pytest.mark.parametrize("channels", [ALL, SPARSE])
def test_the_model_error_is_what_least_squares_leaves_of_a_plane_wave(channels):
    made = boards(channels, gain_db=(1.2, 1.2), phase_deg=(4.0, 4.0), coupling_db=(-30.0, -30.0))
    matrix = draws(made, 1)[0].matrix
    ratios = []
    for echo in made._echoes.T:
        found, ideal = (matrix @ echo)[channels], echo[channels][:, None]
        left = found - ideal @ np.linalg.lstsq(ideal, found)[0]
        ratios.append(np.sum(np.abs(left) ** 2) / np.sum(np.abs(found) ** 2))
    assert made.model_error(matrix) == pytest.approx(np.mean(ratios), rel=1e-6)


def test_calibrated_boards_leave_what_boards_leave():
    """Measured: -19 to -21 dB; ours, gains of 0.9 to 1.6 dB among them, somewhat more."""
    made = BoardErrors(CALIBRATED.model_copy(update={"dead": 0.0}), RADAR, ALL)
    error_db = [10 * np.log10(made.model_error(b.matrix)) for b in draws(made) if b is not None]
    assert -22.0 < np.mean(error_db) < -15.0


def test_a_board_is_a_function_of_seed_step_and_place():
    made = BoardErrors(CALIBRATED, RADAR, SPARSE)
    given = snapshots(4)
    seen, error = see(made, given, range(4))
    assert torch.isfinite(torch.view_as_real(seen)).all()
    again, error_again = see(made, given[2:], range(2, 4))
    assert torch.equal(seen[2:], again)
    assert torch.equal(error[2:], error_again)
    same = snapshots(1).repeat(4, 1, 1)
    distinct = {see(made, same, range(4), **changes)[0].numpy().tobytes() for changes in ({}, {"step": 6}, {"seed": 4})}
    assert len(distinct) == 3


@pytest.mark.parametrize("level", [0.0, 1e-25, 1e18])
def test_any_level_stays_finite_and_scales(level):
    made = BoardErrors(CALIBRATED.model_copy(update={"perfect": 0.0}), RADAR, SPARSE)
    seen, error = see(made, snapshots() * level, noise_power=0.0)
    assert torch.isfinite(torch.view_as_real(seen)).all()
    assert torch.isfinite(error).all()
    ideal = see(made, snapshots(), noise_power=0.0)[0]
    torch.testing.assert_close(seen / max(level, 1e-30), ideal if level else 0.0 * ideal, rtol=1e-3, atol=1e-3)


def test_names_and_refusals_of_a_configuration():
    assert FitConfig.model_validate({"imperfections": "calibrated"}).imperfections == CALIBRATED
    assert FitConfig.model_validate({"imperfections": "none"}).imperfections is None
    uncalibrated = CALIBRATED.model_copy(update={"phase_deg": (10.0, 14.0)})
    assert FitConfig.model_validate({"imperfections": "uncalibrated"}).imperfections == uncalibrated
    assert FitConfig.model_validate({"imperfections": {"dead": 0.5}}).imperfections == Imperfections(dead=0.5)
    for wrong, message in (
        ("some", "'some', expected one of none, calibrated, uncalibrated"),
        ({"gain_db": [2.0, 1.0]}, "2 to 1 does not rise"),
        ({"dead": 2.0}, "less than or equal to 1"),
        ({"gian_db": [0, 1]}, "Extra inputs"),
    ):
        with pytest.raises(ValidationError, match=message):
            FitConfig.model_validate({"imperfections": wrong})
    with pytest.raises(ValidationError, match="model 'doa-cnn' is trained on ideal boards alone"):
        FitConfig.model_validate(
            {"model": "doa-cnn", "features": "covariance", "target": "doa", "points": 0, "imperfections": "calibrated"}
        )
