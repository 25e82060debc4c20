"""Run as a script: digests of what kernels make of seeded numbers, for tests that compare processes with each other.

    python tests/kernel_bytes.py [--inner-first] [NAME ...]

``--inner-first`` compiles inlined functions by themselves before the kernels that they are a part of.
"""

import hashlib
import sys
from collections.abc import Callable, Iterable

import numpy as np
from numba import types
from numpy.typing import NDArray

from datafactory.paths import cells, corner_aperture, facets, geometry
from datafactory.paths.planes import Rim
from datafactory.synthesis import doppler_moments, frame_lines, lines, lines_at_centres, mid_frame, spread
from shared.physics.vectors import aligned
from shared.signal import near_field_kernels
from trainer.estimators.array import LineArray
from trainer.estimators.fitting import GroupTest, RangePlace, fit_groups, fit_lines

Arrays = Iterable[NDArray]
PATHS, CENTRE, CHIRP_S = 400, np.zeros(3), 80e-6
REFERENCE_HZ, BANDWIDTH_HZ = 77.5e9, 1e9
SWEEP = REFERENCE_HZ, BANDWIDTH_HZ, BANDWIDTH_HZ / CHIRP_S, 1.0


def numbers(seed: int = 1) -> np.random.Generator:
    return np.random.default_rng(seed)


def table() -> NDArray[np.float64]:
    """[16, PATHS] of :func:`datafactory.synthesis.spread.columns`."""
    draw = numbers()
    point = draw.uniform(-30.0, 30.0, (3, PATHS)) + np.array([[33.0], [0.0], [0.0]])
    other = point + draw.uniform(-0.5, 0.5, (3, PATHS))
    rates, amplitude = draw.uniform(-10.0, 10.0, (7, PATHS)), draw.standard_normal((2, PATHS))
    return np.concatenate([point, other, draw.uniform(0.0, 3.0, (1, PATHS)), rates, amplitude])


def elements() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Three TX [3, 3] and 32 RX [3, 32]."""
    return numbers(2).uniform(-0.05, 0.05, (3, 3)), spread.padded(numbers(3).uniform(-0.05, 0.05, (20, 3)))


def chirp() -> Arrays:
    """The exact kernel, phases and ranges at one time and at two."""
    cells, terms, (tx, rx) = 256, 4, elements()
    for beat_s in (1e-3, 2e-3):
        moments = spread.empty_moments(cells, 3, 20, terms, np.float32)
        moments[:] = 0.0
        used, grid = np.zeros(cells, dtype=bool), np.zeros((cells, 20, 3), dtype=np.complex64)
        sweep = spread.Sweep(*SWEEP, 2, cells, 1e-2, 1e-3, beat_s, 0.0)
        spread.add_moments(table(), spread.Sensor(tx, rx, CENTRE, CENTRE, 0), sweep, (0,) * terms, moments, used)
        weights = numbers(4).standard_normal((5, terms)).astype(np.float32)
        spread.add_to_grid(moments, used, weights, (0,) * terms, np.complex64(1.0), grid)
        yield moments
        yield grid


def along_lines() -> Arrays:
    """Paths along Doppler lines with all three separable terms, and the sums over the lines."""
    draw, (tx, rx), node = numbers(5), elements(), np.linspace(-0.5, 0.5, 16)
    cells, taps, terms, powers, line_taps = 128, 5, 4, 10, 8
    grid = aligned((40, 3 * rx.shape[1] // spread.LANES, cells + taps - 1, 2, spread.LANES), np.float32)
    grid.fill(0.0)
    paths = lines_at_centres.Paths(
        table(), draw.uniform(-10.0, 10.0, PATHS), draw.integers(0, 40 - line_taps, PATHS),
        draw.uniform(-0.1, 0.1, (6, PATHS)),
    )  # fmt: skip
    weights = lines_at_centres.Weights(
        node, draw.standard_normal((line_taps * powers * 2, 2 * len(node))),
        draw.standard_normal((taps, terms)).astype(np.float32),
    )  # fmt: skip
    forms = lines.Forms(taps, terms, 3, powers, lines_at_centres.CLOSE_PARTS)
    sweep = spread.Sweep(*SWEEP, 1.5, cells, 1e-2, 5e-3, 6e-3, BANDWIDTH_HZ / REFERENCE_HZ)
    lines.add_lines(paths, spread.Sensor(tx, rx, CENTRE, CENTRE, 0), sweep, weights, forms, grid)
    yield grid
    rows = np.empty((8, 2, 65, 30), dtype=np.float32)
    frequency, scale = draw.uniform(-60.0, 60.0, 30), draw.uniform(0.99, 1.01, 8)
    frame_lines.fill_lines(frequency, scale, 128, 9.0, 7, 1.5, rows)
    yield rows


def truth() -> Arrays:
    """The truth's loop for every number of Doppler terms that has code of its own."""
    cells, block, shifts = 64, doppler_moments.BLOCK, doppler_moments.SHIFT_TERMS
    places = np.zeros((block, 3))
    places[:, 1] = 0.002 * np.arange(block)
    none = np.zeros(PATHS)
    for count in range(1, 8):
        draw = numbers(count)
        amplitude = draw.standard_normal((PATHS, 2)) @ [1.0, 1j]
        response = draw.standard_normal((5, 200, count)) + 1j * draw.standard_normal((5, 200, count))
        grid = np.zeros((cells, count * shifts * 2 * block), dtype=np.float32)
        doppler_moments.add_doppler_moments(
            mid_frame.MidFrame(
                draw.uniform((10.0, -10.0, -10.0), (30.0, 10.0, 10.0), (PATHS, 3)),
                draw.uniform(-3.0, 3.0, (PATHS, 3)), draw.uniform(5.0, 20.0, PATHS), draw.uniform(-3.0, 3.0, PATHS),
                draw.uniform(-0.05, 0.05, PATHS), none, none, amplitude, none, none,
            ),
            np.full(PATHS, count), np.arange(PATHS) % 5 == 0, (places, CENTRE),
            doppler_moments.Frame(3.0, 0.0, 128.0, 0.01, REFERENCE_HZ, BANDWIDTH_HZ, 1e-5, 0.013),
            np.ones(cells, dtype=bool), (-2, -6.0, response), doppler_moments.BINOMIAL, grid,
        )  # fmt: skip
        yield grid


