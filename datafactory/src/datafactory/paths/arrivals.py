"""Waves of a frame where they meet surfaces, and what the RX hears of their scattering there.

A ray of N stands for the solid angle Omega = 4 pi / N of its tube, which plane mirrors keep, and so for Omega / (4 pi)
of unit power. The surface takes S^2 |Gamma|^2 of it, spreads it with the pattern f (:mod:`.scattering`), and the RX, r
away, has the aperture lambda^2 / (4 pi):

    A = lambda / (4 pi r) S |Gamma| sqrt(f Omega) e,    |Gamma| = |R e_i| / |e_i|,

with R the slab's reflection of the arriving field e_i, which has the factors of all that happened to it before, and e
its part along the RX's polarisation. The scattered field keeps its components along theta^ and phi^: Sionna's model
with K_x = 0. The surface's phase and the fan's solid angle are applied afterwards (:mod:`datafactory.paths.rows`).

Echoes are gathered by what happened on their way. Each such group is thinned by itself, with random numbers of its own:
what else is simulated changes none of its paths.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from datafactory.paths.cells import cell_of, thinned
from datafactory.paths.columns import WHOLE, Columns
from datafactory.paths.feet import NEAREST_M
from datafactory.paths.rays import RayFan
from datafactory.paths.scattering import share_at
from datafactory.paths.solver import Bundle
from datafactory.paths.table import DIFFUSE, SPECULAR
from datafactory.paths.view import Hits, View, Waves, polarization_axis
from shared.physics.compiled import compiled
from shared.physics.vectors import Complex, Index, Real, dots, lengths, taken

THINNING, DIRECTIONS = 1, 2
"""What a frame's random numbers are drawn for, beside the kinds of bounce of a group."""
MISSED_POLARIZATION = 1e-9
"""Share of a field along the RX's polarisation below which it is rounding: the echo of a surface has no part across."""


@dataclass(frozen=True)
class Arrivals(Columns):
    """n waves where they meet surfaces. Of those that are taken each stands for as much as before.

    :param waves: as they arrive; :param hits: where
    :param ratio: [n] solid angle of the fan's rays over 4 pi / N
    :param ray: [n] of the fan, rising
    :param kinds: of the bounces before
    :param rays: N, as many as fill the fan
    """

    view: View = field(metadata=WHOLE)
    waves: Waves
    hits: Hits
    ratio: Real
    ray: Index
    kinds: tuple[int, ...] = field(metadata=WHOLE)
    rays: float = field(metadata=WHOLE)

    @staticmethod
    def first(view: View, fan: RayFan) -> Arrivals:
        """Where the rays of a fan meet their first surfaces."""
        direction = fan.directions()
        field = polarization_axis(direction, view.settings.polarization[0]).astype(np.complex128)
        index, hits = view.hit_by(departing := Waves.departing(direction, field))
        ratio = fan.solid_angle_ratio(direction[index])
        return Arrivals(view, departing.arrived(index, hits), hits, ratio, index, (), fan.count)

    def followed(self, departing: Waves, kinds: tuple[int, ...]) -> tuple[Arrivals, Index]:
        """Where waves arrive that go on in place of these, and which of these go on to anything.

        :param kinds: of their bounces
        """
        index, hits = self.view.hit_by(departing)
        waves, ratio, ray = departing.arrived(index, hits), self.ratio[index], self.ray[index]
        return replace(self, waves=waves, hits=hits, ratio=ratio, ray=ray, kinds=kinds), index

    def share(self, each: int) -> Arrivals:
        """Those of every ``each``-th ray of the fan."""
        return self.take(self.ray % each == 0)

    def rest(self, each: int) -> Arrivals:
        """Those that are not in the share: what is found from both is what is found from all."""
        return self.take(self.ray % each != 0)

    def onward(self, direction: Real, field: Complex, kind: int) -> Arrivals:
        """Where those waves arrive next that leave in ``direction`` [n, 3], unit, with ``field`` [n, 3], not zero."""
        left = np.flatnonzero(field.any(axis=1))
        before = self.take(left)
        hits, waves = before.hits, before.waves
        direction, field = taken(direction, left), taken(field, left)
        turned = dots(self.view.velocity(hits.triangle, hits.point), waves.direction - direction)
        departing = Waves(
            hits.point,
            hits.clear(1.0),
            direction,
            field,
            waves.length,
            waves.rate + turned,
            np.concatenate([waves.bounced, hits.point[:, None]], axis=1),
            np.concatenate([waves.triangles, hits.triangle[:, None]], axis=1),
        )
        return before.followed(departing, (*self.kinds, kind))[0]

    def reflected(self) -> Arrivals:
        """Where those waves arrive next that the surfaces send on as mirrors: sqrt(1 - S^2) R of the field."""
        waves, hits, slabs = self.waves, self.hits, self.view.slabs
        direction, field = slabs.reflected(hits.mesh, waves.direction, hits.normal, waves.field)
        return self.onward(direction, field * slabs.unscattered(hits.mesh)[:, None], SPECULAR)

    def reflectivity(self) -> Real:
        """[n] |Gamma| of the module."""
        return self.view.slabs.reflectivity(self.hits.mesh, self.waves.direction, self.hits.normal, self.waves.field)

    def echoes(self) -> Echoes:
        """What the surfaces scatter back to the RX, where it sees them."""
        hits = self.hits
        seen = np.flatnonzero(lengths(hits.point) >= NEAREST_M)
        if self.kinds:
            seen = seen[dots(taken(hits.normal, seen), taken(hits.point, seen)) < 0.0]
            seen = seen[self.view.sight(taken(hits.point, seen), np.zeros(3))]
        # Home again, theta^ is where it was when the wave came, and phi^ is reversed: the RX looks against the wave.
        sign = 1.0 if self.view.settings.polarization[1] == "V" else -1.0
        return self.heard(seen, self.waves.field, sign * self.reflectivity(), 0)

    def heard(self, index: Index, field: Complex, kept: Real, crossings: int) -> Echoes:
        """The echoes of scattered fields.

        :param index: [m] of those waves that are heard
        :param field: [n, 3] as it is before it is scattered, or behind all panes
        :param kept: [n] the factor that scattering has on it besides S and f: |Gamma|, with its sign
        """
        waves, hits, view = self.waves, self.hits, self.view
        axis = polarization_axis(waves.direction, self.view.settings.polarization[1])
        arriving = _Arriving(
            waves.direction, waves.length, waves.rate, hits.point, hits.normal, hits.mesh,
            view.velocity(hits.triangle, hits.point), field, axis, kept, self.ratio,
        )  # fmt: skip
        scale = view.wavelength_m * np.sqrt(4.0 * np.pi / self.rays)
        amplitude, power, cell = _scattered_home(index, arriving, view.slabs.scattering, view.lobes, scale)
        return Echoes(self.take(index), amplitude, power, cell, (*self.kinds, DIFFUSE), crossings)


