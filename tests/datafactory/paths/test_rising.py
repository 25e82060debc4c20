"""The order in which whole numbers rise is that of a stable sort."""

from __future__ import annotations

import numpy as np
import pytest

from datafactory.paths.rising import rising


@pytest.mark.parametrize("span", [1, 50, 8_191, 8_192, 8_193, 2**63 - 1])
@pytest.mark.parametrize("count", [2, 20_000])
def test_numbers_are_ordered_as_by_a_stable_sort(count, span):
    random = np.random.default_rng(span)
    numbers = random.integers(-(span // 2), span - span // 2, size=count)
    np.testing.assert_array_equal(rising(numbers), np.argsort(numbers, kind="stable"))


def test_of_no_numbers_there_is_no_order():
    assert rising(np.zeros(0, dtype=np.int64)).shape == (0,)
