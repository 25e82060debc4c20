"""What the sensor's own motion says of a static world: the Doppler of every angle, and so the angles of every Doppler.

An echo that stands still, seen in the direction e = (sqrt(1 - u^2 - w^2), u, w) of the radar frame (x forward, y left,
z up; u = y / r, w = z / r), has the range rate

    -(v_x sqrt(1 - u^2 - w^2) + v_y u + v_z w)        positive: receding

v the sensor's velocity. A line along y knows no w. On a level road, seen at its own height, it is

    rate(u) = -(v_x sqrt(1 - u^2) + v_y u).

An echo at another height is less fast, by v_x w^2 / (2 sqrt(1 - u^2)) for small w. A radar that looks along its motion
(v_y = 0) has the same rate at u and -u: it cannot tell left from right by it.

Velocities are known modulo the width K of the Doppler axis, times what TDM elements that coincide resolve
(:attr:`shared.radar.Radar.velocity_intervals`): every difference of two is taken the short way round.

A row of an image is of one Doppler cell. With d(u) the distance [cells] from its velocity to rate(u),

    w(u) = floor + (1 - floor) exp(-d^2 / (2 s^2))

is how far an echo from u is expected there. It is divided by its largest value: a row that no angle explains is of
something that moves, and nothing is said of its angle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float, Float64
from scipy.special import bdtrc, expit, logit

from shared.physics.units import db_to_power
from shared.radar import Radar

FLOOR_DB = -10.0
"""Of the prior: what moves stays possible everywhere."""
SPREAD_CELLS = 0.85
"""s of the prior [Doppler cells]: a Hann window's cell is that wide, and the road is not quite level."""
ASTRAY = 0.3
"""Share of lines that are not of the level static world, before one knows their Doppler: docs/notes/ego-motion.md."""
EVEN_ODDS = 16.0
"""Odds of being an echo at which one of those is as likely of something that moves as of something else: p = 0.94."""
STATIC_SPREAD_CELLS = 0.5
"""Standard deviation [Doppler cells] of a static line's velocity beside its own cell's: echoes that share a cell."""
HEIGHT_M = 5.0
"""Standard deviation of the height of what is seen, over the sensor: facades are lit as far up as the beam goes."""


@dataclass(frozen=True)
class EgoMotion:
    """The sensor's velocity in the radar frame.

    :param forward_mps: v_x [m/s]
    :param left_mps: v_y [m/s]
    :param std_mps: their standard deviations [m/s]; 0 where they were told
    """

    forward_mps: float
    left_mps: float
    std_mps: tuple[float, float] = (0.0, 0.0)

    @staticmethod
    def of_vehicle(forward_mps: float, left_mps: float, yaw_rad: float = 0.0) -> EgoMotion:
        """Of a vehicle that moves forward and to its left, with the radar turned to the left by ``yaw_rad`` on it.

        A turning vehicle moves the radar by the rate of turn times its place as well: give the radar's velocity.
        """
        cosine, sine = float(np.cos(yaw_rad)), float(np.sin(yaw_rad))
        return EgoMotion(cosine * forward_mps + sine * left_mps, cosine * left_mps - sine * forward_mps)

    @staticmethod
    def of_pose(velocity: Sequence[float], orientation: Sequence[float]) -> EgoMotion:
        """Of a dataset's frame: the velocity in the world, and the quaternion w, x, y, z from the radar frame to it."""
        w, *axis = np.asarray(orientation, dtype=np.float64)
        moved, about = np.asarray(velocity, dtype=np.float64), -np.array(axis)
        # v + 2 a x (a x v + w v), the axis reversed: from the world into the radar frame.
        x, y, _ = moved + 2.0 * np.cross(about, np.cross(about, moved) + w * moved)
        return EgoMotion(float(x), float(y))

    def range_rate(self, u: Float[np.ndarray, "*any"]) -> Float64[np.ndarray, "*any"]:
        """[...] range rates [m/s] of static echoes at angles u, level with the sensor."""
        u = np.asarray(u, dtype=np.float64)
        return -(self.forward_mps * np.sqrt(np.maximum(1.0 - u**2, 0.0)) + self.left_mps * u)


def velocity_period_mps(radar: Radar) -> float:
    """Velocities this far apart [m/s] look alike."""
    return radar.waveform.velocity_span_mps * radar.velocity_intervals


