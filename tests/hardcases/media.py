"""Hard cases of reflection: grazing incidence, Brewster's angle, total reflection, metal, vacuum.

References are mpmath, the mirror-image formula and the radar integral.
"""

from collections.abc import Sequence

import mpmath
import numpy as np
from hardcases.case import HardCase
from hardcases.tools import MATERIALS, not_finite_paths, traced, wall_ahead
from sionna_scenes import plate

from datafactory.scenes.materials.reflectivity import VACUUM_PERMITTIVITY, fresnel_reflectivity

FREQUENCY_HZ = 77.5e9
WAVELENGTH_M = 299_792_458.0 / FREQUENCY_HZ


def _grazing_power_db() -> float:
    """Error [dB] of the ground's echo at 0.1 to 0.01 deg of grazing, against the radar integral.

    dP = lambda^2 / (4 pi)^3 sigma0 / R^4 dA over the front half plane, sigma0 = 4 S^2 |Gamma|^2 cos^2(theta), from a
    height h: cos(theta) = h / R, dA = pi R dR.
    """
    height, near, far = 0.01, 5.73, 57.3
    ground = plate("ground", (100.0, 0.0, -height), (100.0, 0.0, 0.0), (0.0, 100.0, 0.0), "rough")
    paths = traced([ground], rays=200_000).scattered
    range_m = paths.range_m()
    power = float((np.abs(paths.amplitude[(range_m > near) & (range_m < far)]) ** 2).sum())
    rough = MATERIALS["rough"]
    r = np.linspace(near, far, 20_001)
    gamma = fresnel_reflectivity(
        rough.relative_permittivity, rough.conductivity_s_per_m, FREQUENCY_HZ, np.arccos(height / r), "tm"
    )
    sigma0 = 4.0 * rough.scattering_coefficient**2 * gamma * (height / r) ** 2
    expected = np.trapezoid(WAVELENGTH_M**2 / (4.0 * np.pi) ** 3 * sigma0 / r**4 * np.pi * r, r)
    return abs(float(10.0 * np.log10(power / expected)))


def _exact_reflectivity(permittivity: float, conductivity: float, theta: mpmath.mpf, te: bool) -> mpmath.mpf:
    loss = mpmath.mpf(conductivity) / (2 * mpmath.pi * mpmath.mpf(FREQUENCY_HZ) * mpmath.mpf(VACUUM_PERMITTIVITY))
    eta = mpmath.mpc(permittivity, -loss)
    root = mpmath.sqrt(eta - mpmath.sin(theta) ** 2)
    leading = mpmath.cos(theta) * (1 if te else eta)
    return abs((leading - root) / (leading + root)) ** 2


def _reflectivity(permittivity: float, conductivity: float, angles_deg: Sequence[float]) -> float:
    """Largest error of |Gamma|^2 against mpmath over angles from the normal and both polarisations."""
    worst = 0.0
    with mpmath.workdps(40):
        for degrees in angles_deg:
            theta = float(np.radians(degrees))
            for te in (True, False):
                exact = _exact_reflectivity(permittivity, conductivity, mpmath.mpf(theta), te)
                value = fresnel_reflectivity(permittivity, conductivity, FREQUENCY_HZ, theta, "te" if te else "tm")
                worst = max(worst, float(abs(mpmath.mpf(float(value)) - exact)))
    return worst


def _vacuum_pane() -> float:
    """Amplitude of the echoes off a pane of vacuum over that of one of metal; infinite if anything is not finite."""
    paths, metal = traced([wall_ahead(5.0, "vacuum", "pane")]), traced([wall_ahead(5.0)])
    if not_finite_paths(paths):
        return np.inf
    echoes = paths.every("amplitude")
    return float(np.abs(echoes).sum() / np.abs(metal.specular.amplitude).sum())


CASES = (
    HardCase("ground at 0.1 to 0.01 deg grazing", "too few rays, Fresnel near 90 deg", 0.5, "dB", _grazing_power_db),
    HardCase("Fresnel to 0.01 deg grazing", "cancellation near 90 deg", 1e-12, "absolute",
             lambda: _reflectivity(5.24, 1.38, (0.0, 89.0, 89.9, 89.99, 90.0))),
    HardCase("Fresnel at Brewster's angle", "a zero lost in rounding", 1e-15, "absolute",
             lambda: _reflectivity(4.0, 0.0, (np.degrees(np.arctan(2.0)), 63.0, 64.0))),
    HardCase("total reflection, into a thinner medium", "a root of a negative number", 1e-12, "absolute",
             lambda: _reflectivity(0.25, 0.0, (0.0, 29.0, 31.0, 60.0, 89.99))),
    HardCase("Fresnel of metal, 1e7 S/m", "cancellation of large numbers", 1e-12, "absolute",
             lambda: _reflectivity(1.0, 1e7, (0.0, 45.0, 89.0, 89.99))),
    HardCase("vacuum pane", "0 / 0 in reflection", 1e-9, "of metal's", _vacuum_pane),
)  # fmt: skip
