"""How many rays two lattices need for the same error, from the rows of a sweep."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from datafactory.accuracy.knobs import SPHERE_RAYS
from datafactory.accuracy.row import Row

MEASURES = (
    ("power_l1_db", "power in a resolution cell, sum |P - P_ref| / sum P_ref"),
    ("power_l1_range_weighted_db", "the same weighted by range^4"),
)


def rays_for(error_db: float, counts: Sequence[int], errors_db: Sequence[float]) -> float | None:
    """Rays that have this error, by interpolation of log(rays) over dB; None outside the errors measured.

    :param counts: rays, rising; :param errors_db: theirs, made to fall where chance lets them rise
    """
    falling = np.minimum.accumulate(np.asarray(errors_db, dtype=np.float64))
    if len(falling) < 2 or not falling[-1] <= error_db <= falling[0]:
        return None
    # np.interp wants rising abscissae.
    return float(np.exp(np.interp(error_db, falling[::-1], np.log(np.asarray(counts, dtype=np.float64))[::-1])))


def lines(rows: Sequence[Row]) -> list[str]:
    """What to say of the fan beside the full sphere's lattice, at every error that both have."""
    said = []
    for name, words in MEASURES:
        fan, sphere = (
            sorted((int(row.setting), getattr(row, name)) for row in rows if row.knob == knob)
            for knob in ("rays", SPHERE_RAYS)
        )
        if not fan or not sphere:
            continue
        found = [(count, error, rays_for(error, *zip(*fan, strict=True))) for count, error in sphere]
        parts = [
            f"{count} rays of the sphere ({error:.1f} dB): {needed:.0f} of the fan, {count / needed:.1f} times fewer"
            for count, error, needed in found
            if needed is not None
        ]
        said.append(f"At equal error ({words}): " + ("; ".join(parts) or "no error that both lattices have") + ".")
    return said
