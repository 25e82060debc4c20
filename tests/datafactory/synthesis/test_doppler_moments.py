"""The truth's vectorised loops, which paths a row sees and their moments, against one path after another."""

from math import comb

import numpy as np
import pytest

from datafactory.synthesis.doppler_moments import (
    BINOMIAL,
    BLOCK,
    CELLS_PER_BIN,
    CURVATURE_STEP,
    DELTA_STEP,
    SHIFT_TERMS,
    Frame,
    add_doppler_moments,
)
from datafactory.synthesis.expansions import doppler_table
from datafactory.synthesis.mid_frame import DOPPLER_REACH, LEVELS, NEGLECTED, ROW_REACH, MidFrame, seen_paths
from shared.radar import Radar
from shared.radar.waveform import Waveform

LIGHT_MPS = 299_792_458.0
REFERENCE_HZ, BANDWIDTH_HZ, KAPPA, CHIRPS, FRAME_S = 77e9, 1e9, 1e9 / 77e9, 128.0, 128 * 80.6e-6
CELLS, CENTRE, FREQUENCY = 512, np.array([0.01, 0.2, -0.03]), -11.0
ROUNDING = 2e-6
"""Of float32, relative to the largest moment: some tens of operations of 6e-8 each."""


def elements() -> np.ndarray:
    """[BLOCK, 3] from their centre [m], in no line."""
    places = np.random.default_rng(1).uniform(-0.004, 0.004, (BLOCK, 3))
    places[:, 1] += np.linspace(-0.03, 0.03, BLOCK)
    return places


def paths(count: int, nearest_m: float):
    """Near the Doppler cell: points, velocities, TX legs, their rates, curvatures [cycles], amplitudes."""
    generator = np.random.default_rng(2)
    point = generator.normal(size=(count, 3))
    point *= generator.uniform(nearest_m, 60.0, (count, 1)) / np.linalg.norm(point, axis=1, keepdims=True)
    velocity = generator.uniform(-3.0, 3.0, (count, 3))
    away = point - CENTRE
    rate = (away * velocity).sum(axis=1) / np.linalg.norm(away, axis=1)
    wanted = (FREQUENCY + generator.uniform(-7.0, 7.0, count)) * LIGHT_MPS / REFERENCE_HZ / FRAME_S
    amplitude = generator.normal(size=(count, 2)) @ [1.0, 1j]
    return (
        point,
        velocity,
        generator.uniform(1.0, 60.0, count),
        wanted - rate,
        generator.uniform(-1, 1, count),
        amplitude,
    )


def seen(drawn) -> MidFrame:
    """Drawn paths; what the kernel does not read of them is 0."""
    point, velocity, tx_length, tx_rate, curvature, amplitude = drawn
    none = np.zeros(len(amplitude))
    return MidFrame(point, velocity, tx_length, tx_rate, curvature, none, none, amplitude, none, none)


