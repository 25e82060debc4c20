"""Transforms that change with time: chains of operations, each with samples, and the exact rate of their product.

A chain is a product M(t) = A_1(t) A_2(t) ... of 4 x 4 matrices that act on column vectors, outermost first. A factor is
a constant matrix or an :class:`Operation` whose value has samples. Between two samples the value is interpolated as USD
does it: numbers linearly, quaternions along the great circle (Shoemake, "Animating rotation with quaternion curves",
SIGGRAPH 1985). Before the first sample and after the last the value is held.

The rate M'(t) is the sum of the products in which one factor is replaced by its rate. It is the derivative of what is
interpolated, not a difference, so that float32 values cost no digits. At a sample the rate is that of the interval that
begins there: a frame begins at its pose's time. Where two samples have the same time, the value jumps, and the rate has
no part of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Real = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Samples:
    """Values at times; linear between them.

    :param times: [K] [s], rising or equal, at least one
    :param values: [K, ...] float
    """

    times: Real
    values: NDArray[np.floating]

    def interval(self, time_s: float) -> tuple[int, int, float, float]:
        """Indices of the samples before and after, the share of the second, and the length of the interval [s].

        Outside of the samples both are the same one, and the length is infinite: the value is held.
        """
        after = int(np.searchsorted(self.times, time_s, side="right"))
        if after == 0 or after == len(self.times):
            held = min(after, len(self.times) - 1)
            return held, held, 0.0, np.inf
        length = float(self.times[after] - self.times[after - 1])
        return after - 1, after, (time_s - float(self.times[after - 1])) / length, length

    def at(self, time_s: float, which: NDArray[np.integer] | slice = slice(None)) -> tuple[Real, Real]:
        """The value at a time, and its rate [1/s], in float64.

        :param which: rows of the value that are asked for
        """
        before, after, share, length = self.interval(time_s)
        low = np.asarray(self.values[before][which], dtype=np.float64)
        if before == after:
            return low, np.zeros_like(low)
        step = np.asarray(self.values[after][which], dtype=np.float64) - low
        return low + share * step, step / length

    @property
    def varies(self) -> bool:
        """Whether any two samples differ."""
        return bool((self.values != self.values[:1]).any())


@dataclass(frozen=True, eq=False)
class Operation:
    """One operation of a transform, with samples.

    :param kind: ``translate`` or ``scale`` (three numbers), ``rotate`` (one angle [degree] for each axis), ``orient``
        (w, x, y, z), ``matrix`` (16 numbers row by row; it acts on column vectors)
    :param samples: of its values
    :param axes: of a ``rotate``, in the order in which the rotations are applied, e.g. ``"XYZ"``
    :param inverse: the operation's inverse is meant
    """

    kind: str
    samples: Samples
    axes: str = ""
    inverse: bool = False

    def at(self, time_s: float) -> tuple[Real, Real]:
        """The matrix [4, 4] at a time, and its rate [1/s]."""
        if self.kind == "orient":
            matrix, rate = _oriented(self.samples, time_s)
        else:
            matrix, rate = self._of_value(*self.samples.at(time_s))
        if not self.inverse:
            return matrix, rate
        try:
            back: Real = np.linalg.inv(matrix).astype(np.float64)
        except np.linalg.LinAlgError:  # flat at this moment; USD has the identity here
            return np.eye(4), np.zeros((4, 4))
        return back, -back @ rate @ back

    def _of_value(self, value: Real, slope: Real) -> tuple[Real, Real]:
        matrix, rate = np.eye(4), np.zeros((4, 4))
        if self.kind == "translate":
            matrix[:3, 3], rate[:3, 3] = value, slope
        elif self.kind == "scale":
            matrix[[0, 1, 2], [0, 1, 2]], rate[[0, 1, 2], [0, 1, 2]] = value, slope
        elif self.kind == "rotate":
            matrix[:3, :3], rate[:3, :3] = _rotated(self.axes, np.radians(value), np.radians(slope))
        else:
            matrix, rate = value.reshape(4, 4), slope.reshape(4, 4)
        return matrix, rate

    @property
    def turns(self) -> bool:
        """Whether the matrix changes in more than its translation."""
        if self.kind == "translate":
            return False
        if self.kind != "matrix":
            return self.samples.varies
        linear = np.asarray(self.samples.values, dtype=np.float64).reshape(-1, 4, 4)[:, :3, :3]
        # Exporters write a turned, moving prim's matrices with rounding in the last digits.
        return not np.abs(linear - linear[0]).max() <= 1e-9 * np.abs(linear[0]).max()


Factor = Real | Operation


@dataclass(frozen=True, eq=False)
class Chain:
    """A product of factors, outermost first."""

    factors: tuple[Factor, ...] = ()

    def then(self, *inner: Factor) -> Chain:
        """The chain with more factors further inside; neighbouring constants become one."""
        factors = list(self.factors)
        for factor in inner:
            if factors and not isinstance(factor, Operation) and not isinstance(factors[-1], Operation):
                factors[-1] = factors[-1] @ factor
            else:
                factors.append(factor)
        return Chain(tuple(factors))

    @property
    def operations(self) -> tuple[Operation, ...]:
        return tuple(factor for factor in self.factors if isinstance(factor, Operation))

    @property
    def moves(self) -> bool:
        """Whether any factor changes with time."""
        return any(item.samples.varies for item in self.operations)

    @property
    def turns(self) -> bool:
        """Whether the product may change in more than its translation."""
        return any(item.turns for item in self.operations)

    def times(self) -> Real:
        """[K] times of all samples [s], rising, each once."""
        found = [item.samples.times for item in self.operations if item.samples.varies]
        return np.unique(np.concatenate([np.zeros(0), *found]))

    def at(self, time_s: float) -> tuple[Real, Real]:
        """The product [4, 4] at a time, and its rate [1/s]."""
        matrix, rate = np.eye(4), np.zeros((4, 4))
        for factor in self.factors:
            if isinstance(factor, Operation):
                step, slope = factor.at(time_s)
                matrix, rate = matrix @ step, rate @ step + matrix @ slope
            else:
                matrix, rate = matrix @ factor, rate @ factor
        return matrix, rate


def _rotated(axes: str, angle: Real, slope: Real) -> tuple[Real, Real]:
    """Rotations about axes one after another: the matrix [3, 3] and its rate, of angles [rad] and their rates."""
    matrix, rate = np.eye(3), np.zeros((3, 3))
    for axis, turned, speed in zip(axes, angle, slope, strict=True):
        across = np.zeros((3, 3))
        n = "XYZ".index(axis)
        across[(n + 1) % 3, (n + 2) % 3], across[(n + 2) % 3, (n + 1) % 3] = -1.0, 1.0  # the axis' cross product
        step = np.eye(3) + np.sin(turned) * across + (1.0 - np.cos(turned)) * across @ across
        matrix, rate = step @ matrix, step @ rate + speed * across @ step @ matrix
    return matrix, rate


def _oriented(samples: Samples, time_s: float) -> tuple[Real, Real]:
    """The matrix [4, 4] of a quaternion w, x, y, z and its rate: a constant rate of turn between two samples."""
    before, after, share, length = samples.interval(time_s)
    start = _unit_quaternion(np.asarray(samples.values[before], dtype=np.float64))
    matrix, rate = np.eye(4), np.zeros((4, 4))
    if before == after:
        matrix[:3, :3] = rotation_of(start)
        return matrix, rate
    end = _unit_quaternion(np.asarray(samples.values[after], dtype=np.float64))
    if start @ end < 0.0:
        end = -end
    # end = turn start: the turn's axis and half angle.
    w = start @ end
    axis = start[0] * end[1:] - end[0] * start[1:] - np.cross(end[1:], start[1:])
    sine = float(np.linalg.norm(axis))
    axis = axis / sine if sine > 0.0 else np.array([0.0, 0.0, 1.0])
    angle = 2.0 * np.arctan2(sine, w)
    across = np.array([[0.0, -axis[2], axis[1]], [axis[2], 0.0, -axis[0]], [-axis[1], axis[0], 0.0]])
    turned = share * angle
    step = np.eye(3) + np.sin(turned) * across + (1.0 - np.cos(turned)) * across @ across
    matrix[:3, :3] = step @ rotation_of(start)
    rate[:3, :3] = angle / length * across @ matrix[:3, :3]
    return matrix, rate


def _unit_quaternion(value: Real) -> Real:
    length = float(np.linalg.norm(value))
    return value / length if length > 0.0 else np.array([1.0, 0.0, 0.0, 0.0])


def rotation_of(quaternion: Real) -> Real:
    """[3, 3] of a unit quaternion w, x, y, z."""
    w, x, y, z = quaternion
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def placed(points: NDArray[np.floating], matrix: Real) -> Real:
    """[P, 3] points after an affine transform [4, 4], in float64; points that are not finite stay so."""
    world: Real = np.asarray(points, dtype=np.float64) @ matrix[:3, :3].T + matrix[:3, 3]
    return world
