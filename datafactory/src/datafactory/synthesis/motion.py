"""How a path's delay moves within chirp and frame, around mid-frame, and what the line kernel leaves out of it.

A chirp that starts at t sees the echo's phase at mid-sweep and its beat frequency. Eq. (1) freezes the delay at the
chirp's start, tau(t) for both. With motion within the chirp the phase (f_c + mu s) tau(t + s), developed around
mid-sweep s = T_c / 2, is

    f_0 tau(t + T_c / 2) + mu (s - T_c / 2) (tau + tau' f_0 / mu) + mu tau' (s - T_c / 2)^2,

so that the phase is that at the time t + T_c / 2, and the beat frequency that at a time later by f_0 / mu: range and
Doppler are coupled. Left out are the last term, mu tau' T_c^2 / 4 = 1.3e-3 cycles at the sweep's ends and 10 m/s, and
the delay's curvature over f_0 / mu (6.2 ms).

Every kernel of the cube needs first the paths as each TX sees them, and RX elements in blocks.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64

from datafactory.paths.table import PathTable, ScatteredPaths
from datafactory.synthesis.spread import Sweep
from shared.physics.compiled import compiled
from shared.physics.units import SPEED_OF_LIGHT
from shared.radar import Radar
from shared.radar.arrays import AntennaArray
from shared.radar.waveform import Waveform
from shared.signal import chirp_times
from shared.signal.sweep import reference_frequency_hz

BLOCK_REACH_BINS = 0.205
"""Largest difference between a block's delays and the delay of its centre [bins]: blocks of 64 of the virtual sensor's
RX, which need 8 moments at 1e-6."""
NU_RMS = 12.0**-0.5
"""Root mean square of nu over the sweep, of eta over the frame."""
SQUARE_RMS = 80.0**-0.5
"""... of their squares,"""
CENTRED_SQUARE_RMS = 180.0**-0.5
"""... of eta^2 - 1/12,"""
CUBE_RMS = 448.0**-0.5
"""... of their cubes,"""
FOURTH_RMS = 2304.0**-0.5
"""... of their fourth powers,"""
FIFTH_RMS, SIXTH_RMS = 11264.0**-0.5, 53248.0**-0.5
"""... of their fifth and sixth powers."""
FOURTH_ROOT = 80.0**-0.25
"""Fourth root of the mean of eta^4,"""
CENTRED_FOURTH_ROOT = (1.0 / 2304.0 - 1.0 / 1344.0 + 1.0 / 1920.0 - 1.0 / 5184.0 + 1.0 / 20736.0) ** 0.25
"""... of that of (eta^2 - 1/12)^4."""


@dataclass(frozen=True, eq=False)
class Recording:
    """What records the paths, and how exactly.

    :param radar: with the array that receives
    :param tolerance: bound on the relative L2 error against the float64 sum
    :param intra_chirp: motion within the chirp; otherwise eq. (1), which has none
    """

    radar: Radar
    tolerance: float
    intra_chirp: bool

    @property
    def waveform(self) -> Waveform:
        """The radar's."""
        return self.radar.waveform

    @property
    def array(self) -> AntennaArray:
        """The radar's."""
        return self.radar.array

    @property
    def frame_s(self) -> float:
        """Length of a frame [s]."""
        return self.waveform.chirps * self.waveform.chirp_interval_s

    @property
    def instants(self) -> tuple[float, float]:
        """See :func:`instants`."""
        return instants(self.radar, self.intra_chirp)

    @property
    def kappa(self) -> float:
        """See :func:`coupling`."""
        return coupling(self.radar)

    @property
    def half(self) -> float:
        """Where the frame ends: at eta (1 + nu kappa) with eta = nu = 1/2."""
        return 0.5 * (1.0 + 0.5 * self.kappa)

    @property
    def cycles(self) -> float:
        """f_0 T / c: cycles a frame of a path that lengthens by 1 m/s."""
        return reference_frequency_hz(self.radar) / SPEED_OF_LIGHT * self.frame_s

    def reach_bins(self, elements: Float64[np.ndarray, "elements 3"]) -> float:
        """Largest distance from the elements' centre, as a delay in range bins."""
        return reach_m(elements) * self.waveform.bandwidth_hz / SPEED_OF_LIGHT

    def rx_blocks(self) -> list[slice]:
        """RX in their order, cut so that no block is wider than BLOCK_REACH_BINS to either side of its centre."""
        rx = self.array.rx
        blocks, first = [], 0
        for last in range(1, len(rx) + 1):
            if last == len(rx) or self.reach_bins(rx[first : last + 1]) > BLOCK_REACH_BINS:
                blocks.append(slice(first, last))
                first = last
        return blocks

    def parts_of(self, paths: PathTable, chirps: int) -> list[Part]:
        """Parts of the table in the first chirps: all TX at once where delays factorise, else each TX alone."""
        tx, times = self.array.tx, chirp_times(self.radar)[:, :chirps]
        parts = []
        if len(paths.scattered):
            if np.all(times == times[0]):
                parts.append(Part(paths.scattered, slice(0, len(tx)), times[0]))
            else:  # TDM: the targets have moved on when the next TX sends
                parts += [Part(paths.scattered, slice(i, i + 1), times[i]) for i in range(len(tx))]
        if len(paths.specular):
            parts += [Part(paths.specular.as_scattered(tx[i]), slice(i, i + 1), times[i]) for i in range(len(tx))]
        return parts

    def sweep(self, oversampling: float, cells: int, start_s: float) -> Sweep:
        """For kernels: of a chirp that starts then [s], see there."""
        waveform, (after, lead) = self.waveform, self.instants
        return Sweep(
            reference_frequency_hz(self.radar), waveform.bandwidth_hz, waveform.slope_hz_per_s,
            float(waveform.residual_video_phase), oversampling, cells, self.frame_s, start_s + after,
            start_s + after + lead, self.kappa,
        )  # fmt: skip


