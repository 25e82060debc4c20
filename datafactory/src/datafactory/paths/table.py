"""PathTable: the contract between tracing and everything after it.

A table holds the multipath of one frame in the radar frame, independent of array, waveform and patterns: one trace
serves every radar. There are two kinds of path, because there are two delay laws. x_i is a TX, x_j an RX, t the time
since the start of chirp 0; each mirror on the way is replaced by the mirror image behind it.

Scattered paths have a point from which the wave spreads anew (a diffuse bounce, a point target), p as the TX sees it
and q as the RX sees it. A single bounce has p = q; b is the length between two scattering points, else 0:

    c tau = |x_i - (p + v_p t)| + b + b' t + |x_j - (q + v_q t)|.

Specular paths have no such point. The RX sees the mirror image of the TX, and the wavefront's curvature is that of the
whole path. With s the image of the origin and H, orthogonal, the product of the mirrors' reflections,

    c tau = |x_j - (s + v_s t + H x_i)|.

Both laws are exact for plane mirrors and constant velocities, in the near field too. Amplitudes are those of isotropic
antennas of 0 dBi and of unit transmit power, with the sign convention of the IF signal: the conjugate of the
propagation channel's, because the mixer conjugates the received wave (eq. (1) has +j f_c tau).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from datafactory.paths.candidates import Candidates
from datafactory.paths.columns import Columns
from shared.physics.vectors import Complex, Real, lengths
from shared.radar import FrontEnd, Radar

SPECULAR, DIFFUSE, REFRACTED, DIFFRACTED, TARGET = 1, 2, 4, 8, 16
"""Kinds of interaction on a path, Sionna's codes; a path carries the sum of those it has, each counted once."""
CORNER = 32
"""Of the echoes of right-angled corners, whose bounces count as no mirrors: a kind of its own, beside Sionna's."""
ALWAYS = np.array([-1], dtype=np.int32)
"""Stands for the candidates of paths of which none was one."""


@dataclass(frozen=True)
class _Paths(Columns):
    """What paths of both kinds have.

    :param amplitude: [K] complex, see the module
    :param depth: [K] number of bounces
    :param object_index: [K] index into the table's ``objects`` of what scattered, or of the last mirror; -1 where
        unknown
    :param kinds: [K] kinds of interaction on the path, see ``SPECULAR`` and its neighbours
    :param candidate: [K] index into the table's ``candidates`` of what it was before it was found; -1 of what is there
        whatever a radar notices
    """

    amplitude: Complex = field(kw_only=True)
    depth: NDArray[np.int8] = field(kw_only=True)
    object_index: NDArray[np.int32] = field(kw_only=True)
    kinds: NDArray[np.uint8] = field(kw_only=True)
    candidate: NDArray[np.int32] = field(default_factory=lambda: ALWAYS, kw_only=True)

    def __post_init__(self) -> None:
        if self.candidate is ALWAYS:
            object.__setattr__(self, "candidate", np.full(len(self.amplitude), -1, dtype=np.int32))


@dataclass(frozen=True)
class ScatteredPaths(_Paths):
    """K paths with a scattering point.

    :param tx_point: [K, 3] p, the point as the TX sees it at t = 0 [m]
    :param rx_point: [K, 3] q, the point as the RX sees it at t = 0 [m]
    :param tx_velocity: [K, 3] v_p relative to the radar [m/s]
    :param rx_velocity: [K, 3] v_q relative to the radar [m/s]
    :param between_m: [K] b [m]
    :param between_rate_mps: [K] b' [m/s]
    """

    tx_point: Real
    rx_point: Real
    tx_velocity: Real
    rx_velocity: Real
    between_m: Real
    between_rate_mps: Real

    def reversed(self) -> ScatteredPaths:
        """The same paths run backwards: by reciprocity of the same amplitude."""
        return replace(
            self,
            tx_point=self.rx_point,
            rx_point=self.tx_point,
            tx_velocity=self.rx_velocity,
            rx_velocity=self.tx_velocity,
        )

    def range_m(self) -> Real:
        """[K] half of the path's length from and to the origin at t = 0 [m]."""
        legs = lengths(self.tx_point) + lengths(self.rx_point)
        return 0.5 * (legs + self.between_m)

    @staticmethod
    def of_points(
        position: Real,
        velocity: Real,
        amplitude: ArrayLike,
        object_index: NDArray[np.int32] | None = None,
        kinds: NDArray[np.uint8] | int = TARGET,
        depth: int = 1,
        candidate: NDArray[np.int32] = ALWAYS,
    ) -> ScatteredPaths:
        """Points [K, 3] m moving with [K, 3] m/s that send waves back; of one kind where ``kinds`` is a number."""
        count = len(position)
        position, velocity = position.reshape(count, 3).astype(float), velocity.reshape(count, 3).astype(float)
        return ScatteredPaths(
            tx_point=position,
            rx_point=position,
            tx_velocity=velocity,
            rx_velocity=velocity,
            between_m=np.zeros(count),
            between_rate_mps=np.zeros(count),
            amplitude=np.asarray(amplitude, dtype=np.complex128).reshape(count),
            depth=np.full(count, depth, dtype=np.int8),
            object_index=np.full(count, -1, dtype=np.int32) if object_index is None else object_index,
            kinds=np.full(count, kinds, dtype=np.uint8) if isinstance(kinds, int) else kinds,
            candidate=candidate,
        )

    @staticmethod
    def none() -> ScatteredPaths:
        return ScatteredPaths.of_points(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))


