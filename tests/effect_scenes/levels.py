"""What the echoes of the effect scenes measure, by hand: the formulas behind ``expected.json``.

Powers are those of one channel in one range-Doppler cell [dBW], the unit of the dataset, for the default radar; changes
are those of an image relative to its peak [dB], an effect being needed where its change exceeds the error budget. The
tracer and the synthesis are not used: what the plan measures with them is held against these figures.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.special import fresnel

from datafactory.scenes.materials.reflectivity import (
    Polarization,
    complex_permittivity,
    fresnel_reflectivity,
    lambertian_sigma0,
)
from datafactory.scenes.materials.table import Material, load_materials
from shared.physics.units import amplitude_to_db, power_to_db
from shared.radar import Radar
from shared.signal import target_amplitudes
from shared.signal.windows import angle_window, cell_noise_power, hann, point_spread

RADAR = Radar()
MID_SWEEP_HZ = RADAR.waveform.mid_sweep_hz
WAVELENGTH_M = RADAR.waveform.wavelength_m
WAVENUMBER = 2.0 * math.pi / WAVELENGTH_M
FRAME_S = RADAR.waveform.chirps * RADAR.waveform.chirp_interval_s
OVERSAMPLING = 16
"""Of the spectra in which a change is looked for."""


def material(name: str) -> Material:
    """A row of the shipped table."""
    return load_materials().materials[name]


def noise_dbw() -> float:
    """Receiver noise of one channel in one range-Doppler cell [dBW]."""
    return float(power_to_db(cell_noise_power(RADAR)))


def cell_noise_dbw() -> float:
    """Receiver noise in a cell of the input's beamformed image [dBW]: all channels' mean."""
    return noise_dbw() - 10.0 * math.log10(RADAR.array.channels)


def point_dbw(range_m: float, rcs_dbsm: float) -> float:
    """Echo of a point target on boresight [dBW], P_t G_t G_r lambda^2 sigma / ((4 pi)^3 R^4)."""
    position = np.array([[range_m, 0.0, 0.0]])
    return float(amplitude_to_db(target_amplitudes(RADAR, position, np.array([rcs_dbsm]), np.zeros(1)))[0])


def plane_rcs_dbsm(range_m: float) -> float:
    """Cross section that an infinite mirror at R seems to have [dBsm].

    Its image is a source 2 R away, P_t G^2 (lambda / (8 pi R))^2; the radar equation calls that sigma = pi R^2.
    """
    return float(power_to_db(math.pi * range_m**2))


def normal_reflection(name: str) -> float:
    """|Gamma| of the half-space at normal incidence."""
    m = material(name)
    return math.sqrt(fresnel_reflectivity(m.relative_permittivity, m.conductivity_s_per_m, MID_SWEEP_HZ, 0.0, "te"))


def _smooth_db(name: str) -> float:
    """What roughness leaves of a mirror's echo [dB]: 1 - S^2, the rest being scattered (Degli-Esposti et al. 2007)."""
    return float(power_to_db(1.0 - material(name).scattering_coefficient ** 2))


def mirror_db(name: str) -> float:
    """|Gamma|^2 (1 - S^2) at normal incidence [dB]; for metal at every angle."""
    return float(amplitude_to_db(normal_reflection(name))) + _smooth_db(name)


def grazing_mirror_db(name: str, grazing_deg: float) -> float:
    """|Gamma|^2 (1 - S^2) of the ground at this angle above it [dB], vertical polarisation."""
    m = material(name)
    incidence = math.radians(90.0 - grazing_deg)
    gamma = fresnel_reflectivity(m.relative_permittivity, m.conductivity_s_per_m, MID_SWEEP_HZ, incidence, "tm")
    return float(power_to_db(gamma)) + _smooth_db(name)


def plate_rcs_dbsm(area_m2: float) -> float:
    """Flat plate square to the radar, 4 pi A^2 / lambda^2 [dBsm]; beyond 2 D^2 / lambda."""
    return float(power_to_db(4.0 * math.pi * area_m2**2 / WAVELENGTH_M**2))


def cell_width_m(range_m: float) -> float:
    """Width across the line of sight of the truth's resolution cell at R [m], -3 dB."""
    elements = RADAR.virtual_sensor.rx[:, 1]
    spacing = float(np.ptp(elements)) / (len(elements) - 1) / WAVELENGTH_M
    return range_m * point_spread(angle_window("taylor-30", len(elements)), spacing)[0]


