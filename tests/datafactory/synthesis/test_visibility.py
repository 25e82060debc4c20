"""Which paths a row sees: the vectorised loops against one row and one path after another."""

from __future__ import annotations

import numpy as np
import pytest

from datafactory.synthesis.mid_frame import MidFrame
from datafactory.synthesis.visibility import DOPPLER_REACH, LEVELS, NEGLECTED, ROW_REACH, seen_paths
from shared.radar import Radar
from shared.radar.waveform import Waveform


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
        range_bins=range_bins, amplitude=amplitude.astype(np.complex128), departure=generator.uniform(0.0, 0.5, count),
    )  # fmt: skip


def hann_power(bins: float) -> float:
    """As the module says it, by NumPy's cosine."""
    if bins < 1.5:
        return float(np.cos(0.25 * np.pi * bins) ** 4)
    return float(1.0 / (np.pi * bins * (bins * bins - 1.0)) ** 2)


def one_after_another(mid: MidFrame, waveform: Waveform, cells: np.ndarray) -> np.ndarray:
    """[chirps, paths]"""
    samples, chirps = waveform.samples, waveform.chirps
    seen = np.zeros((chirps, len(mid.amplitude)), dtype=bool)
    for row, cell in enumerate(cells):
        part = np.zeros(len(mid.amplitude))
        for k in range(len(part)):
            offset = abs((mid.range_bins[k] - row + samples / 2) % samples - samples / 2)
            delta = abs((mid.doppler[k] - (cell - chirps // 2) + chirps / 2) % chirps - chirps / 2)
            if offset <= min(ROW_REACH, samples / 2) and delta <= DOPPLER_REACH:
                slack = mid.departure[k] + abs(mid.curvature[k])
                part[k] = abs(mid.amplitude[k]) ** 2 * hann_power(offset) * hann_power(max(delta - slack, 0.0))
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
@pytest.mark.parametrize("spread_db", [20.0, 120.0])
def test_the_same_paths_are_seen(samples, count, spread_db):
    generator = np.random.default_rng(8)
    radar = Radar(waveform=Waveform(samples=samples, range_bins=samples * 3 // 4, chirps=32))
    mid = mid_frame(generator, count, radar.waveform, spread_db)
    cells = generator.integers(0, 32, radar.waveform.range_bins)
    expected = one_after_another(mid, radar.waveform, cells)
    np.testing.assert_array_equal(seen_paths(mid, radar, cells), expected)
    assert count < 60 or expected.sum() > 0