@dataclass(frozen=True)
class SpecularPaths(_Paths):
    """S purely specular paths.

    :param image: [S, 3] s, image of the origin at t = 0 [m]
    :param image_velocity: [S, 3] v_s relative to the radar [m/s]
    :param axes: [S, 3, 3] H, orthogonal
    """

    image: Real
    image_velocity: Real
    axes: Real

    @staticmethod
    def of(
        image: Real,
        image_velocity: Real,
        axes: Real,
        amplitude: Complex,
        object_index: NDArray[np.int32],
        kinds: NDArray[np.uint8] | int,
        depth: int = 1,
        candidate: NDArray[np.int32] = ALWAYS,
    ) -> SpecularPaths:
        """Paths of one depth; of one kind where ``kinds`` is a number."""
        count = len(amplitude)
        kinds = np.full(count, kinds, dtype=np.uint8) if isinstance(kinds, int) else kinds
        return SpecularPaths(
            image, image_velocity, axes, amplitude=amplitude, depth=np.full(count, depth, dtype=np.int8),
            object_index=object_index, kinds=kinds, candidate=candidate,
        )  # fmt: skip

    @staticmethod
    def none() -> SpecularPaths:
        nowhere, axes, no_object = np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros(0, dtype=np.int32)
        return SpecularPaths.of(nowhere, nowhere, axes, np.zeros(0, dtype=np.complex128), no_object, SPECULAR)

    def range_m(self) -> Real:
        """[S] half of the path's length from and to the origin at t = 0 [m]."""
        return 0.5 * lengths(self.image)

    def departure(self) -> Real:
        """[S, 3] directions in which a TX at the origin sees the image of the origin: H^T (0 - s)."""
        return np.einsum("kji,kj->ki", self.axes, -self.image)

    def as_scattered(self, tx: Real) -> ScatteredPaths:
        """The same paths for one TX at ``tx`` [3], in the form of scattered paths.

        The RX-side point is the image of this TX. The TX-side point stands 1 m ahead of the TX, which makes the TX leg
        a constant 1 m, and b = -1 m removes it. One kernel then serves both laws exactly.
        """
        count = len(self)
        moved = np.einsum("kij,j->ki", self.axes, tx)
        return ScatteredPaths(
            tx_point=np.tile(tx + np.array([1.0, 0.0, 0.0]), (count, 1)),
            rx_point=self.image + moved,
            tx_velocity=np.zeros((count, 3)),
            rx_velocity=self.image_velocity,
            between_m=np.full(count, -1.0),
            between_rate_mps=np.zeros(count),
            amplitude=self.amplitude,
            depth=self.depth,
            object_index=self.object_index,
            kinds=self.kinds,
            candidate=self.candidate,
        )


