"""Echoes that are scattered once, by the surface they reach last: every ray scatters wherever it arrives.

The solver follows one kind of bounce a ray and surface. It lets a ray scatter with a probability near S^2, so that one
in eleven rays on concrete (S = 0.3) becomes an echo, with eleven times the power. Here every ray scatters at the
surface that the sensor sees, and at the surfaces that it reaches through mirrors; the expectation of the power is the
same. A ray stands for the solid angle Omega of its tube, which plane mirrors keep. Of unit power on isotropic antennas
the tube holds Omega / (4 pi). The surface takes S^2 |Gamma|^2 of it, spreads it with the pattern f
(:mod:`datafactory.paths.scattering`), and the RX, r away, has the aperture lambda^2 / (4 pi):

    A = lambda / (4 pi r) S |Gamma| sqrt(f Omega) e,    |Gamma| = |R e_i| / |e_i|,

with R the slab's reflection of the arriving field e_i (:mod:`datafactory.paths.panes`), which has the factor
sqrt(1 - S^2) R of every mirror before, and e its part along the RX's polarisation. The scattered field keeps its
components along theta^ and phi^: Sionna's model with K_x = 0. That is lambda^2 / (4 pi)^3 times the integral of
sigma^0 / R^4 over the surface, sigma^0 = 4 pi S^2 |Gamma|^2 f cos(theta) (:func:`lambertian_sigma0` of the material
table).

The first surface may be seen through one pane, out and back, with the pane's transmission both ways.

What is dear is a path and not a ray, so that crowded resolution cells keep some of their paths, with the power of all
(:mod:`datafactory.paths.thinning`).

The surface's phase is applied afterwards (:mod:`datafactory.paths.trace`), and so is the fan's solid angle: Omega is
4 pi / N here.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from datafactory.paths.panes import polarization_axis
from datafactory.paths.ray_hits import clear_between, ray_margin_m
from datafactory.paths.rays import RayFan
from datafactory.paths.scattering import has_lobes, share_at
from datafactory.paths.solver import Bundle, TraceSettings
from datafactory.paths.surfaces import Complex, Hits, Index, Real, Surfaces, Waves
from datafactory.paths.table import DIFFUSE, SPECULAR
from datafactory.paths.thinning import cell_of, thinned
from datafactory.paths.wave_steps import passed_fields, reflected_fields, reflectivity
from shared.physics.compiled import compiled
from shared.physics.units import SPEED_OF_LIGHT
from shared.physics.vectors import dots, lengths, taken

CLOSEST_M = 0.01
"""Nearer surfaces do not scatter: the antennas' own size matters there. Single mirrors have the same bound."""
MISSED_POLARIZATION = 1e-9
"""Share of a field along the RX's polarisation below which it is rounding: the echo of a surface has no part across."""


@dataclass(frozen=True)
class _Frame:
    """What all echoes of a frame need."""

    surfaces: Surfaces
    settings: TraceSettings
    rays: int


@dataclass(frozen=True)
class _Echoes:
    """n echoes that the RX hears, of waves where they are scattered, and what arrives.

    :param index: [n] of the waves that are heard, and of their hits
    :param amplitude: [n] without the fan's solid angle; :param power: [n] with it
    :param cell: [n] resolution cell; :param crossings: panes on the way
    """

    waves: Waves
    hits: Hits
    index: Index
    amplitude: Complex
    power: Real
    cell: Index
    crossings: int

    def bundle(self, surfaces: Surfaces, index: Index, factor: Real) -> Bundle:
        """Those at ``index`` as paths, their powers times ``factor``."""
        waves, hits, of = self.waves, self.hits, self.index[index]
        triangles = np.concatenate([taken(waves.triangles, of), taken(hits.triangle, of)[:, None]], axis=1)
        vertices = np.concatenate([taken(waves.bounced, of), taken(hits.point, of)[:, None]], axis=1)
        kinds = np.full(triangles.shape, SPECULAR, dtype=np.int64)
        kinds[:, -1] = DIFFUSE
        return Bundle(
            vertices=vertices,
            interactions=kinds,
            objects=surfaces.object_of_triangle[triangles],
            triangles=triangles,
            velocities=surfaces.velocity(triangles.reshape(-1), vertices.reshape(-1, 3)).reshape(vertices.shape),
            crossings=np.full(len(index), self.crossings, dtype=np.int64),
            amplitude=self.amplitude[index] * np.sqrt(factor),
        )


