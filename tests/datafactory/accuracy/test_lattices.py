"""How many rays two lattices need for the same error."""

from __future__ import annotations

import numpy as np
import pytest

from datafactory.accuracy import lattices


def test_rays_of_equal_error_are_interpolated():
    counts = (1000, 10_000, 100_000)
    law = [-10.0 * np.log10(count) for count in counts]
    assert lattices.rays_for(-35.0, counts, law) == pytest.approx(10.0**3.5)
    assert lattices.rays_for(law[0] + 1.0, counts, law) is None
    assert lattices.rays_for(law[-1] - 1.0, counts, law) is None
    # Where chance lets an error rise, the smaller one before it holds.
    assert lattices.rays_for(-32.0, counts, (-30.0, -40.0, -39.0)) == pytest.approx(10.0**3.2)


def test_the_lattices_are_compared_in_words(rows):
    lines = lattices.lines(rows)
    assert len(lines) == 2
    assert all(("times fewer" in line) or ("no error that both" in line) for line in lines)
    assert lattices.lines([row for row in rows if row.knob != "sphere rays"]) == []
