"""A walking human: the kinematic model of Boulic, Thalmann and Thalmann, as 16 moving parts.

Source: Boulic, Thalmann and Thalmann, A global human walking model with real-time kinematic personification, The
Visual Computer 6 (1990) 344-358, in the form and with the ellipsoids of Chen, The Micro-Doppler Effect in Radar (2nd
ed., 2019), chapter 4. With V the speed and H_t the length of a leg from hip to ankle, RV = V / H_t [1/s] is the one
variable:

    duration of a cycle (two steps)   T_c = 1.346 / sqrt(RV) [s], its length V T_c
    share of support                  D = 0.752 - 0.143 / T_c

t is the cycle's phase, 0 as the right heel strikes; the left side is half a cycle on. Lengths in metres, angles in
degrees. The origin of the spine moves about its mean by

    up       -0.015 RV + 0.015 RV sin(2 pi (2 t - 0.35))
    left     a_l sin(2 pi (t - 0.1)),            a_l = -0.128 RV (1 - RV) below RV = 0.5, else -0.032
    forward  a_f sin(2 pi (2 t + 1.25 - 2 D)),   a_f = -0.084 RV (1 - RV) below RV = 0.5, else -0.021

(the source's signs of a_l and a_f below 0.5 would make both jump at 0.5; they are taken as continuous). The back leans
forward by a (1 - sin(2 pi (2 t - 0.1))), a = 8 RV (1 - RV) below 0.5, else 2; the pelvis drops on the swinging side by
up to 3.32 RV and turns by 4 RV cos(2 pi t); the arms swing by 3 - 4.94 RV - 9.88 RV cos(2 pi t). Hips, knees, ankles,
thorax and elbows bend along periodic monotone cubics (Fritsch and Carlson) through the control points below, for three
ranges of RV. Angles have continuous rates; accelerations jump at the control points.

Each part is a point at its middle, with the cross section of an ellipsoid of revolution,

    sigma = pi a^4 c^2 / (a^2 sin^2(theta) + c^2 cos^2(theta))^2,

half axes a across and c along, theta between its axis and the line of sight. Only the shares are used: all parts
together have the level of the pedestrian's model, from everywhere.

Limits: 0 < RV <= 3; level ground, straight on, one gait for all; a part does not hide another. Who walks backwards goes
through the gait in reverse. The feet are not fixed to the ground: one that stands slides. What a frame of constant
velocities leaves out of a foot's motion stands in docs/notes/targets.md.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from datafactory.scenes.targets.bodies import Motion, MovingParts, Real
from shared.physics.vectors import dots

if TYPE_CHECKING:
    from scipy.interpolate import PchipInterpolator

Complex = NDArray[np.complex128]

FASTEST_RV = 3.0
"""Relative speed up to which the model is stated [1/s]."""
STEP = 1e-20
"""Of the complex-step derivative (Squire and Trapp 1998): f(x + jh) = f(x) + jh f'(x), exact for any tiny h."""

# Lengths over the stature (Winter, Biomechanics and Motor Control of Human Movement, fig. 4.1).
HEAD, NECK, TORSO, SHOULDER, UPPER_ARM, FOREARM = 0.130, 0.052, 0.288, 0.1295, 0.188, 0.152
HIP, THIGH, SHANK, ANKLE, FOOT = 0.0955, 0.245, 0.246, 0.039, 0.143
LEG = THIGH + SHANK


class Part(NamedTuple):
    """A part of the body, between two joints.

    :param half_width_m: half axis a of its ellipsoid, across it (Chen)
    """

    name: str
    first: str
    second: str
    half_width_m: float


def _side(side: str) -> tuple[Part, ...]:
    return (
        Part(f"{side} shoulder", "neck", f"{side} shoulder", 0.06),
        Part(f"{side} upper arm", f"{side} shoulder", f"{side} elbow", 0.06),
        Part(f"{side} forearm", f"{side} elbow", f"{side} hand", 0.05),
        Part(f"{side} hip", "spine", f"{side} hip", 0.07),
        Part(f"{side} thigh", f"{side} hip", f"{side} knee", 0.07),
        Part(f"{side} shank", f"{side} knee", f"{side} ankle", 0.06),
        Part(f"{side} foot", f"{side} ankle", f"{side} toe", 0.05),
    )


PARTS = (Part("head", "chin", "crown", 0.1), Part("torso", "spine", "neck", 0.15), *_side("right"), *_side("left"))

Angle = Callable[[float], complex]


def leg_m(stature_m: float) -> float:
    """H_t [m]."""
    return LEG * stature_m


def cycle_s(speed_mps: float, stature_m: float) -> float:
    """T_c, duration of two steps [s]."""
    return 1.346 / float(np.sqrt(speed_mps / leg_m(stature_m)))


