"""What a line must pass: the parts of the count of lines in noise, each against drawn noise."""

from __future__ import annotations

import numpy as np
import pytest
from paper_arrays import ARRAYS
from scipy.special import gammaincc

from shared.radar import Radar
from trainer.data.cfar import CELL_FALSE_ALARM, cfar_thresholds
from trainer.estimators.array import uniform_axis
from trainer.run import false_alarms

RADAR = Radar()


@pytest.mark.parametrize("name", ARRAYS)
def test_of_a_row_the_highest_maximum_is_counted_once(name: str) -> None:
    """Rice's count times kappa is how often the largest of all angles passes."""
    array, level, rows = ARRAYS[name], 8.0, 40_000
    draw = np.random.default_rng(3)
    x = draw.standard_normal((rows, array.channels, 2)) @ np.array([1.0, 1.0j]) / np.sqrt(2.0)
    highest = np.max(np.abs(x @ array.manifold(uniform_axis(array, 8)).conj()) ** 2, axis=1) / array.channels
    beyond, share = np.polynomial.laguerre.laggauss(16)
    kappa = false_alarms._highest(level + beyond, np.ones(16), false_alarms._lobes(array)) @ share
    slope = 2.0 * np.pi / array.wavelength_m * np.std(array.positions_m) * 2.0 * array.half_period
    said = kappa * slope * np.sqrt(level / np.pi) * np.exp(-level)
    # 1500 or more pass: a standard error of 3 % at most. Rice's count is 5 % too high at such a level.
    assert np.mean(highest > level) == pytest.approx(said, rel=0.15)


def test_thresholds_of_cells_are_those_of_drawn_noise() -> None:
    draw, cells, channels = np.random.default_rng(4), 128, 48
    tau, likely = false_alarms.strongest_of(cells, channels)
    largest = draw.gamma(channels, size=(20_000, cells - 1)).max(axis=1)
    assert likely.sum() == pytest.approx(1.0)
    assert likely @ tau == pytest.approx(largest.mean(), rel=2e-3)
    assert likely @ gammaincc(channels, tau) == pytest.approx(1.0 / cells, rel=1e-2)
    tau, likely = cfar_thresholds((630, cells), channels)
    assert likely @ gammaincc(channels, tau) == pytest.approx(CELL_FALSE_ALARM, rel=1e-3)


def test_a_group_of_three_bins_has_the_slopes_of_its_response() -> None:
    """lambda is 1 - |correlation|^2 of two responses near each other, over their distance squared."""
    offsets, step = np.array([0.0, 0.4, -1.3]), 1e-3
    bins = np.array([-1, 0, 1])[:, None]
    near, far = (
        false_alarms.whitening(bins[:, 0]) @ false_alarms.hann_response(bins - offsets - sign * step)
        for sign in (-0.5, 0.5)
    )
    correlation = np.sum(near * far, axis=0) / np.linalg.norm(near, axis=0) / np.linalg.norm(far, axis=0)
    slope, own = false_alarms._group(offsets)
    np.testing.assert_allclose(slope, np.sqrt(1.0 - correlation**2) / step, rtol=1e-3)
    # Three bins hold 0.8 dB more of a target at the middle one's centre than that alone.
    assert -10.0 * np.log10(own[0]) == pytest.approx(0.8, abs=0.05)


def test_fewer_lines_need_more_and_any_radar_will_do() -> None:
    for every_cell in (False, True):
        levels = [
            false_alarms.first_line_threshold(lines, RADAR, ARRAYS["sparse4"], every_cell)
            for lines in (1e-3, 1.0, 10.0, 1e9)
        ]
        assert (np.diff(levels) < 0.0).all()
        assert levels[-1] == false_alarms.LEAST
    one_chirp = RADAR.model_copy(update={"waveform": RADAR.waveform.model_copy(update={"chirps": 1})})
    assert 10.0 < false_alarms.first_line_threshold(1.0, one_chirp, ARRAYS["full"], False) < 20.0
