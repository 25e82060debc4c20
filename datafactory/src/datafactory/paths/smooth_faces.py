"""Fields that plane faces of given materials reflect as mirrors do."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from datafactory.paths.slabs import slab_reflection
from datafactory.paths.wave_steps import reflected_fields
from datafactory.scenes.materials.table import Material
from shared.physics.vectors import dots

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

LEAST_COSINE = 1e-9
"""Of an angle of incidence: a face seen edge on is seen almost so."""


def reflection_by_slabs(
    slabs: Sequence[Material], mesh: NDArray[np.int64], frequency_hz: float, cosine: Real
) -> tuple[Complex, Complex]:
    """R [n], TE and TM, of the slabs that n waves meet.

    :param slabs: material of each merged mesh; :param mesh: [n] index into ``slabs``
    :param cosine: [n] of the angle of incidence, above 0
    """
    te, tm = np.empty((2, len(mesh)), dtype=np.complex128)
    for index in np.flatnonzero(np.bincount(mesh)).tolist():
        here, slab = np.flatnonzero(mesh == index), slabs[index]
        te[here], tm[here] = slab_reflection(
            slab.relative_permittivity, slab.conductivity_s_per_m, slab.thickness_m, frequency_hz, cosine[here]
        )
    return te, tm


def mirrored_by_slabs(
    slabs: Sequence[Material],
    mesh: NDArray[np.int64],
    frequency_hz: float,
    direction: Real,
    normal: Real,
    field: Complex,
) -> tuple[Real, Complex]:
    """Directions [n, 3] and fields [n, 3] of the waves that slabs send on: less what they scatter, sqrt(1 - S^2) R e.

    :param slabs, mesh: as in :func:`reflection_by_slabs`
    :param direction: [n, 3] unit; :param normal: [n, 3] unit, on either side; :param field: [n, 3] across ``direction``
    """
    cosine = np.clip(np.abs(dots(direction, normal)), LEAST_COSINE, 1.0)
    te, tm = reflection_by_slabs(slabs, mesh, frequency_hz, cosine)
    onward, reflected = reflected_fields(direction, normal, field, te, tm)
    left = np.sqrt(1.0 - np.array([slab.scattering_coefficient for slab in slabs]) ** 2)
    return onward, left[mesh][:, None] * reflected
