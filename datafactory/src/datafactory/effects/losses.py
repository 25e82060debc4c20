"""What leaving an effect out would change: of one frame, traced with all that its scene has.

Added echoes are weighed by the power of their kind in the truth's resolution cells, changes of the signal by the closed
forms of :mod:`datafactory.frame.changes`. Figures alone: no frame is decided by them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from datafactory.effects.catalogue import NAMES
from datafactory.frame import changes
from datafactory.frame.decision import KINDS, bounces_more_than_once, kinds_of
from datafactory.paths.density import cell_map
from datafactory.paths.table import PathTable
from shared.physics.units import power_to_db
from shared.radar import Radar
from shared.signal.windows import cell_noise_power

FLOOR_DB = -200.0
"""Stands for "nothing" where a level is asked for."""
HALF_A_DECIBEL = 0.12
"""As a share of a cell's power."""
NOISE_MARGIN = 1e3
"""A range bin whose strongest echo is less than 30 dB above the noise shows it."""

Real = NDArray[np.float64]


@dataclass(frozen=True)
class Loss:
    """What a frame loses without one effect.

    :param change_db: of the power in a resolution cell over the peak's, the largest; FLOOR_DB where nothing changes
    :param power_share: of the frame's power
    :param cell_share: of the cells above the noise, those that change by more than half a decibel; of noise, the
        share of range bins that show it
    """

    change_db: float = FLOOR_DB
    power_share: float = 0.0
    cell_share: float = 0.0

    def __str__(self) -> str:
        share, cells = 100.0 * self.power_share, 100.0 * self.cell_share
        return f"{share:.3g} % of the power and {cells:.3g} % of the occupied cells"

    @staticmethod
    def worst(losses: Sequence[Loss]) -> Loss:
        """Of several frames: the largest change, mean shares."""
        return Loss(
            max(each.change_db for each in losses),
            float(np.mean([each.power_share for each in losses])),
            float(np.mean([each.cell_share for each in losses])),
        )


def losses(paths: PathTable, radar: Radar, truth_window: str) -> dict[str, Loss]:
    """Of every effect, by name.

    :param paths: of every effect, illuminated
    """
    where, waveform, kinds = cell_map(paths, radar, truth_window), radar.waveform, kinds_of(paths)
    total = where.sums()
    noise, peak = cell_noise_power(radar), float(total.max())
    occupied = total > noise / radar.array.channels
    rates = changes.range_rates_mps(paths, waveform)
    shares = {
        **{name: (kinds & kind > 0).astype(np.float64) for name, kind in KINDS.items()},
        "multi_bounce": bounces_more_than_once(paths).astype(np.float64),
        "doppler": changes.doppler_change(rates, waveform) ** 2,
        "range_migration": changes.migration_change(rates, waveform) ** 2,
        "intra_chirp_motion": changes.intra_chirp_change(rates, waveform) ** 2,
        "near_field": changes.plane_wave_change(paths, radar.array, waveform.wavelength_m) ** 2,
        "antenna_pattern": changes.pattern_change(paths, radar) ** 2,
    }

    def loss(share: Real) -> Loss:
        changed = where.sums(share)
        if not changed.any():
            return Loss()
        level_db = float(power_to_db(min(float(changed.max() / peak), 1.0), FLOOR_DB))
        cells = changed[occupied] > HALF_A_DECIBEL * total[occupied]
        return Loss(level_db, min(float(changed.sum() / total.sum()), 1.0), float(cells.mean()) if cells.size else 0.0)

    found = {name: loss(share) for name, share in shares.items()}
    over_peak = noise / radar.array.channels / peak if peak > 0.0 else 1.0
    weak = float(np.mean(total.max(axis=1) < NOISE_MARGIN * noise))
    found["noise"] = Loss(float(power_to_db(min(over_peak, 1.0), FLOOR_DB)), 0.0, weak)
    return {name: found[name] for name in NAMES}
