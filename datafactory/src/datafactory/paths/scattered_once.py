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
from datafactory.paths.scattering import scattered_share
from datafactory.paths.solver import Bundle, TraceSettings
from datafactory.paths.surfaces import Complex, Hits, Index, Real, Surfaces, Waves
from datafactory.paths.table import DIFFUSE, SPECULAR
from datafactory.paths.thinning import cells_of, thinned
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
    """n echoes that the RX hears: waves, where they are scattered, and what arrives.

    :param amplitude: [n] without the fan's solid angle; :param power: [n] with it
    :param cell: [n] resolution cell; :param crossings: panes on the way
    """

    waves: Waves
    hits: Hits
    amplitude: Complex
    power: Real
    cell: Index
    crossings: int

    def bundle(self, surfaces: Surfaces, index: Index, factor: Real) -> Bundle:
        """Those at ``index`` as paths, their powers times ``factor``."""
        waves, hits = self.waves, self.hits
        triangles = np.concatenate([taken(waves.triangles, index), taken(hits.triangle, index)[:, None]], axis=1)
        vertices = np.concatenate([taken(waves.bounced, index), taken(hits.point, index)[:, None]], axis=1)
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
        waves, ratio = waves.take(index), ratio[index]
        onward, reflected = surfaces.reflected(waves.direction, waves.field, hits)
        echoes.append(_echoes(frame, waves, hits, reflected, ratio))
        if bounce == 0 and settings.refraction:
            echoes.append(_echoes_behind_panes(frame, waves, hits, ratio))
        if bounce + 1 == settings.depth or not settings.specular:
            break
        smooth = np.sqrt(1.0 - coefficient**2)[hits.mesh]
        turned = dots(surfaces.velocity(hits.triangle, hits.point), waves.direction - onward)
        waves = Waves(
            hits.point,
            _clear_of(hits, 1.0),
            onward,
            reflected * smooth[:, None],
            waves.length + lengths(hits.point - waves.start),
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


def _echoes(frame: _Frame, waves: Waves, hits: Hits, reflected: Complex, ratio: Real) -> _Echoes:
    """What the surfaces scatter back to the RX, where it sees them."""
    range_m = lengths(hits.point)
    home = -hits.point / np.maximum(range_m, CLOSEST_M)[:, None]
    seen = range_m >= CLOSEST_M
    if waves.bounced.shape[1]:
        seen &= dots(hits.normal, home) > 0.0
        index = np.flatnonzero(seen)
        seen[index] = clear_between(frame.surfaces.geometry, taken(hits.point, index), np.zeros(3))
    index = np.flatnonzero(seen)
    waves, hits, home, ratio = waves.take(index), hits.take(index), taken(home, index), ratio[index]
    # Home again, theta^ is where it was when the wave came, and phi^ is reversed: the RX looks against the wave.
    polarization = frame.settings.polarization[1]
    sign = 1.0 if polarization == "V" else -1.0
    part = _along(waves.field, polarization_axis(waves.direction, polarization))
    before = np.sqrt(_power(waves.field))
    share = np.sqrt(_power(taken(reflected, index))) / np.maximum(before, np.finfo(float).tiny)
    part[np.abs(part) <= MISSED_POLARIZATION * before] = 0.0
    return _heard(frame, waves, hits, sign * share * part, home, ratio, 0)


@compiled()
def _power(field):
    """[n] |e|^2 of fields [n, 3]."""
    result = np.empty(len(field))
    for k in range(len(field)):
        x, y, z = field[k, 0], field[k, 1], field[k, 2]
        result[k] = (x.real * x.real + y.real * y.real + z.real * z.real) + (
            x.imag * x.imag + y.imag * y.imag + z.imag * z.imag
        )
    return result


@compiled()
def _along(field, axis):
    """[n] the components of fields [n, 3] along real axes [n, 3]."""
    result = np.empty(len(field), dtype=np.complex128)
    for k in range(len(field)):
        result[k] = field[k, 0] * axis[k, 0] + field[k, 1] * axis[k, 1] + field[k, 2] * axis[k, 2]
    return result


def _turned_back(field: Complex, arrival: Real, departure: Real) -> Complex:
    """[n, 3] the field with its components along theta^ and phi^ of the arrival along those of the departure."""
    total = np.zeros_like(field)
    for which in ("V", "H"):
        component = _along(field, polarization_axis(arrival, which))
        total += component[:, None] * polarization_axis(departure, which)
    return total


def _echoes_behind_panes(frame: _Frame, waves: Waves, hits: Hits, ratio: Real) -> _Echoes:
    """What is scattered back through the first surface by what stands behind it."""
    surfaces = frame.surfaces
    clear = np.flatnonzero(surfaces.lets_through()[hits.mesh])
    waves, panes, ratio = waves.take(clear), hits.take(clear), ratio[clear]
    field = surfaces.passed(waves.direction, panes, waves.field)
    waves = replace(waves, start=panes.point, lifted=_clear_of(panes, -1.0), field=field)
    index, hits = surfaces.hit_by(waves)
    waves, panes, ratio = waves.take(index), panes.take(index), ratio[index]
    _, reflected = surfaces.reflected(waves.direction, waves.field, hits)
    home = -waves.direction
    share = np.sqrt(_power(reflected) / _power(waves.field))
    scattered = _turned_back(waves.field, waves.direction, home) * share[:, None]
    back = surfaces.passed(home, panes, scattered)
    part = _along(back, polarization_axis(waves.direction, frame.settings.polarization[1]))
    part[np.abs(part) <= MISSED_POLARIZATION * np.sqrt(_power(back))] = 0.0
    return _heard(frame, waves, hits, part, home, ratio, 2)


def _heard(frame: _Frame, waves: Waves, hits: Hits, heard: Complex, home: Real, ratio: Real, crossings: int) -> _Echoes:
    """The echoes of scattered fields.

    :param heard: [n] part of the field along the RX's polarisation, |Gamma| e of the module
    :param home: [n, 3] unit directions from the surfaces to the RX
    :param ratio: [n] solid angle of the fan's rays over 4 pi / N
    """
    surfaces = frame.surfaces
    wavelength = SPEED_OF_LIGHT / surfaces.frequency_hz
    factor = np.zeros(len(heard))
    for slab, here in surfaces.by_mesh(hits.mesh):
        f = scattered_share(slab.pattern, waves.direction[here], home[here], hits.normal[here])
        factor[here] = slab.scattering_coefficient * np.sqrt(f * 4.0 * np.pi / frame.rays)
    range_m = lengths(hits.point)
    amplitude: Complex = heard.conj() * (factor * wavelength / (4.0 * np.pi * range_m)).astype(np.complex128)
    last = lengths(hits.point - (waves.start if waves.bounced.shape[1] else 0.0))
    turned = dots(surfaces.velocity(hits.triangle, hits.point), waves.direction - home)
    cell = cells_of(0.5 * (waves.length + last + range_m), -home[:, 1], 0.5 * (waves.rate + turned))
    return _Echoes(waves, hits, amplitude, np.abs(amplitude) ** 2 * ratio, cell, crossings)
