"""What :class:`datafactory.paths.slabs.Slabs` says of one slab, given by its numbers."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from datafactory.paths.slabs import Slabs
from datafactory.scenes.materials.table import Material
from shared.physics.units import SPEED_OF_LIGHT

Complex = NDArray[np.complex128]


def slab_reflection(
    permittivity: float, conductivity: float, thickness_m: float, frequency_hz: float, cosine: ArrayLike
) -> tuple[Complex, Complex]:
    """R, TE and TM, at the front face, for cosines of the angle of incidence."""
    cosines = np.asarray(cosine, dtype=np.float64)
    flat, slabs = cosines.reshape(-1), _slab(permittivity, conductivity, thickness_m, frequency_hz)
    te, tm = slabs.reflection(np.zeros(flat.size, dtype=np.int64), flat)
    return te.reshape(cosines.shape), tm.reshape(cosines.shape)


def slab_transmission(
    permittivity: float, conductivity: float, thickness_m: float, frequency_hz: float, cosine: ArrayLike
) -> tuple[Complex, Complex]:
    """T, TE and TM, without the air that a slab takes the place of."""
    cosines = np.asarray(cosine, dtype=np.float64)
    flat, slabs = cosines.reshape(-1), _slab(permittivity, conductivity, thickness_m, frequency_hz)
    te, tm = slabs.transmission(np.zeros(flat.size, dtype=np.int64), flat)
    air = np.exp(2j * np.pi * frequency_hz / SPEED_OF_LIGHT * thickness_m * flat)
    return (te / air).reshape(cosines.shape), (tm / air).reshape(cosines.shape)


def _slab(permittivity: float, conductivity: float, thickness_m: float, frequency_hz: float) -> Slabs:
    numbers = permittivity, conductivity, thickness_m
    return Slabs([Material("slab", *numbers, 0.0, "lambertian", "", (77.0, 77.0), ())], frequency_hz)
