"""The windows against SciPy's, which the library does without because its import is dear."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import get_window

from shared.signal.windows import angle_window, hann

LENGTHS = (2, 3, 4, 5, 16, 63, 128, 450, 1024)


@pytest.mark.parametrize("length", LENGTHS)
def test_the_periodic_hann_window_is_scipys_to_the_last_bit(length):
    np.testing.assert_array_equal(hann(length), get_window("hann", length, fftbins=True))


@pytest.mark.parametrize("length", LENGTHS[1:])
@pytest.mark.parametrize(
    ("name", "window"), [("hann", "hann"), ("taylor-25", ("taylor", 4, 25)), ("taylor-30", ("taylor", 4, 30))]
)
def test_windows_over_the_elements_are_scipys_of_mean_one(name, window, length):
    expected = get_window(window, length, fftbins=False)
    np.testing.assert_allclose(angle_window(name, length), expected / expected.mean(), rtol=0.0, atol=4e-15)


def test_a_single_sample_has_weight_one_and_an_unknown_name_is_refused():
    assert hann(1).tolist() == angle_window("taylor-30", 2).tolist()[:1] == [1.0]
    with pytest.raises(ValueError, match="expected one of"):
        angle_window("taylor-35", 8)