def scattered_once(
    surfaces: Surfaces,
    settings: TraceSettings,
    fan: RayFan,
    seed: int,
) -> list[Bundle]:
    """The echoes of a frame that are scattered once, at their last bounce: for each number of bounces, by ray.

    :param seed: of the choice of the paths that stay
    """
    if not settings.diffuse:
        return []
    frame = _Frame(surfaces, settings, fan.count)
    direction = fan.directions()
    transmitted = polarization_axis(direction, settings.polarization[0]).astype(np.complex128)
    waves = Waves.departing(direction, transmitted)
    ratio = fan.solid_angle_ratio(direction)
    coefficient = np.array([slab.scattering_coefficient for slab in surfaces.slabs])
    echoes = list[_Echoes]()
    for bounce in range(settings.depth):
        index, hits = surfaces.hit_by(waves)
        waves, ratio = waves.arrived(index, hits), ratio[index]
        te, tm = surfaces.reflection(hits)
        echoes.append(_echoes(frame, waves, hits, te, tm, ratio))
        if bounce == 0 and settings.refraction:
            echoes.append(_echoes_behind_panes(frame, waves, hits, ratio))
        if bounce + 1 == settings.depth or not settings.specular:
            break
        onward, reflected = reflected_fields(waves.direction, hits.normal, waves.field, te, tm)
        smooth = np.sqrt(1.0 - coefficient**2)[hits.mesh]
        turned = dots(surfaces.velocity(hits.triangle, hits.point), waves.direction - onward)
        waves = Waves(
            hits.point,
            _clear_of(hits, 1.0),
            onward,
            reflected * smooth[:, None],
            waves.length,
            waves.rate + turned,
            np.concatenate([waves.bounced, hits.point[:, None]], axis=1),
            np.concatenate([waves.triangles, hits.triangle[:, None]], axis=1),
        ).take(np.flatnonzero(smooth > 0.0))
        ratio = ratio[smooth > 0.0]
    return _thinned_bundles(frame, echoes, seed)


def _thinned_bundles(frame: _Frame, echoes: list[_Echoes], seed: int) -> list[Bundle]:
    """The paths of all echoes together, thinned, for each number of bounces."""
    starts = np.cumsum([0, *(len(part.amplitude) for part in echoes)])
    cell, power = (np.concatenate([getattr(part, name) for part in echoes]) for name in ("cell", "power"))
    index, factor = thinned(cell, power, frame.settings.most_in_a_cell, np.random.default_rng(seed))
    bundles: dict[int, list[Bundle]] = {}
    for part, start, stop in zip(echoes, starts, starts[1:], strict=False):
        own = slice(*np.searchsorted(index, (start, stop)))
        bundle = part.bundle(frame.surfaces, index[own] - start, factor[own])
        bundles.setdefault(bundle.interactions.shape[1], []).append(bundle)
    return [Bundle.joined(bundles[bounces]) for bounces in sorted(bundles)]


def _clear_of(hits: Hits, side: float) -> Real:
    """[n, 3] the points off their surfaces by the ray caster's error: 1 on the side of arrival, -1 behind."""
    return hits.point + side * ray_margin_m(lengths(hits.point))[:, None] * hits.normal


def _echoes(frame: _Frame, waves: Waves, hits: Hits, te: Complex, tm: Complex, ratio: Real) -> _Echoes:
    """What the surfaces scatter back to the RX, where it sees them.

    :param te, tm: [n] R of the surfaces
    """
    seen = lengths(hits.point) >= CLOSEST_M
    if waves.bounced.shape[1]:
        index = np.flatnonzero(seen & (dots(hits.normal, hits.point) < 0.0))
        seen = np.zeros(len(seen), dtype=bool)
        seen[index] = clear_between(frame.surfaces.geometry, taken(hits.point, index), np.zeros(3))
    # Home again, theta^ is where it was when the wave came, and phi^ is reversed: the RX looks against the wave.
    sign = 1.0 if frame.settings.polarization[1] == "V" else -1.0
    kept = sign * reflectivity(waves.direction, hits.normal, waves.field, te, tm)
    return _heard(frame, waves, hits, np.flatnonzero(seen), waves.field, kept, ratio, 0)