def reference(table, terms, by_element, needed, lead, drawn, nu) -> np.ndarray:
    """[CELLS, terms, SHIFT_TERMS, BLOCK] by the equations of the module, every element by itself."""
    lowest_q, lowest_delta, responses = table
    grid = np.zeros((CELLS, responses.shape[2], SHIFT_TERMS, BLOCK), dtype=np.complex128)
    per_metre, bins = REFERENCE_HZ / LIGHT_MPS, BANDWIDTH_HZ / LIGHT_MPS
    places = np.concatenate([np.zeros((1, 3)), elements()]) + CENTRE
    for count, own, *path in zip(terms, by_element, *drawn, strict=True):
        point, velocity, tx_length, tx_rate, curvature, amplitude = path
        leg = np.linalg.norm(point - places, axis=1)
        rate = ((point - places) * velocity).sum(axis=1) / leg
        total = per_metre * FRAME_S * (tx_rate + rate)
        ranged = bins * (tx_length + leg + lead * (tx_rate + rate))
        cell = int(np.floor(ranged[0] * CELLS_PER_BIN + 0.5))
        scaled = (1.0 + KAPPA * nu) * total
        delta = scaled[0] - FREQUENCY
        delta -= CHIRPS * np.floor(delta / CHIRPS + 0.5)
        node = int(np.floor((delta - lowest_delta) / DELTA_STEP + 0.5))
        if not needed[cell % CELLS]:
            continue
        departure = scaled[1:] - (scaled[0] - delta + lowest_delta + node * DELTA_STEP)
        away = np.floor(departure / DELTA_STEP + 0.5).astype(int) if own else np.zeros(BLOCK, dtype=int)
        departure -= away * DELTA_STEP
        inside = (node + away >= 0) & (node + away < responses.shape[1])
        curved = responses[int(np.floor(curvature / CURVATURE_STEP + 0.5)) - lowest_q]
        response = np.where(inside, curved[np.where(inside, node + away, 0)].T, 0.0)
        shift = ranged[1:] - cell / CELLS_PER_BIN
        echo = amplitude * np.exp(2j * np.pi * per_metre * (tx_length + leg[1:]))
        for j in range(count):
            polynomial = sum(comb(e, j) * response[e] * departure ** (e - j) for e in range(j, count))
            for p in range(SHIFT_TERMS):
                grid[cell % CELLS, j, p] += (KAPPA * total[0]) ** j * polynomial * echo * shift**p
    return grid


@pytest.mark.parametrize(
    ("lead", "nearest_m", "nu"), [(0.0, 0.3, 0.0), (40e-6, 0.3, 0.0), (0.0, 5.0, 0.0), (0.0, 5.0, 0.375)]
)
@pytest.mark.parametrize("most", [1, 9])
@pytest.mark.parametrize("share", [0.0, 0.5])
def test_moments_are_those_of_the_equations(share, most, lead, nearest_m, nu):
    drawn = paths(40, nearest_m)
    terms = np.random.default_rng(3).integers(1, most + 1, 40)
    terms[0] = most
    table = doppler_table(drawn[4], int(CHIRPS), most)
    needed = np.random.default_rng(4).random(CELLS) < 0.8
    grid = np.zeros((CELLS, most * SHIFT_TERMS * 2 * BLOCK), dtype=np.float32)
    frame = Frame(FREQUENCY, nu, CHIRPS, FRAME_S, REFERENCE_HZ, BANDWIDTH_HZ, lead, KAPPA)
    by_element, block = np.random.default_rng(5).random(40) < share, (elements(), CENTRE)
    add_doppler_moments(seen(drawn), terms, by_element, block, frame, needed, table, BINOMIAL, grid)
    made = grid.reshape(CELLS, most, SHIFT_TERMS, 2, BLOCK)
    expected = reference(table, terms, by_element, needed, lead, drawn, nu)
    assert np.abs(made[..., 0, :] + 1j * made[..., 1, :] - expected).max() < ROUNDING * np.abs(expected).max()
    assert np.abs(expected).max() > 0.0


def test_paths_outside_the_table_and_the_cells_add_nothing():
    drawn = paths(20, 5.0)
    table = doppler_table(drawn[4], int(CHIRPS), 2)
    grid = np.zeros((CELLS, 2 * SHIFT_TERMS * 2 * BLOCK), dtype=np.float32)
    for frequency, needed in ((FREQUENCY + 64.0, np.ones(CELLS, bool)), (FREQUENCY, np.zeros(CELLS, bool))):
        frame = Frame(frequency, 0.0, CHIRPS, FRAME_S, REFERENCE_HZ, BANDWIDTH_HZ, 0.0, KAPPA)
        add_doppler_moments(
            seen(drawn), np.full(20, 2), np.zeros(20, bool), (elements(), CENTRE), frame, needed, table, BINOMIAL, grid
        )
    assert not grid.any()