def joints(phase: float, relative_speed: float, stature_m: float) -> dict[str, Complex]:
    """Places [3] of the joints at a phase of the cycle, relative to the walker's mean place on the ground [m].

    The imaginary part over STEP is the derivative by the phase.
    """
    h, rv = stature_m, relative_speed
    gait = _Gait(rv)
    spine = gait.spine(phase) + np.array([0.0, 0.0, (LEG + ANKLE) * h])
    # Of the body, in the order in which the source turns it: thorax about z, back about y; pelvis about z, then x.
    upper = _turn(2, -gait.bend("thorax", phase)) @ _swing_forward(gait.lean(phase))
    lower = _turn(2, gait.torsion(phase)) @ _turn(0, gait.drop(phase))
    found = {"spine": spine, "neck": spine + upper @ _up(TORSO * h)}
    found["chin"] = spine + upper @ _up((TORSO + NECK) * h)
    found["crown"] = spine + upper @ _up((TORSO + NECK + HEAD) * h)
    for side, sign, own in (("right", -1.0, phase), ("left", 1.0, phase + 0.5)):
        shoulder = np.array([0.0, sign * SHOULDER * h, TORSO * h])
        arm = _swing_forward(gait.shoulder(own))
        elbow = shoulder + arm @ _up(-UPPER_ARM * h)
        hand = elbow + arm @ _swing_forward(gait.bend("elbow", own)) @ _up(-FOREARM * h)
        hip = np.array([0.0, sign * HIP * h, 0.0])
        thigh = _swing_forward(gait.bend("hip", own))
        shank = thigh @ _swing_forward(-gait.bend("knee", own))
        knee = hip + thigh @ _up(-THIGH * h)
        ankle = knee + shank @ _up(-SHANK * h)
        toe = ankle + shank @ _swing_forward(gait.bend("ankle", own)) @ np.array([FOOT * h, 0.0, 0.0])
        for name, place in (("shoulder", shoulder), ("elbow", elbow), ("hand", hand)):
            found[f"{side} {name}"] = spine + upper @ place
        for name, place in (("hip", hip), ("knee", knee), ("ankle", ankle), ("toe", toe)):
            found[f"{side} {name}"] = spine + lower @ place
    return found


def parts_of_walker(radar: Real, motion: Motion, stature_m: float, total_rcs_m2: float, start: float) -> MovingParts:
    """The parts of a walker as the radar sees them.

    :param radar: [3] where the radar stands in the walker's frame, whose origin is on the ground [m]
    :param total_rcs_m2: of all parts together [m^2]
    :param start: phase at time 0, 0 to 1
    """
    speed = abs(motion.forward_mps)
    relative = speed / leg_m(stature_m)
    rate = 0.0 if speed == 0.0 else np.sign(motion.forward_mps) / cycle_s(speed, stature_m)  # of the phase [1/s]
    place = joints((start + rate * motion.time_s) % 1.0, relative, stature_m)
    ends = np.array([(place[part.first], place[part.second]) for part in PARTS])  # [N, 2, 3]
    middle = ends.mean(axis=1)
    position, velocity = middle.real, middle.imag / STEP * rate
    axis = (ends[:, 1] - ends[:, 0]).real
    length = np.linalg.norm(axis, axis=1)
    line = radar - position
    cosine = dots(axis, line) / length / np.maximum(np.linalg.norm(line, axis=1), 1e-9)
    across = np.array([part.half_width_m for part in PARTS])
    shares = ellipsoid_rcs_m2(across, 0.5 * length, cosine)
    return MovingParts(position, velocity, total_rcs_m2 * shares / shares.sum())


def ellipsoid_rcs_m2(across_m: Real, along_m: Real, cosine: Real) -> Real:
    """[N] sigma of ellipsoids of revolution [m^2], by geometric optics; ``cosine`` between axis and line of sight."""
    square = np.clip(cosine**2, 0.0, 1.0)
    return np.pi * across_m**4 * along_m**2 / (across_m**2 * (1.0 - square) + along_m**2 * square) ** 2


