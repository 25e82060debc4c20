"""What a frame's shard tells of its range-Doppler map: all of it, or the Doppler peaks of every range bin alone."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from shared.dataset import Frame
from shared.radar import Radar
from shared.signal.spectrum import range_doppler

WHOLE, PEAKS = "range-Doppler map", "strongest Doppler peaks"


def doppler_map(frame: Frame, radar: Radar) -> tuple[str, NDArray[np.float64]]:
    """(:data:`WHOLE` or :data:`PEAKS`, [R, chirps] mean magnitude over channels on the rising velocity axis [sqrt(W)]).

    Of peaks alone the other cells are 0. An unfolded velocity stands in the cell that it folds to.
    """
    if frame.range_doppler is not None:
        return WHOLE, np.asarray(frame.range_doppler, dtype=np.float64)
    if frame.cube is not None:
        return WHOLE, np.abs(range_doppler(frame.cube, radar)).mean(axis=2).astype(np.float64)
    waveform = radar.waveform
    cells = np.rint((frame.velocity - waveform.velocities_mps[0]) / waveform.velocity_step_mps).astype(np.int64)
    magnitude = np.zeros((waveform.range_bins, waveform.chirps))
    rows = np.broadcast_to(np.arange(waveform.range_bins), cells.shape)
    magnitude[rows, cells % waveform.chirps] = np.abs(frame.range_channel).mean(axis=2)
    return PEAKS, magnitude