def _echoes_behind_panes(frame: _Frame, waves: Waves, hits: Hits, ratio: Real) -> _Echoes:
    """What is scattered back through the first surface by what stands behind it."""
    surfaces = frame.surfaces
    clear = np.flatnonzero(surfaces.lets_through()[hits.mesh])
    waves, panes, ratio = waves.take(clear), hits.take(clear), ratio[clear]
    te, tm = surfaces.transmission(panes)
    field = passed_fields(waves.direction, panes.normal, waves.field, te, tm)
    waves = replace(waves, lifted=_clear_of(panes, -1.0), field=field)
    index, hits = surfaces.hit_by(waves)
    waves, panes, ratio, te, tm = waves.arrived(index, hits), panes.take(index), ratio[index], te[index], tm[index]
    turned = _turned_back(waves.field, polarization_axis(waves.direction, "V"))
    back = passed_fields(waves.direction, panes.normal, turned, te, tm)
    kept = reflectivity(waves.direction, hits.normal, waves.field, *surfaces.reflection(hits))
    return _heard(frame, waves, hits, np.arange(len(back)), back, kept, ratio, 2)


@compiled()
def _turned_back(field, vertical):
    """[n, 3] fields that go back the way they came: the same along theta^, ``vertical`` [n, 3], reversed along phi^."""
    back = np.empty_like(field)
    for k in range(len(field)):
        along = field[k, 0] * vertical[k, 0] + field[k, 1] * vertical[k, 1] + field[k, 2] * vertical[k, 2]
        for i in range(3):
            back[k, i] = 2.0 * along * vertical[k, i] - field[k, i]
    return back


def _heard(
    frame: _Frame, waves: Waves, hits: Hits, index: Index, field: Complex, kept: Real, ratio: Real, crossings: int
) -> _Echoes:
    """The echoes of scattered fields.

    :param index: [n] of those waves that are heard
    :param field: [m, 3] of all waves, as it is before it is scattered, or behind all panes
    :param kept: [m] the factor that scattering has on it besides S and f: |Gamma|, with its sign
    :param ratio: [m] solid angle of the fan's rays over 4 pi / N
    """
    surfaces = frame.surfaces
    amplitude, power, cell = _arriving(
        index, waves.direction, waves.length, waves.rate, hits.point, hits.normal, hits.mesh,
        surfaces.velocity(hits.triangle, hits.point), field,
        polarization_axis(waves.direction, frame.settings.polarization[1]), kept, ratio,
        np.array([slab.scattering_coefficient for slab in surfaces.slabs]),
        np.array([has_lobes(slab.pattern) for slab in surfaces.slabs]),
        SPEED_OF_LIGHT / surfaces.frequency_hz * np.sqrt(4.0 * np.pi / frame.rays),
    )  # fmt: skip
    return _Echoes(waves, hits, index, amplitude, power, cell, crossings)


@compiled(error_model="numpy")
def _arriving(
    index, direction, length, rate, point, normal, mesh, velocity, field, axis, kept, ratio, coefficient, lobes,
    scale,
):  # fmt: skip
    """Amplitudes [n], powers [n] and cells [n] of the echoes of the waves ``index`` [n]; their values are [m].

    :param axis: [m, 3] along which the RX hears the field
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
            heard += field[k, j] * axis[k, j]
            whole += field[k, j].real ** 2 + field[k, j].imag ** 2
            square += point[k, j] ** 2
            incidence -= direction[k, j] * normal[k, j]
            leaving -= point[k, j] * normal[k, j]
            turned -= direction[k, j] * point[k, j]
            arriving += velocity[k, j] * direction[k, j]
            departing += velocity[k, j] * point[k, j]
        distance = np.sqrt(square)
        if abs(heard) <= MISSED_POLARIZATION * np.sqrt(whole):
            heard = 0.0j
        f = share_at(lobes[mesh[k]], incidence, leaving / distance, turned / distance)
        factor = kept[k] * coefficient[mesh[k]] * np.sqrt(f) * scale / (4.0 * np.pi * distance)
        amplitude[i] = heard.conjugate() * factor
        power[i] = (amplitude[i].real ** 2 + amplitude[i].imag ** 2) * ratio[k]
        way = 0.5 * (length[k] + distance)
        cell[i] = cell_of(way, point[k, 1] / distance, 0.5 * (rate[k] + arriving + departing / distance))
    return amplitude, power, cell