def mid_frame(generator: np.random.Generator, count: int, waveform: Waveform, spread_db: float) -> MidFrame:
    """Paths anywhere on both axes, beyond their ends too, in the order of their folded range."""
    range_bins = generator.uniform(0.0, 1.5 * waveform.samples, count)
    range_bins = range_bins[np.argsort(range_bins % waveform.samples, kind="stable")]
    amplitude = 10.0 ** (generator.uniform(-spread_db, 0.0, count) / 20.0)
    amplitude[::17] = 0.0
    vectors, none = np.ones((count, 3)), np.zeros(count)
    return MidFrame(
        rx_point=vectors, rx_velocity=vectors, tx_length=none, tx_rate=none,
        curvature=generator.uniform(-0.5, 0.5, count), doppler=generator.uniform(-100.0, 100.0, count),
        range_bins=range_bins, amplitude=amplitude.astype(np.complex128), spread=generator.uniform(0.0, 0.3, count),
        migration=generator.uniform(0.0, 6.0, count),
    )  # fmt: skip


def hann_power(bins: float) -> float:
    """As the module says it, by NumPy's cosine."""
    if bins < 1.5:
        return float(np.cos(0.25 * np.pi * bins) ** 4)
    return float(1.0 / (np.pi * bins * (bins * bins - 1.0)) ** 2)


def one_after_another(mid: MidFrame, smeared: np.ndarray, waveform: Waveform, cells: np.ndarray) -> np.ndarray:
    """[chirps, paths]"""
    samples, chirps = waveform.samples, waveform.chirps
    seen = np.zeros((chirps, len(mid.amplitude)), dtype=bool)
    for row, cell in enumerate(cells):
        part = np.zeros(len(mid.amplitude))
        for k in range(len(part)):
            offset = abs((mid.range_bins[k] - row + samples / 2) % samples - samples / 2)
            delta = abs((mid.doppler[k] - (cell - chirps // 2) + chirps / 2) % chirps - chirps / 2)
            if offset <= min(ROW_REACH + smeared.max(initial=0.0), samples / 2) and delta <= DOPPLER_REACH + smeared[k]:
                slack = mid.departure[k] + abs(mid.curvature[k])
                away = max(offset - smeared[k], 0.0), max(delta - slack, 0.0)
                part[k] = abs(mid.amplitude[k]) ** 2 * hann_power(away[0]) * hann_power(away[1])
        if not part.any():
            continue
        lit = np.flatnonzero(part)
        level = np.full(len(part), -1)
        level[lit] = np.minimum((10.0 * np.log10(part.sum() / part[lit])).astype(int), LEVELS - 1)
        held = np.bincount(level[lit], part[lit], LEVELS)
        least, left_out = LEVELS, 0.0
        while least > 1 and left_out + held[least - 1] <= NEGLECTED * part.sum():
            least -= 1
            left_out += held[least]
        seen[cell, lit[level[lit] < least]] = True
    return seen


@pytest.mark.parametrize(("samples", "count"), [(64, 300), (16, 60), (64, 1), (64, 0)])
@pytest.mark.parametrize(("spread_db", "most_bins"), [(20.0, 0.0), (120.0, 0.0), (120.0, 6.0)])
def test_the_same_paths_are_seen(samples, count, spread_db, most_bins):
    generator = np.random.default_rng(8)
    radar = Radar(waveform=Waveform(samples=samples, range_bins=samples * 3 // 4, chirps=32))
    mid = mid_frame(generator, count, radar.waveform, spread_db)
    cells = generator.integers(0, 32, radar.waveform.range_bins)
    smeared = np.maximum(generator.uniform(-most_bins, most_bins, count), 0.0)
    expected = one_after_another(mid, smeared, radar.waveform, cells)
    np.testing.assert_array_equal(seen_paths(mid, smeared, radar, cells), expected)
    assert count < 60 or expected.sum() > 0
