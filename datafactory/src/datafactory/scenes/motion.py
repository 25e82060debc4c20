"""Where the parts of a mesh are at a time, and with which velocity: the only place that says so.

Three kinds of motion are told apart by what they cost (docs/scenes.md#motion). A mesh without a motion goes straight on
with one velocity, or rests; with a :class:`Track` it is shifted too. A :class:`Moving` mesh is computed anew for each
time, and each vertex has a velocity of its own.

The velocity of a point that a rigid body carries is v + omega x r. It is affine in the point's place, and so it is for
every chain of transforms: between a triangle's vertices it is the linear interpolation of theirs. Of a mesh whose
points have samples, the same interpolation is what USD's linear interpolation of the points means.

Times are seconds since the scene's time 0. Velocities are those of the interval that begins at the time asked for, and
0 from the last sample on, as things stand still there.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from datafactory.scenes.chain import Chain, Operation, Real, Samples, placed

Vector = tuple[float, float, float]

RESTING_MPS = 1e-6
"""Slower is at rest [m/s]: a ten-thousandth of a degree of phase at 77 GHz in a frame of 10 ms."""
MOST_INSTANTS = 64
"""Of a turning mesh's samples, so many are looked at for its largest speed."""


@dataclass(frozen=True, eq=False)
class Instant:
    """A mesh at one time.

    :param vertices: [V, 3] world [m]
    :param velocities: [V, 3] world [m/s]
    """

    vertices: Real
    velocities: Real


@dataclass(frozen=True)
class Track:
    """A path of straight pieces, without turning. Equal tracks are one motion: what has them is one rigid body.

    :param times: [K] beginnings of the pieces [s], rising; the last piece rests
    :param places: [K] displacement from time 0 at the beginning of each piece [m]
    :param velocities: [K] of each piece [m/s]
    """

    times: tuple[float, ...]
    places: tuple[Vector, ...]
    velocities: tuple[Vector, ...]

    @staticmethod
    def of(chain: Chain) -> Track | None:
        """The track of a chain that does not turn; None where it rests."""
        times = chain.times()
        if not len(times):
            return None
        if times[0] < 0.0 < times[-1]:
            times = np.union1d(times, [0.0])
        home = chain.at(0.0)[0][:3, 3]
        instants = [chain.at(float(time)) for time in times]
        places = [matrix[:3, 3] - home for matrix, _ in instants]
        rates = [rate[:3, 3] for _, rate in instants]
        slow = [bool(np.linalg.norm(rate) <= RESTING_MPS) for rate in rates]  # false for NaN, which is refused
        rates = [np.zeros(3) if rests else rate for rate, rests in zip(rates, slow, strict=True)]
        if all(slow) and not any(place.any() for place in places):
            return None
        return Track(tuple(float(t) for t in times), tuple(map(triple, places)), tuple(map(triple, rates)))

    def at(self, time_s: float) -> tuple[Real, Real]:
        """Displacement from time 0 [3] [m], and velocity [3] [m/s]."""
        piece = int(np.searchsorted(self.times, time_s, side="right")) - 1
        if piece < 0:
            return np.array(self.places[0]), np.zeros(3)
        velocity = np.array(self.velocities[piece])
        return np.array(self.places[piece]) + velocity * (time_s - self.times[piece]), velocity

    def fingerprint(self) -> bytes:
        """Equal for equal motions alone."""
        return repr((self.times, self.places, self.velocities)).encode()