def folded(velocity_mps: Float64[np.ndarray, "*any"], period_mps: float) -> Float64[np.ndarray, "*any"]:
    """[...] velocities brought into half a period around 0 [m/s]."""
    return (velocity_mps + 0.5 * period_mps) % period_mps - 0.5 * period_mps


@dataclass(frozen=True, eq=False)
class StaticWorld:
    """What the sensor's motion says of rows of known Doppler.

    :param motion: of the sensor
    :param velocity_mps: [*rows] of their Doppler cells
    :param radar: of the data
    """

    motion: EgoMotion
    velocity_mps: Float[np.ndarray, "*rows"]
    radar: Radar

    def __getitem__(self, rows: Any) -> StaticWorld:
        """Of some of the rows, as NumPy indexes them."""
        return replace(self, velocity_mps=self.velocity_mps[rows])

    def prior(self, u: Float64[np.ndarray, " angles"]) -> Float64[np.ndarray, "*rows angles"]:
        """[..., N] w(u) of each row, its largest value 1."""
        seen = np.asarray(self.velocity_mps, dtype=np.float64)[..., None]
        away = folded(seen - self.motion.range_rate(u), velocity_period_mps(self.radar))
        floor = float(db_to_power(FLOOR_DB))
        cells = away / self.radar.waveform.velocity_step_mps
        weight = floor + (1.0 - floor) * np.exp(-(cells**2) / (2.0 * SPREAD_CELLS**2))
        return weight / weight.max(axis=-1, keepdims=True)


def moving_probability(
    motion: EgoMotion,
    radar: Radar,
    range_m: Float64[np.ndarray, " lines"],
    u: Float64[np.ndarray, " lines"],
    velocity_mps: Float64[np.ndarray, " lines"],
    u_std: Float64[np.ndarray, " lines"],
    velocity_std: Float64[np.ndarray, " lines"],
    probability: Float64[np.ndarray, " lines"],
) -> Float64[np.ndarray, " lines"]:
    """[N] probability that a line is of something that moves.

    Bayes' rule between three kinds. A line of the static world has a velocity that is normal around rate(u); its
    variance is that of the line's velocity and angle, of the sensor's, of :data:`STATIC_SPREAD_CELLS` and of a height
    of :data:`HEIGHT_M`. :data:`ASTRAY` of all lines are not of it, and have any velocity of the period alike: these are
    of something that moves, or of something else, a ghost or an echo of unlike ways. With p the probability that the
    line is an echo at all, the odds of the former are

        (p / (1 - p) / EVEN_ODDS)^2

    which is near what fits the lines of simulated drives, of which the paths are known (docs/notes/ego-motion.md). What
    moves across the line of sight alone is not found.

    :param probability: that an echo stands there
    """
    period, cosine = velocity_period_mps(radar), np.sqrt(np.maximum(1.0 - u**2, 1e-6))
    slope = motion.forward_mps * u / cosine - motion.left_mps
    rise = np.minimum(HEIGHT_M / np.maximum(range_m, radar.waveform.range_step_m), cosine)
    variance = (
        velocity_std**2
        + (STATIC_SPREAD_CELLS * radar.waveform.velocity_step_mps) ** 2
        + (slope * u_std) ** 2
        + (cosine * motion.std_mps[0]) ** 2
        + (u * motion.std_mps[1]) ** 2
        + (0.5 * motion.forward_mps * rise**2 / cosine) ** 2
    )
    away = folded(velocity_mps - motion.range_rate(u), period)
    static = (1.0 - ASTRAY) * np.exp(-(away**2) / (2.0 * variance)) / np.sqrt(2.0 * np.pi * variance)
    moves = expit(2.0 * (logit(probability) - np.log(EVEN_ODDS)))
    return moves * ASTRAY / (ASTRAY + period * static)


TRIALS = 64
"""Pairs of detections that propose a velocity. With four in ten static, 64 pairs miss in 1e-5 of frames."""
FASTEST_MPS = 60.0
"""Of a proposed velocity, 216 km/h, beyond a road vehicle's; it bounds the folds that are tried."""
APART = 0.15
"""Least difference in u of such a pair."""
AGREEING_CELLS = 1.0
"""A detection agrees with a velocity within that of its Doppler."""
LEAST_AGREEING, LEAST_SHARE = 12, 0.3
"""Fewer, or a smaller share of the detections, are no static world."""
MOST_BY_CHANCE = 1e-3
"""Of proposals with which as many agree although every velocity is drawn: with few Doppler cells there are some."""