@dataclass(frozen=True)
class PathTable:
    """All paths of one frame.

    :param scattered: paths with a scattering point
    :param specular: paths without
    :param objects: names that ``object_index`` points to
    :param candidates: what a radar decides by what it would not notice; none where nothing is left out
    :param counts: what was found, dropped and why, by name, e.g. ``{"rays": 500000, "beyond_range": 12}``
    """

    scattered: ScatteredPaths
    specular: SpecularPaths = field(default_factory=SpecularPaths.none)
    objects: tuple[str, ...] = ()
    counts: dict[str, int] = field(default_factory=dict)
    candidates: Candidates = field(default_factory=Candidates.none)

    def __len__(self) -> int:
        return len(self.scattered) + len(self.specular)

    def every(self, name: str) -> NDArray:
        """[K] what paths of both kinds have by this name, scattered paths first, then specular ones."""
        return np.concatenate([getattr(self.scattered, name), getattr(self.specular, name)])

    def range_m(self) -> Real:
        """[K] half of the paths' lengths from and to the origin at t = 0 [m], scattered paths first."""
        return np.concatenate([self.scattered.range_m(), self.specular.range_m()])

    def arrival(self) -> Real:
        """[K, 3] places that the origin sees waves come from at t = 0 [m], scattered paths first."""
        return np.concatenate([self.scattered.rx_point, self.specular.image])

    def moves(self) -> bool:
        """Whether any delay changes over the frame."""
        scattered, specular = self.scattered, self.specular
        rates = (scattered.tx_velocity, scattered.rx_velocity, scattered.between_rate_mps, specular.image_velocity)
        return any(np.any(rate) for rate in rates)

    def at_rest(self, time_s: float) -> PathTable:
        """The table as it is at ``time_s`` [s], with all velocities 0."""
        scattered, specular = self.scattered, self.specular
        still = np.zeros((len(scattered), 3))
        return replace(
            self,
            scattered=replace(
                scattered,
                tx_point=scattered.tx_point + scattered.tx_velocity * time_s,
                rx_point=scattered.rx_point + scattered.rx_velocity * time_s,
                between_m=scattered.between_m + scattered.between_rate_mps * time_s,
                tx_velocity=still,
                rx_velocity=still,
                between_rate_mps=np.zeros(len(scattered)),
            ),
            specular=replace(
                specular,
                image=specular.image + specular.image_velocity * time_s,
                image_velocity=np.zeros((len(specular), 3)),
            ),
        )

    def at_wavelength(self, traced_m: float, wanted_m: float) -> PathTable:
        """The table for another wavelength [m] than it was traced at: amplitudes are proportional to it.

        The materials' values are those of 77 GHz whatever the wavelength; specular phases stay as traced.
        """
        if traced_m == wanted_m:
            return self
        ratio = wanted_m / traced_m
        return replace(
            self,
            scattered=_scaled(self.scattered, ratio),
            specular=_scaled(self.specular, ratio),
            candidates=replace(self.candidates, power=self.candidates.power * np.float32(ratio**2)),
        )

    def illuminated(self, front_end: FrontEnd) -> PathTable:
        """The table with amplitudes in sqrt(W): transmit power and the element patterns towards both ends applied."""
        scattered, specular = self.scattered, self.specular
        return replace(
            self,
            scattered=_scaled(scattered, amplitude_gain(front_end, scattered.tx_point, scattered.rx_point)),
            specular=_scaled(specular, amplitude_gain(front_end, specular.departure(), specular.image)),
        )

    def within(self, radar: Radar) -> PathTable:
        """Only the paths nearer than the unambiguous range, as behind a receiver's anti-alias filter; the rest is
        counted.
        """
        limit = radar.waveform.unambiguous_range_m
        near, near_specular = self.scattered.range_m() < limit, self.specular.range_m() < limit
        beyond = int((~near).sum() + (~near_specular).sum())
        return replace(
            self,
            scattered=self.scattered.take(near),
            specular=self.specular.take(near_specular),
            counts={**self.counts, "beyond_range": self.counts.get("beyond_range", 0) + beyond},
        )

    def take(self, scattered: NDArray, specular: NDArray) -> PathTable:
        """The paths at these indices, or where masks are true."""
        return replace(self, scattered=self.scattered.take(scattered), specular=self.specular.take(specular))


def amplitude_gain(front_end: FrontEnd, departure: Real, arrival: Real) -> Real:
    """[K] sqrt(P_t G_t G_r) towards points [K, 3] at which a wave departs and from which it arrives."""
    gains = front_end.tx_pattern.power_gain(departure) * front_end.rx_pattern.power_gain(arrival)
    return np.sqrt(front_end.transmit_power_w * gains)


def _scaled(paths, factor: Real | float):
    return replace(paths, amplitude=paths.amplitude * factor)