class _Gait:
    """Angles [rad] and the spine's place [m] of one relative speed, over the phase; see the module."""

    def __init__(self, rv: float) -> None:
        self._rv = rv
        self._support = 0.752 - 0.143 * np.sqrt(rv) / 1.346
        self._curves = _curves(rv)

    def spine(self, phase: float) -> Complex:
        rv, slow = self._rv, 4.0 * self._rv * (1.0 - self._rv) if self._rv < 0.5 else 1.0
        forward = -0.021 * slow * _sine(2.0, 2.0 * (0.625 - self._support), phase)
        left = -0.032 * slow * _sine(1.0, -0.1, phase)
        return np.array([forward, left, 0.015 * rv * (_sine(2.0, -0.35, phase) - 1.0)])

    def lean(self, phase: float) -> complex:
        most = 8.0 * self._rv * (1.0 - self._rv) if self._rv < 0.5 else 2.0
        return np.radians(most) * (_sine(2.0, -0.1, phase) - 1.0)

    def torsion(self, phase: float) -> complex:
        return np.radians(4.0 * self._rv) * _sine(1.0, 0.25, phase)

    def drop(self, phase: float) -> complex:
        """Of the pelvis on its left side, negative downwards: 0 at either heel's strike, most 15 % of a cycle on."""
        half, sign = (phase % 1.0, -1.0) if phase % 1.0 < 0.5 else (phase % 1.0 - 0.5, 1.0)
        turns, begin = (10.0 / 3.0, 0.0) if half < 0.15 else (10.0 / 7.0, 0.15)
        wave = _sine(turns, 0.25 - turns * begin, half)  # cos(2 pi turns (half - begin))
        return sign * np.radians(1.66 * self._rv) * (1.0 - wave if half < 0.15 else 1.0 + wave)

    def shoulder(self, phase: float) -> complex:
        swing = 9.88 * self._rv
        return np.radians(3.0 - 0.5 * swing) - np.radians(swing) * _sine(1.0, 0.25, phase)

    def bend(self, name: str, phase: float) -> complex:
        """Of a joint between its control points."""
        curve, slope = self._curves[name]
        return complex(curve(phase % 1.0), STEP * slope(phase % 1.0))


def _sine(turns: float, offset: float, phase: float) -> complex:
    """sin(2 pi (turns t + offset)) and its derivative."""
    angle = 2.0 * np.pi * (turns * phase + offset)
    return complex(np.sin(angle), STEP * 2.0 * np.pi * turns * np.cos(angle))


def control_points(rv: float) -> dict[str, tuple[tuple[float, float], ...]]:
    """(phase, angle [deg]) of the joints' control points; for three ranges of RV, continuous between them."""
    fast = max(rv - 1.3, 0.0) / 1.7
    middle = min(max(rv - 0.5, 0.0), 0.8) / 0.8
    slow = min(rv, 0.5)
    support = 0.752 - 0.143 * float(np.sqrt(rv)) / 1.346
    return {
        "hip": ((-0.1 + 0.2 * fast, 50.0 * slow + 5.0 * fast), (0.5, -30.0 * slow), (0.9, 50.0 * slow + 6.0 * fast)),
        "knee": (
            (0.17 - 0.05 * fast, 3.0 + 22.0 * fast),
            (0.4, 3.0),
            (0.75 - 0.05 * fast, 140.0 * slow - 5.0 * fast),
            (1.0 - 0.03 * fast, 3.0 + 3.0 * fast),
        ),
        "ankle": (
            (0.0, -3.0 + 5.0 * fast),
            (0.08, -3.0 - 30.0 * slow + 4.0 * fast),
            (0.5 - 0.1 * fast, -3.0 + 22.0 * slow - 3.0 * fast),
            (support, -3.0 - 34.0 * slow - 8.0 * fast),
            (0.85, -3.0 + 5.0 * fast),
        ),
        "thorax": ((0.1, 4.0 / 3.0 * rv), (0.4, -1.5 * rv), (0.6, -4.0 / 3.0 * rv), (0.9, 1.5 * rv)),
        "elbow": (
            (0.05, 3.0 + 6.0 * slow + 8.0 * middle - 6.0 * fast),
            (0.5 + 0.01 * middle + 0.04 * fast, 3.0 + 34.0 * slow + 24.0 * middle + 26.0 * fast),
            (0.9 - 0.1 * fast, 3.0 + 10.0 * slow + 9.0 * middle - 6.0 * fast),
        ),
    }


@lru_cache(maxsize=64)
def _curves(rv: float) -> dict[str, tuple[PchipInterpolator, PchipInterpolator]]:
    """Angle [rad] over the phase, and its derivative."""
    from scipy.interpolate import PchipInterpolator  # where needed: it takes a fifth of a second

    curves = {}
    for name, points in control_points(rv).items():
        # A point at or before 0 and one at its period's end are one.
        once = {round(phase % 1.0, 12): np.radians(angle) for phase, angle in points}
        phases = np.array(sorted(once))
        angles = np.array([once[phase] for phase in phases])
        curve = PchipInterpolator(
            np.concatenate([phases + turn for turn in (-2.0, -1.0, 0.0, 1.0, 2.0)]), np.tile(angles, 5)
        )
        curves[name] = curve, curve.derivative()
    return curves


def _up(length: float) -> Real:
    return np.array([0.0, 0.0, length])


def _turn(axis: int, angle: complex) -> Complex:
    """Right-handed rotation about x, y or z: of x it lifts the left, of z it turns ahead to the left."""
    matrix = np.eye(3, dtype=np.complex128)
    one, two = (axis + 1) % 3, (axis + 2) % 3
    matrix[one, one] = matrix[two, two] = np.cos(angle)
    matrix[two, one], matrix[one, two] = np.sin(angle), -np.sin(angle)
    return matrix


def _swing_forward(angle: complex) -> Complex:
    """Rotation about y that swings what hangs forward."""
    return _turn(1, -angle)