@dataclass(frozen=True)
class Part:
    """Paths in the form of scattered ones, with the TX they serve and the starts of that TX's chirps [s]."""

    paths: ScatteredPaths
    tx: slice
    start: Float64[np.ndarray, " chirps"]


def reach_m(elements: Float64[np.ndarray, "elements 3"]) -> float:
    """Largest distance from the elements' centre [m]."""
    return float(np.linalg.norm(elements - centre(elements), axis=1).max())


def centre(elements: Float64[np.ndarray, "elements 3"]) -> Float64[np.ndarray, " 3"]:
    """Middle of the box around the elements [m]."""
    return 0.5 * (elements.min(axis=0) + elements.max(axis=0))


@dataclass(frozen=True)
class Leg:
    """One leg of paths at one instant, seen from a centre.

    :param rate: of its length [m/s]
    :param bend: second derivative of its length [m/s^2]
    :param jerk: third derivative [m/s^3]
    :param length: [m]; ``speed`` [m/s]
    """

    length: Float64[np.ndarray, " paths"]
    rate: Float64[np.ndarray, " paths"]
    bend: Float64[np.ndarray, " paths"]
    jerk: Float64[np.ndarray, " paths"]
    speed: Float64[np.ndarray, " paths"]


@dataclass(frozen=True)
class Motion:
    """Paths around mid-frame, in cycles: f eta + q eta^2 + ..., and what separates range and Doppler,
    e(eta) = e_1 eta + e_2 (eta^2 - 1/12) + e_3 eta^3 and g(eta) = g_1 eta + g_2 eta^2 + g_3 eta^3.

    :param doppler: f, at the frequency that the line kernel gives a path
    :param curvature: q
    :param bend: [6, K] e_1, e_2, e_3, g_1, g_2, g_3 of :mod:`datafactory.synthesis.lines`
    :param legs: of TX and RX at mid-frame
    """

    doppler: Float64[np.ndarray, " paths"]
    curvature: Float64[np.ndarray, " paths"]
    bend: Float64[np.ndarray, "6 paths"]
    legs: tuple[Leg, Leg]