@dataclass(frozen=True, eq=False)
class Moving:
    """Turns, changes its size or its shape.

    :param body: name of what it is rigidly joined to: meshes of one body weld where they touch
    :param chain: from the mesh's own coordinates to the world
    :param shape: its points' samples [K, P, 3]; None where they stay as they are
    """

    body: str
    chain: Chain
    shape: Samples | None = None

    def at(self, points: NDArray[np.floating], used: NDArray[np.integer], time_s: float) -> Instant:
        """The mesh at a time.

        :param points: [P, 3] in its own coordinates; :param used: [V] those that are vertices
        """
        matrix, rate = self.chain.at(time_s)
        if self.shape is None:
            local, slope = np.asarray(points[used], dtype=np.float64), None
        else:
            local, slope = self.shape.at(time_s, used)
        velocities = placed(local, rate)
        if slope is not None:
            velocities = velocities + slope @ matrix[:3, :3].T
        return Instant(placed(local, matrix), velocities)

    @cached_property
    def times(self) -> Real:
        """[K] times of all samples [s], rising."""
        own = self.shape.times if self.shape is not None else np.zeros(0)
        return np.union1d(self.chain.times(), own)

    def fingerprint(self) -> bytes:
        """Equal for equal motions, apart from what is hidden in the last digits."""
        digest = hashlib.sha256(self.body.encode())
        for factor in self.chain.factors:
            if isinstance(factor, Operation):
                digest.update(f"{factor.kind} {factor.axes} {factor.inverse} ".encode())
                digest.update(np.ascontiguousarray(factor.samples.times, dtype="<f8").tobytes())
                digest.update(np.ascontiguousarray(factor.samples.values, dtype="<f8").tobytes())
            else:
                digest.update(np.ascontiguousarray(factor, dtype="<f8").tobytes())
        if self.shape is not None:
            digest.update(np.ascontiguousarray(self.shape.times, dtype="<f8").tobytes())
            digest.update(np.ascontiguousarray(self.shape.values).tobytes())
        return digest.digest()


Motion = Track | Moving
"""Both rest before the first of their ``times`` and from the last one on."""


def drift(velocity: Vector, motion: Track | None, time_s: float) -> tuple[Real, Real]:
    """Displacement from time 0 [3] [m] and velocity [3] [m/s] of what does not turn.

    :param velocity: at time 0, and for ever where there is no track
    """
    if motion is not None:
        return motion.at(time_s)
    return np.array(velocity) * time_s, np.array(velocity)


def fastest_mps(
    velocity: Vector,
    motion: Motion | None,
    points: NDArray[np.floating] = np.zeros((1, 3)),
    used: NDArray[np.integer] = np.zeros(1, dtype=np.int64),
) -> float:
    """Largest speed at any time [m/s].

    :param velocity: at time 0, and for ever where there is no motion
    :param points, used: as of :meth:`Moving.at`, of what turns; without them the speed of its origin
    """
    if motion is None:
        return float(np.linalg.norm(velocity))
    if isinstance(motion, Track):
        return float(np.linalg.norm(motion.velocities, axis=1).max())
    instants = (motion.at(points, used, time) for time in looked_at(motion))
    return max(float(np.linalg.norm(item.velocities, axis=1).max(initial=0.0)) for item in instants)


def looked_at(motion: Moving) -> list[float]:
    """Times at which a moving mesh is looked at: its samples, thinned out where there are many, and between them."""
    times = motion.times
    times = np.union1d(times, 0.5 * (times[1:] + times[:-1]))
    return [float(time) for time in times[:: max(1, -(-len(times) // MOST_INSTANTS))]]


def upright_axes(forward: Real, up: Real) -> tuple[Vector, Vector, Vector] | None:
    """Right-handed unit vectors x along ``forward`` [3] and z towards ``up`` [3]; None where the two are parallel."""
    x = forward / (np.linalg.norm(forward) or 1.0)
    z = up - (up @ x) * x
    length = float(np.linalg.norm(z))
    finite = np.isfinite(forward).all() and np.isfinite(up).all()
    if not (finite and np.any(x) and length > 1e-6 * np.linalg.norm(up)):
        return None
    z = z / length
    rows = np.stack([x, np.cross(z, x), z]) + 0.0
    one, two, three = map(triple, rows)
    return one, two, three


def triple(values: Real) -> Vector:
    """Three numbers of an array."""
    x, y, z = (float(value) for value in values)
    return x, y, z
