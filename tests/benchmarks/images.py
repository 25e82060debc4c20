"""The truth image against the exact matched filter, its moments against the virtual cube."""

import numpy as np
from numpy.typing import NDArray
from oracles import matched_filter_row, peak_error_db
from record import DB_OF_PEAK, Record, Timing, timed
from workloads import SEED, Workload

from datafactory.defaults import IMAGE_BATCH
from datafactory.paths.table import PathTable, ScatteredPaths
from datafactory.synthesis.cube import cube_of_paths
from shared.radar import Radar
from shared.signal.imaging import DEFAULT_TERMS, near_field_images, sweep_moments

RANGES_M = (3.0, 5.7, 20.0, 60.0)
FRAMES = 8
"""Frames that differ: two of each range."""
ECHOES = 5
MARGIN_ROWS = 24
"""Rows on either side of the echoes on which images are compared; Hann's skirts are below -80 dB beyond."""


def _ours(work: Workload) -> str:
    shape = f"{work.sensor.channels} channels onto {work.radar.waveform.range_bins} x {work.radar.grid.bins}"
    return f"near_field_images, {shape}, {DEFAULT_TERMS} terms, a frame in a batch of {IMAGE_BATCH}, 1 thread"


def _static(radar: Radar) -> Radar:
    return radar.model_copy(update={"waveform": radar.waveform.model_copy(update={"chirps": 1})})


def _frames(work: Workload) -> tuple[NDArray[np.complex128], Timing, NDArray[np.complex64]]:
    """Fast time of FRAMES frames [B, samples, C], time of a frame of a full batch, and their images [B, R, U].

    Each frame holds echoes of similar strength near one of RANGES_M, all over the u axis and near its grid, so that a
    coarse image does not miss their peaks. Ranges beyond the image of a small radar fold to its middle.
    """
    radar, generator = _static(work.radar), np.random.default_rng(SEED)
    signals = []
    for index in range(FRAMES):
        range_m = _range_m(work, index) + generator.uniform(-0.3, 0.3, ECHOES)
        u = generator.choice(radar.grid.u[1:], ECHOES) + generator.uniform(-0.002, 0.002, ECHOES)
        points = range_m[:, None] * np.stack([np.sqrt(1.0 - u**2), u, np.zeros(ECHOES)], axis=1)
        amplitude = generator.uniform(0.5, 1.0, ECHOES) * np.exp(2j * np.pi * generator.uniform(size=ECHOES))
        paths = PathTable(ScatteredPaths.of_points(points, np.zeros((ECHOES, 3)), amplitude))
        signals.append(cube_of_paths(paths, radar, 1e-9, array=work.sensor)[0])
    moments = np.stack([sweep_moments(signal, radar, DEFAULT_TERMS) for signal in signals]).astype(np.complex64)
    batch = np.resize(moments, (IMAGE_BATCH, *moments.shape[1:]))
    near_field_images(moments[:1], radar, work.sensor)
    elapsed, images = timed(lambda: near_field_images(batch, radar, work.sensor), work.size.repeats)
    return np.stack(signals), elapsed.scaled(1.0 / IMAGE_BATCH), images[:FRAMES]


def _range_m(work: Workload, index: int) -> float:
    waveform = work.radar.waveform
    last = waveform.ranges_m[-1]
    return RANGES_M[index % len(RANGES_M)] if last > RANGES_M[-1] else 0.5 * last


def _rows(work: Workload, index: int) -> NDArray[np.intp]:
    waveform = work.radar.waveform
    centre = round(_range_m(work, index) / waveform.range_step_m)
    return np.arange(max(centre - MARGIN_ROWS, 0), min(centre + MARGIN_ROWS + 1, waveform.range_bins))


def _exact(signal: NDArray[np.complex128], radar: Radar, work: Workload, rows: NDArray[np.intp]) -> NDArray:
    return np.stack([matched_filter_row(signal, radar, work.sensor, int(row)) for row in rows])


def truth_vs_exact(work: Workload) -> Record:
    """The truth image against the exact matched filter."""
    signals, elapsed, images = _frames(work)
    radar = _static(work.radar)
    errors: dict[str, float] = {}
    times: list[Timing] = []
    for index in range(FRAMES):
        rows = _rows(work, index)
        taken, exact = timed(lambda i=index, of=rows: _exact(signals[i], radar, work, of), 1)  # type: ignore[misc]
        times.append(taken.scaled(radar.waveform.range_bins / len(rows)))
        error = peak_error_db(images[index][rows], exact)
        key = f"error_at_{_range_m(work, index):g}_m_db"
        errors[key] = max(error, errors.get(key, -np.inf))
    return Record(
        name="truth_vs_exact",
        ours=_ours(work),
        ours_time=elapsed,
        reference="exact matched filter in NumPy, float64, the rows about the echoes, scaled to a frame; 1 thread",
        reference_time=times[0],
        error=max(errors.values()),
        error_unit=f"{DB_OF_PEAK}, worst of {len(errors)} ranges",
        details={
            "milliseconds_a_frame": 1e3 * elapsed.seconds,
            "cpu_milliseconds_a_frame": 1e3 * elapsed.cpu_seconds,
            **errors,
        },
    )
