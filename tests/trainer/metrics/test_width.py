"""The point-spread function: the paper's arrays, windows, lines, edges, noise."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from paper_arrays import ARRAYS, RADAR, U, echoes

from shared.physics.errors import InputError
from shared.signal.windows import angle_window
from shared.signal.windows import point_spread as window_point_spread
from trainer.estimators.base import ESTIMATORS, LineArray
from trainer.metrics.width import point_spread

BINS = len(U)


def beam(array: LineArray, u_true: float, u: NDArray[np.float64] = U) -> NDArray[np.float64]:
    snapshot = echoes(array, np.array([[u_true]]), np.ones((1, 1), dtype=complex))
    return ESTIMATORS["das"]().image(snapshot, array, u, 0.0)[0]


@pytest.mark.parametrize(
    ("array", "bins", "sidelobe_db"), [("full", 9.5, -13.2), ("sparse6", 7.7, -5.4), ("sparse4", 6.9, -1.5)]
)
def test_point_spread_of_the_paper_arrays(array: str, bins: float, sidelobe_db: float) -> None:
    spread = point_spread(beam(ARRAYS[array], 0.1234), U)
    assert spread is not None
    assert spread.u == pytest.approx(0.1234, abs=2e-4)
    assert spread.level == pytest.approx(1.0, abs=2e-3)
    assert spread.width / RADAR.grid.step == pytest.approx(bins, abs=0.1)
    assert spread.pslr_db == pytest.approx(sidelobe_db, abs=0.15)


def test_point_spread_of_a_window() -> None:
    weights = angle_window("taylor-30", 256)
    line = LineArray(0.5 * np.arange(256.0), 1.0)
    u = np.linspace(-0.2, 0.2, 801)
    row = np.abs(line.manifold(u).T @ weights) / 256
    spread = point_spread(row, u)
    assert spread is not None
    width, sidelobe_db = window_point_spread(weights, 0.5)
    assert spread.width == pytest.approx(width, rel=0.01)
    assert spread.pslr_db == pytest.approx(sidelobe_db, abs=0.3)


def test_integrated_sidelobes_of_a_filled_line() -> None:
    # A sinc has 90.3 % of its energy between its first zeros: -9.7 dB beside it.
    line = LineArray(0.5 * np.arange(200.0), 1.0)
    spread = point_spread(beam(line, 0.0, np.linspace(-1.0, 1.0, 4001)), np.linspace(-1.0, 1.0, 4001))
    assert spread is not None
    assert spread.islr_db == pytest.approx(10.0 * np.log10(0.0972 / 0.9028), abs=0.1)


def test_point_spread_of_lines_edges_and_nothing() -> None:
    line = np.zeros(50)
    line[20] = 3e-20
    spread = point_spread(line, U[:50])
    assert spread is not None
    assert spread.u == pytest.approx(U[20])
    assert spread.width < 1.5 * RADAR.grid.step
    assert spread.pslr_db == spread.islr_db == -np.inf
    edge = point_spread(np.linspace(0.0, 1.0, 50), U[:50])
    assert edge is not None
    assert edge.width == np.inf
    assert point_spread(np.zeros(50), U[:50]) is None
    for bad in (np.full(50, -1.0), np.full(50, np.nan), np.ones(3)):
        with pytest.raises(InputError, match="spectrum"):
            point_spread(bad, U[: len(bad)])


def test_point_spread_of_white_noise_knows_no_main_lobe() -> None:
    rows = np.random.default_rng(3).random((200, BINS))
    spreads = [point_spread(row, U) for row in rows]
    assert all(spread is not None for spread in spreads)
    sidelobes = [spread.pslr_db for spread in spreads if spread is not None]
    # The next largest of 450 numbers is 1 - 2 / 451; the peak between samples is a little higher than its sample.
    assert -0.3 < np.mean(sidelobes) < 20.0 * np.log10(1.0 - 1.0 / 451)
    # The main lobe is three bins or so, of mean square 1 and some 1 / 3 for its neighbours; all others have 1 / 3.
    integrated = np.median([spread.islr_db for spread in spreads if spread is not None])
    assert integrated == pytest.approx(10.0 * np.log10(447 / 3 / (1 + 2 / 3)), abs=1.0)