def diffuse_rcs_dbsm(name: str, area_m2: float, incidence_deg: float) -> float:
    """A rough upright patch within one cell [dBsm]: sigma0 A, sigma0 = 4 S^2 |Gamma|^2 cos^2(theta), Gamma as TE."""
    return _patch_dbsm(name, area_m2, incidence_deg, "te")


def ground_rcs_dbsm(name: str, area_m2: float, grazing_deg: float) -> float:
    """A rough level patch within one cell [dBsm], as above with Gamma as TM."""
    return _patch_dbsm(name, area_m2, 90.0 - grazing_deg, "tm")


def _patch_dbsm(name: str, area_m2: float, incidence_deg: float, polarization: Polarization) -> float:
    m, incidence = material(name), math.radians(incidence_deg)
    gamma = fresnel_reflectivity(m.relative_permittivity, m.conductivity_s_per_m, MID_SWEEP_HZ, incidence, polarization)
    return float(power_to_db(lambertian_sigma0(m.scattering_coefficient, gamma, incidence) * area_m2))


def edge_rcs_dbsm(range_m: float, exterior_n: float, face_deg: float, reflection: float) -> float:
    """Echo of a long straight edge seen at a right angle [dBsm], away from the boundaries of reflection.

    Keller (1962) for a wedge of exterior angle n pi and a source at phi from its face, backwards:
    D = sin(pi/n) / (n sqrt(2 pi k)) (1 / (cos(pi/n) - 1) + Gamma / (cos(pi/n) - cos(2 phi / n))). Out and back over R
    the wave spreads as D / (R sqrt(2 R)), for which the radar equation says sigma = 2 pi R |D|^2.

    :param reflection: Gamma of the face, with its sign; -1 or 1 for metal
    """
    n, phi = exterior_n, math.radians(face_deg)
    brackets = 1.0 / (math.cos(math.pi / n) - 1.0) + reflection / (math.cos(math.pi / n) - math.cos(2.0 * phi / n))
    coefficient = math.sin(math.pi / n) / (n * math.sqrt(2.0 * math.pi * WAVENUMBER)) * brackets
    return float(power_to_db(2.0 * math.pi * range_m * coefficient**2))


def edge_end_db(height_m: float, range_m: float) -> float:
    """Echo of an edge that begins ``height_m`` beyond the foot of the perpendicular, over the whole edge's [dB].

    The Fresnel integral from v = 2 h / sqrt(lambda R) on over that of the whole line (Goodman, section 4.4).
    """
    sine, cosine = fresnel(2.0 * height_m / math.sqrt(WAVELENGTH_M * range_m))
    return 20.0 * math.log10(math.hypot(0.5 - cosine, 0.5 - sine) / math.sqrt(2.0))


def short_edge_db(length_m: float, range_m: float) -> float:
    """Echo of an edge of this length about the foot of the perpendicular, over an endless edge's [dB].

    The Fresnel integral from -v to v with v = length / sqrt(lambda R), as in :func:`edge_end_db`.
    """
    sine, cosine = fresnel(length_m / math.sqrt(WAVELENGTH_M * range_m))
    return 20.0 * math.log10(2.0 * math.hypot(cosine, sine) / math.sqrt(2.0))


def shadow_db(clearance_m: float, before_m: float, behind_m: float) -> float:
    """One-way loss behind a knife edge [dB, negative]: ITU-R P.526-15 section 4.1, exact integral.

    :param clearance_m: how far the edge stands above the straight line
    :param before_m, behind_m: from radar to edge and from edge to target [m]
    """
    nu = clearance_m * math.sqrt(2.0 / WAVELENGTH_M * (1.0 / before_m + 1.0 / behind_m))
    s, c = fresnel(nu)
    return float(amplitude_to_db(0.5 * math.hypot(1.0 - c - s, c - s)))