@dataclass(frozen=True)
class LeftOut:
    """What the line kernel must reach and what it leaves out.

    :param view: Doppler of an element beyond the centre's, at most [cycles a frame], infinite where an element is
        reached within the frame
    :param extra: the frequency that a path has beyond its own, by curvature and ``view`` [cycles a frame]
    :param far, close: bounds on the relative root mean square error over sweep and frame with 1, 2 and 3 orders,
        without and with the elements' own curvature
    """

    view: Float64[np.ndarray, " paths"]
    extra: Float64[np.ndarray, " paths"]
    far: Float64[np.ndarray, "3 paths"]
    close: Float64[np.ndarray, "3 paths"]


def leg_of(
    point: Float64[np.ndarray, "paths 3"], velocity: Float64[np.ndarray, "paths 3"], time_s: float,
    centre: Float64[np.ndarray, " 3"],
) -> Leg:  # fmt: skip
    """The leg between a centre and points [m] that move evenly [m/s]: r'' = (v^2 - r'^2) / r, r''' = -3 r' r'' / r."""
    return Leg(*_legs(np.ascontiguousarray(point), np.ascontiguousarray(velocity), float(time_s), np.asarray(centre)))


@compiled(error_model="numpy")
def _legs(point, velocity, time_s, centre):
    """[5, K] the fields of :class:`Leg`, in their order."""
    result = np.empty((5, len(point)))
    for k in range(len(point)):
        vx, vy, vz = velocity[k, 0], velocity[k, 1], velocity[k, 2]
        x = point[k, 0] + vx * time_s - centre[0]
        y = point[k, 1] + vy * time_s - centre[1]
        z = point[k, 2] + vz * time_s - centre[2]
        length = max(np.sqrt(x * x + y * y + z * z), 1e-9)
        rate = (x * vx + y * vy + z * vz) / length
        speed = np.sqrt(vx * vx + vy * vy + vz * vz)
        bend = max(speed * speed - rate * rate, 0.0) / length
        result[0, k], result[1, k], result[2, k] = length, rate, bend
        result[3, k], result[4, k] = -3.0 * rate * bend / length, speed
    return result


def instants(radar: Radar, intra_chirp: bool) -> tuple[float, float]:
    """How long after its start a chirp has the phase of the scene, and how much later still its beat frequency [s].

    :param intra_chirp: motion within the chirp; otherwise eq. (1), which has neither
    """
    waveform = radar.waveform
    if not intra_chirp:
        return 0.0, 0.0
    return 0.5 * waveform.chirp_duration_s, reference_frequency_hz(radar) / waveform.slope_hz_per_s


def coupling(radar: Radar) -> float:
    """kappa = B / f_0 of the lines."""
    return radar.waveform.bandwidth_hz / reference_frequency_hz(radar)