def seen() -> Arrays:
    """What image rows see of paths."""
    draw, count = numbers(6), 20_000
    bins, power = np.sort(draw.uniform(0.0, 1024.0, count)), 10.0 ** draw.uniform(-9.0, 0.0, count)
    doppler, slack, rows = draw.uniform(-100.0, 100.0, count), draw.uniform(0.0, 1.0, count), draw.integers(0, 128, 630)
    result = np.zeros((128, count), dtype=bool)
    mid_frame._mark_seen(bins, doppler, slack, np.zeros(count), power, rows, 12.0, 1024.0, result)
    yield result


def near_field() -> Arrays:
    """A row's matrix, whole and folded."""
    rx, u = numbers(7).uniform(-0.2, 0.2, (64, 3)), np.linspace(0.0, 0.8, 225)
    pairs = near_field_kernels.Pairs(np.zeros((1, 3)), rx, np.zeros(64, dtype=np.int64), np.arange(64))
    row = near_field_kernels.Row(134.0, 20.0, u, REFERENCE_HZ / 3e8, BANDWIDTH_HZ / 3e8, np.float32(1.0 / 64.0))
    whole, even, odd = np.empty((3, 3, 64, 2, len(u)), dtype=np.float32)
    near_field_kernels.fill_matrix(pairs, row, whole)
    near_field_kernels.fill_folded(pairs, row, even, odd)
    yield from (whole, even, odd)


def plates() -> Arrays:
    """Shares of mirrors, lines of sight, apertures of corners, and thinning: without fast-math flags."""
    draw = numbers(8)
    points, along, across = draw.uniform(-3.0, 3.0, (3, 1000, 3))
    rim = Rim.of(draw.uniform(-3.0, 3.0, (80, 3)), np.arange(80).reshape(40, 2))
    up, of_one = np.array([[0.0, 0.0, 1.0]]), np.zeros(1000, dtype=np.int64)
    yield facets._mirror_shares(
        rim, np.tile([0, len(rim.radius)], (1000, 1)), points, along, up, of_one, np.abs(across[:, 0])
    )
    yield from geometry._lines(points, 20.0 * across)
    corner, away = np.arange(1000) % 50, np.ascontiguousarray(along[:, 0])
    place, bend = (corner, away, np.abs(across)), tuple(draw.uniform(0.1, 1.0, (3, 1000)))
    edge, face = (points[:50], along[:50]), (across[:50], points[50:100])
    for first in (True, False):
        yield corner_aperture._points_before_faces(np.arange(3000), first, place, bend, edge, face)
    yield cells._factors(np.arange(1000), np.arange(0, 1001, 50), np.abs(away), 20, draw.random(20))


def line_fit() -> Arrays:
    """Two lines in noise, row by row and in groups of three range bins."""
    draw, array = numbers(9), LineArray(np.array([0.0, 2.0, 5.0, 9.0, 14.0, 20.0]) * 2e-3, 3.9e-3)
    noise = draw.standard_normal((60, 3, 6, 2)) @ [1.0, 1j]
    phases = np.exp(2j * np.pi * draw.random((60, 1, 2)))
    echoes = 10.0 * phases @ array.manifold(draw.uniform(-0.8, 0.8, 2)).T
    cells, none = noise + echoes, np.empty((60, 0))
    rows = fit_lines(cells[:, 1], array, 2.0, none)
    place = RangePlace(np.full(60, 10.0), 0.05)
    groups = fit_groups(cells, np.array([-1, 0, 1]), array, place, none, GroupTest(2.0, -30.0, 1e-3, 1e-3))
    for found in (rows, groups):
        yield found.amplitude
        yield np.nan_to_num(found.u)


KERNELS: dict[str, Callable[[], Arrays]] = {
    kernel.__name__: kernel for kernel in (chirp, along_lines, truth, seen, near_field, plates, line_fit)
}


def inner_first() -> None:
    """Compile a function that is a part of :func:`truth` by itself, with the types that it has there."""
    line = types.float32[::1]
    for count in range(1, 6):
        orders = types.UniTuple(types.literal(0), count)
        doppler_moments._add_terms.compile((line, line, types.int64, orders, line))


if __name__ == "__main__":
    names = [argument for argument in sys.argv[1:] if argument != "--inner-first"]
    if len(names) < len(sys.argv) - 1:
        inner_first()
    for name in names or KERNELS:
        digest = hashlib.sha256()
        for array in KERNELS[name]():
            assert array.any()
            digest.update(np.ascontiguousarray(array).tobytes())
        print(name, digest.hexdigest())