@dataclass(frozen=True)
class Echoes(Columns):
    """n echoes of one group that the RX hears.

    :param arrivals: where they are scattered last
    :param amplitude: [n] without the fan's solid angle; :param power: [n] with it
    :param cell: [n] resolution cell
    :param kinds: of all bounces; :param crossings: panes on the way
    """

    arrivals: Arrivals
    amplitude: Complex
    power: Real
    cell: Index
    kinds: tuple[int, ...] = field(metadata=WHOLE)
    crossings: int = field(metadata=WHOLE)

    def by_ray(self) -> Echoes:
        """The echoes of one group that were found from shares of a frame's rays, in the order of all rays."""
        return self.take(np.argsort(self.arrivals.ray, kind="stable"))

    def thinned(self, seed: int) -> Bundle:
        """Those that stay in their cells, as paths; the group's random numbers are its own."""
        random = np.random.default_rng([seed, THINNING, self.crossings, *self.kinds])
        most = self.arrivals.view.settings.most_in_a_cell
        if self.kinds[0] == SPECULAR:  # each enters the table with its reverse
            most = (most + 1) // 2
        index, factor = thinned(self.cell, self.power, most, random)
        left = self.arrivals.take(index)
        return Bundle(
            vertices=np.concatenate([left.waves.bounced, left.hits.point[:, None]], axis=1),
            interactions=np.tile(np.array(self.kinds, dtype=np.int64), (len(index), 1)),
            triangles=np.concatenate([left.waves.triangles, left.hits.triangle[:, None]], axis=1),
            crossings=np.full(len(index), self.crossings, dtype=np.int64),
            amplitude=self.amplitude[index] * np.sqrt(factor),
        )


class _Arriving(NamedTuple):
    """m waves where they are scattered.

    :param velocity: [m, 3] of the surface; :param axis: [m, 3] along which the RX hears the field
    """

    direction: Real
    length: Real
    rate: Real
    point: Real
    normal: Real
    mesh: Index
    velocity: Real
    field: Complex
    axis: Real
    kept: Real
    ratio: Real


@compiled(error_model="numpy")
def _scattered_home(index, waves, coefficient, lobes, scale):
    """Amplitudes [n], powers [n] and cells [n] of the echoes of the waves ``index`` [n].

    :param coefficient: S of every mesh; :param lobes: whether its pattern has lobes
    :param scale: lambda sqrt(Omega) of the module
    """
    count = len(index)
    amplitude, power = np.empty(count, dtype=np.complex128), np.empty(count)
    cell = np.empty(count, dtype=np.int64)
    for i in range(count):
        k = index[i]
        heard, whole = 0.0j, 0.0
        square, incidence, leaving, turned, departing, arriving = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for j in range(3):
            heard += waves.field[k, j] * waves.axis[k, j]
            whole += waves.field[k, j].real ** 2 + waves.field[k, j].imag ** 2
            square += waves.point[k, j] ** 2
            incidence -= waves.direction[k, j] * waves.normal[k, j]
            leaving -= waves.point[k, j] * waves.normal[k, j]
            turned -= waves.direction[k, j] * waves.point[k, j]
            arriving += waves.velocity[k, j] * waves.direction[k, j]
            departing += waves.velocity[k, j] * waves.point[k, j]
        distance = np.sqrt(square)
        if abs(heard) <= MISSED_POLARIZATION * np.sqrt(whole):
            heard = 0.0j
        f = share_at(lobes[waves.mesh[k]], incidence, leaving / distance, turned / distance)
        factor = waves.kept[k] * coefficient[waves.mesh[k]] * np.sqrt(f) * scale / (4.0 * np.pi * distance)
        amplitude[i] = heard.conjugate() * factor
        power[i] = (amplitude[i].real ** 2 + amplitude[i].imag ** 2) * waves.ratio[k]
        way = 0.5 * (waves.length[k] + distance)
        cell[i] = cell_of(way, waves.point[k, 1] / distance, 0.5 * (waves.rate[k] + arriving + departing / distance))
    return amplitude, power, cell