def motion_of(
    paths: ScatteredPaths,
    centres: tuple[Float64[np.ndarray, " 3"], Float64[np.ndarray, " 3"]],
    start_s: float,
    recording: Recording,
) -> Motion:
    """Motion of paths seen from the centres of TX and RX.

    :param start_s: start of the chirp at mid-frame [s]
    """
    waveform, kappa, frame_s, cycles = recording.waveform, recording.kappa, recording.frame_s, recording.cycles
    after, lead = recording.instants
    time = start_s + after
    tx, rx = legs = _both_legs(paths, time, centres)
    full = cycles * (tx.rate + rx.rate + paths.between_rate_mps)
    curvature = 0.5 * cycles * frame_s * (tx.bend + rx.bend)
    slower = 1.0
    if waveform.residual_video_phase:
        delay = (tx.length + rx.length + paths.between_m + paths.between_rate_mps * time) / SPEED_OF_LIGHT
        slower = 1.0 - waveform.slope_hz_per_s * delay / reference_frequency_hz(recording.radar)
    doppler = full * slower
    cubic = cycles * frame_s**2 / 6.0 * (tx.jerk + rx.jerk)
    # The range is that of a later time where the sensor moves within the chirp.
    later, later_curvature, later_cubic = full, curvature, cubic
    if lead:
        tx, rx = _both_legs(paths, time + lead, centres)
        later = cycles * (tx.rate + rx.rate + paths.between_rate_mps)
        later_curvature = 0.5 * cycles * frame_s * (tx.bend + rx.bend)
        later_cubic = cycles * frame_s**2 / 6.0 * (tx.jerk + rx.jerk)
    # Of c_p eta^p in the phase and d_p eta^p in the range the parts d_p - p c_p and p (p + 1) / 2 c_p - p d_p.
    first = [later - doppler, later_curvature - 2.0 * curvature, later_cubic - 3.0 * cubic]
    second = [doppler - later, 3.0 * curvature - 2.0 * later_curvature, 6.0 * cubic - 3.0 * later_cubic]
    bend = np.concatenate([kappa * np.stack(first), kappa**2 * np.stack(second)])
    return Motion(doppler, curvature * slower, bend, legs)


def _both_legs(
    paths: ScatteredPaths, time_s: float, centres: tuple[Float64[np.ndarray, " 3"], Float64[np.ndarray, " 3"]]
) -> tuple[Leg, Leg]:
    """That of the TX and that of the RX."""
    tx = leg_of(paths.tx_point, paths.tx_velocity, time_s, centres[0])
    return tx, leg_of(paths.rx_point, paths.rx_velocity, time_s, centres[1])


def moving(paths: ScatteredPaths) -> Bool[np.ndarray, " paths"]:
    """Whether a path's delay changes."""
    return np.any(paths.tx_velocity, axis=1) | np.any(paths.rx_velocity, axis=1) | (paths.between_rate_mps != 0.0)


def left_out(motion: Motion, reaches_m: tuple[float, float], recording: Recording) -> LeftOut:
    """What the line kernel must reach and what it leaves out.

    :param reaches_m: of TX and RX about their centres [m]
    """
    kappa, frame_s, cycles, (_, lead) = recording.kappa, recording.frame_s, recording.cycles, recording.instants
    view, bends, jerks, fourth, fourths = (np.zeros(len(motion.doppler)) for _ in range(5))
    for leg, reach in zip(motion.legs, reaches_m, strict=True):
        # Nowhere in the frame is an element nearer than this.
        nearest = leg.length - reach - leg.speed * (0.51 * frame_s + lead)
        across = leg.bend * leg.length
        with np.errstate(divide="ignore", invalid="ignore"):
            part = np.where(nearest > 0.0, reach / nearest, np.inf)
            # Between elements r' differs by v_across a / r, r'' by at most 2 / sqrt(3) v^2 a / r^2, r''' by at most
            # 3.8 v^3 a / r^3: 3 of it by direction and 2.3 by distance. The fourth derivative is at most
            # 15 v^2 v_across^2 / r^3, and differs by at most 21 v^4 a / r^4: 11.4 by direction and 9.4 by distance.
            terms = (
                cycles * (np.sqrt(across) * part + 1.5 * leg.speed * part**2),
                cycles * 0.5 * frame_s * 1.155 * leg.speed**2 * part / nearest,
                cycles * frame_s**2 / 6.0 * 3.8 * leg.speed**3 * part / nearest**2,
                cycles * frame_s**3 / 24.0 * 15.0 * leg.speed**2 * across / nearest**3,
                cycles * frame_s**3 / 24.0 * 21.0 * leg.speed**4 * part / nearest**3,
            )
        for total, term in zip((view, bends, jerks, fourth, fourths), terms, strict=True):
            total += np.where(leg.speed > 0.0, np.where(nearest > 0.0, term, np.inf), 0.0)
    curvature, sizes = np.abs(motion.curvature), np.abs(motion.bend)
    slope = 0.75 * sizes[2] / (2.0 * kappa)
    orders = _orders_left_out(sizes, bends, jerks, fourth, kappa, lead / frame_s)
    apart = 2.0 * np.pi * FOURTH_RMS * fourths
    close = apart + (2.0 * np.pi) ** 3 / 6.0 * SIXTH_RMS * (bends + jerks) ** 3
    close += (2.0 * np.pi) ** 2 * FIFTH_RMS * bends * jerks
    late = lead / frame_s
    few = apart + 2.0 * np.pi * (
        (SQUARE_RMS + NU_RMS * kappa * (late**2 + 1.0 / 12.0)) * bends + (CUBE_RMS + NU_RMS * kappa * late**3) * jerks
    )
    # Far paths have no e of their own either: the third order is that of the centre.
    elements = 2.0 * np.pi * NU_RMS * kappa * (SQUARE_RMS + 2.0 * NU_RMS * late) * bends
    third = np.stack([np.zeros_like(elements), np.zeros_like(elements), elements])
    return LeftOut(view, view + 1.02 * curvature + slope, orders + third + few, orders + close)


