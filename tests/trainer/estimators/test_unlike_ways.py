"""What an echo of unlike ways explains more: against a search over all pairs of angles, and of echoes of known ways."""

import numpy as np
import pytest
from numpy.typing import NDArray
from paper_arrays import ARRAYS, RADAR

from shared.physics.units import power_to_db
from shared.radar import Radar, load_radar
from trainer.estimators.array import LineArray, line_array
from trainer.estimators.unlike_ways import unlike_ways_db

Directions = float | NDArray[np.float64]
WAYS = ((-0.6, 0.3), (0.05, -0.2), (0.8, -0.75))


def echo(radar: Radar, array: LineArray, leaving: Directions, arriving: Directions) -> NDArray[np.complex128]:
    """[C] by the places of each channel's TX and RX; [L, A, C] of L directions left in and A arrived from."""
    assert array.elements is not None
    places = (radar.array.tx[array.elements[0], 1], radar.array.rx[array.elements[1], 1])
    turns = zip((leaving, arriving), places, strict=True)
    out, back = (np.exp(-2j * np.pi / array.wavelength_m * np.multiply.outer(u, place)) for u, place in turns)
    return out * back if np.ndim(leaving) == 0 else out[:, None] * back


@pytest.mark.parametrize("name", ["sparse6", "sparse4", "full"])
def test_the_search_in_two_steps_finds_what_one_over_all_pairs_finds(name: str) -> None:
    """Of one or two echoes with noise: never more, and at most 0.5 dB less of what a grid of all pairs finds."""
    array, generator = ARRAYS[name], np.random.default_rng(4)
    drawn = [
        sum(echo(RADAR, array, *generator.uniform(-0.8, 0.8, 2)) for _ in range(1 + k % 2))
        + 0.1 * generator.standard_normal((2, array.channels)).T @ (1.0, 1.0j)
        for k in range(24)
    ]
    grid = np.linspace(-1.0, 1.0, 401)
    every = echo(RADAR, array, grid, grid)
    for cell, found in zip(drawn, unlike_ways_db(np.array(drawn), array), strict=True):
        power = np.abs(every.conj() @ cell) ** 2
        expected = float(power_to_db(power.max() / np.diagonal(power).max()))
        assert expected - 0.5 < found < expected + 0.2


@pytest.mark.parametrize(
    ("name", "least_db"), [("sparse6", 1.9), ("sparse4", 1.3), ("full", 1.9), ("mmwcas-azimuth", 3.0)]
)
def test_an_echo_off_two_walls_is_told_from_a_target(name: str, least_db: float) -> None:
    """Three TX half a wavelength apart tell less than nine."""
    radar = RADAR if name in ARRAYS else load_radar(name)
    array = ARRAYS[name] if name in ARRAYS else line_array(radar)
    alike = np.stack([echo(radar, array, u, u) for u in np.linspace(-0.8, 0.8, 33)])
    assert unlike_ways_db(alike, array).max() < 0.1
    assert unlike_ways_db(np.stack([echo(radar, array, *ways) for ways in WAYS]), array).min() > least_db


def test_tx_two_wavelengths_apart_have_equal_phases_in_directions_a_period_apart() -> None:
    radar = load_radar("mmwcas-azimuth")
    array = line_array(radar)
    assert unlike_ways_db(echo(radar, array, 0.0, 0.4946)[None], array)[0] < 0.1


def test_one_tx_or_one_rx_or_unknown_ones_tell_nothing() -> None:
    cells = np.random.default_rng(1).standard_normal((5, 4)) + 0j
    places = 1.9e-3 * np.arange(4.0)
    for elements in (None, np.stack([np.zeros(4, int), np.arange(4)]), np.stack([np.arange(4), np.zeros(4, int)])):
        assert not unlike_ways_db(cells, LineArray(places, 3.9e-3, None, elements)).any()
    assert len(unlike_ways_db(np.zeros((0, 48), complex), ARRAYS["full"])) == 0
    assert not unlike_ways_db(np.zeros((2, 48), complex), ARRAYS["full"]).any()