def estimated_motion(
    u: Float64[np.ndarray, " detections"], velocity_mps: Float64[np.ndarray, " detections"], radar: Radar, seed: int
) -> EgoMotion | None:
    """The velocity that most detections agree with as a static world, and its standard deviation; None if too few do.

    A detection is an echo of its own: those of one echo agree with each other whatever the sensor does.

    Kellner, Barjenbruch, Klappstein, Dickmann and Dietmayer, "Instantaneous ego-motion estimation using Doppler radar",
    ITSC 2013: two detections propose (v_x, v_y), all others vote, least squares over those that agree ends it. Here a
    pair proposes a velocity for every fold of its two Doppler values, below :data:`FASTEST_MPS`, and of proposals of
    equal votes the slowest is taken. Beside its pair, each of n - 2 others agrees with a wrong one by chance p = 2
    :data:`AGREEING_CELLS` / cells of the axis; the number of proposals times the binomial tail is at most
    :data:`MOST_BY_CHANCE`. The standard deviation is that of least squares with as many detections as there are Doppler
    cells: those of one err together, by the rounding to its centre. It does not hold what heights do: the estimate is
    slow by up to 4 standard deviations in a street (docs/notes/ego-motion.md).

    :param seed: of the frame
    """
    waveform, period = radar.waveform, velocity_period_mps(radar)
    if len(u) < LEAST_AGREEING or not waveform.tells_velocity:
        return None
    rows = -np.stack([np.sqrt(np.maximum(1.0 - u**2, 0.0)), u], axis=1)
    near = AGREEING_CELLS * waveform.velocity_step_mps
    most = int(FASTEST_MPS / period + 0.5)
    folds = period * np.stack(np.meshgrid(*2 * [np.arange(-most, most + 1)]), axis=-1).reshape(-1, 2)
    generator, best, proposals = np.random.default_rng(seed), (0, 0.0, np.zeros(2)), 0
    for pair in generator.integers(len(u), size=(TRIALS, 2)):
        if abs(u[pair[0]] - u[pair[1]]) < APART:
            continue
        proposed = np.linalg.solve(rows[pair], (velocity_mps[pair] + folds).T).T
        speed = np.hypot(*proposed.T)
        proposed, speed = proposed[speed <= FASTEST_MPS], speed[speed <= FASTEST_MPS]
        proposals += len(proposed)
        votes = (np.abs(folded(velocity_mps - proposed @ rows.T, period)) <= near).sum(axis=1)
        for count, slow, velocity in zip(votes.tolist(), (-speed).tolist(), proposed, strict=True):
            best = max(best, (count, slow, velocity), key=lambda one: one[:2])
    if not proposals:  # nothing stands far enough apart
        return None
    velocity = best[2]
    for _ in range(3):
        away = folded(velocity_mps - rows @ velocity, period)
        agreeing = np.abs(away) <= near
        count = int(agreeing.sum())
        by_chance = proposals * bdtrc(count - 3, len(u) - 2, min(2.0 * near / period, 1.0))
        if count < max(LEAST_AGREEING, LEAST_SHARE * len(u)) or by_chance > MOST_BY_CHANCE:
            return None
        chosen = rows[agreeing]
        information = chosen.T @ chosen
        if np.linalg.cond(information) > 1e6:
            return None
        velocity = velocity + np.linalg.solve(information, chosen.T @ away[agreeing])
    left = folded(velocity_mps - rows @ velocity, period)[agreeing]
    cells = np.unique(np.rint(velocity_mps[agreeing] / waveform.velocity_step_mps))
    variance = float(np.sum(left**2)) / (len(left) - 2) * np.diag(np.linalg.inv(information)) * len(left) / len(cells)
    # Of a sensor at rest all stand in the middle of one cell, and could be anywhere in it.
    rounding = waveform.velocity_step_mps**2 / 12.0 / len(cells) / np.abs(chosen).max(axis=0) ** 2
    variance = np.maximum(variance, rounding)
    return EgoMotion(float(velocity[0]), float(velocity[1]), tuple(np.sqrt(variance).tolist()))