def _orders_left_out(
    sizes: Float64[np.ndarray, "6 paths"],
    bends: Float64[np.ndarray, " paths"],
    jerks: Float64[np.ndarray, " paths"],
    fourth: Float64[np.ndarray, " paths"],
    kappa: float,
    lead: float,
) -> Float64[np.ndarray, "3 paths"]:
    """Bounds on the relative root mean square error with 1, 2 and 3 orders.

    :param sizes: of e_1, e_2, e_3, g_1, g_2, g_3 [cycles]
    :param bends, jerks: what the coefficients of eta^2 and eta^3 differ by between elements [cycles]
    :param fourth: coefficient of eta^4 [cycles]
    :param lead: time by which ranges precede phases [frames]
    """
    linear, square, cubic = sizes[:3]
    whole, turn = 2.0 * np.pi, 2.0 * np.pi * NU_RMS
    # What e lacks whatever the orders: its fourth power, and what that adds where ranges precede phases.
    never = turn * kappa * (3.0 * FOURTH_RMS * fourth + 4.0 * NU_RMS * fourth * lead**3)
    # What only the elements' own e has.
    elements = turn * kappa * (SQUARE_RMS + 2.0 * NU_RMS * lead) * bends
    # The second order of exp(j 2 pi nu e), e_3 at its largest, and that of s((1 + nu kappa) eta).
    size = FOURTH_ROOT * (linear + 0.25 * cubic) + CENTRED_FOURTH_ROOT * square
    scalings = NU_RMS * sizes[3] + SQUARE_RMS * sizes[4] + CUBE_RMS * sizes[5]
    second = 0.5 * whole**2 * SQUARE_RMS * size**2 + whole * SQUARE_RMS * scalings
    first = turn * (NU_RMS * linear + CENTRED_SQUARE_RMS * square + CUBE_RMS * cubic)
    # The third order, all at their largest: e^3, e g, and what follows g, at most 4/3 kappa g. What the elements' own e
    # lacks of eta^3, and what g lacks of the elements.
    most, scaling = 0.5 * linear + square / 6.0 + 0.125 * cubic, sizes[3:].T @ np.array([0.5, 0.25, 0.125])
    third = CUBE_RMS * (whole**3 / 6.0 * most**3 + whole**2 * most * scaling + whole * 4.0 / 3.0 * kappa * scaling)
    apart = turn * kappa * CUBE_RMS * (4.0 if lead else 2.0) * jerks
    apart = apart + whole * kappa**2 * SQUARE_RMS * (SQUARE_RMS + 2.0 * NU_RMS * lead) * bends
    return np.stack([first + second + elements + never, second + elements + never, third + apart + never])