def pane_db(name: str, incidence_deg: float) -> float:
    """One-way transmission of the material's slab [dB], TE: ITU-R P.2040-4 eq. (43), echoes inside included."""
    m = material(name)
    eta = complex_permittivity(m.relative_permittivity, m.conductivity_s_per_m, MID_SWEEP_HZ)
    sine, cosine = math.sin(math.radians(incidence_deg)), math.cos(math.radians(incidence_deg))
    root = np.sqrt(eta - sine**2)
    r = (cosine - root) / (cosine + root)
    through = np.exp(-1j * WAVENUMBER * m.thickness_m * root)
    return float(amplitude_to_db((1.0 - r**2) * through / (1.0 - (r * through) ** 2)))


def pattern_db(azimuth_deg: float, elevation_deg: float) -> float:
    """One-way gain of an element relative to boresight [dB]."""
    azimuth, elevation = math.radians(azimuth_deg), math.radians(elevation_deg)
    direction = np.array([math.cos(azimuth), math.sin(azimuth), math.tan(elevation)])
    pattern = RADAR.front_end.tx_pattern
    return float(power_to_db(pattern.power_gain(direction) / pattern.power_gain(np.array([1.0, 0.0, 0.0]))))


def pattern_change_db(azimuth_deg: float, elevation_deg: float) -> float:
    """What giving this direction the gain of boresight, out and back, changes [dB]."""
    return float(amplitude_to_db(1.0 - 10.0 ** (pattern_db(azimuth_deg, elevation_deg) / 10.0)))


def near_field_change_db(range_m: float, mirror: bool = False) -> float:
    """What a plane wave over the input array changes in its delay-and-sum image of an echo on boresight [dB].

    Spherical delays |x_i - p| + |x_j - p|, or |x_j - s| from the image s = (2 R, 0, 0) + H x_i in a mirror; the plane
    wave has the same angle. A phase common to all channels changes no image and is taken out.
    """
    tx, rx = RADAR.array.tx[RADAR.array.channel_tx], RADAR.array.rx[RADAR.array.channel_rx]
    if mirror:
        length = np.linalg.norm(rx - (np.array([2.0 * range_m, 0.0, 0.0]) + tx * [-1.0, 1.0, 1.0]), axis=1)
    else:
        point = np.array([range_m, 0.0, 0.0])
        length = np.linalg.norm(tx - point, axis=1) + np.linalg.norm(rx - point, axis=1)
    signal = np.exp(1j * WAVENUMBER * (length - 2.0 * range_m))
    steering = np.exp(1j * WAVENUMBER * np.outer(RADAR.grid.u, RADAR.array.virtual[:, 1])) / len(signal)
    mean = signal.mean()
    return float(amplitude_to_db(np.abs(steering @ (signal - mean / abs(mean))).max()))


def _spectrum(phase_cycles: NDArray[np.float64]) -> NDArray[np.complex128]:
    """Hann-windowed spectrum over both axes of exp(j 2 pi phase), 1 at the peak of a constant phase."""
    weights = np.outer(*(hann(length) for length in phase_cycles.shape))
    shape = [OVERSAMPLING * length for length in phase_cycles.shape]
    return np.fft.fft2(weights * np.exp(2j * np.pi * phase_cycles), shape) / weights.sum()


def _change_db(phase_cycles: NDArray[np.float64]) -> float:
    return float(amplitude_to_db(np.abs(_spectrum(phase_cycles) - _spectrum(0.0 * phase_cycles)).max()))


POSITIONS = np.arange(32) / 32.0 - 0.5
"""Of samples in the sweep, or of chirps in the frame, from mid-sweep and mid-frame."""


def doppler_change_db(speed_mps: float) -> float:
    """What a frozen frame changes in the range-Doppler spectrum [dB]: the phase 2 v t f / c over the chirps."""
    return _change_db(speed_mps / RADAR.waveform.velocity_step_mps * POSITIONS[:, None])


def migration_change_db(speed_mps: float) -> float:
    """What keeping the echo at its mid-frame range changes [dB]: kappa nu eta cycles, kappa = v T / range bin."""
    bins = speed_mps * FRAME_S / RADAR.waveform.range_step_m
    return _change_db(bins * POSITIONS[:, None] * POSITIONS[None, :])


def intra_chirp_change_db(speed_mps: float) -> float:
    """What freezing the delay within a chirp changes [dB], its phase at mid-chirp kept: 2 v T_c f / c range bins."""
    bins = 2.0 * speed_mps * RADAR.waveform.chirp_duration_s / WAVELENGTH_M
    return _change_db(bins * POSITIONS[None, :])
