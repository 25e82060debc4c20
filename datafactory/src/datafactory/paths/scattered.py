"""Echoes of rough surfaces: every ray scatters wherever it arrives; what a thin share of the rays tells of the others.

**Once, by the surface that a wave reaches last** (docs/notes/speckle.md). The solver lets a ray scatter with a
probability near S^2. Here every ray scatters at the surface that the sensor sees, and at the surfaces that it reaches
through mirrors; the expectation of the power is the same. :mod:`datafactory.paths.arrivals` has the amplitudes. Of the
surfaces in sight they are lambda^2 / (4 pi)^3 times the integral of sigma^0 / R^4 over the surface, sigma^0 = 4 pi S^2
|Gamma|^2 f cos(theta) (:func:`datafactory.scenes.materials.reflectivity.lambertian_sigma0`). A mirror before has the
factor sqrt(1 - S^2) R. The first surface may be seen through one pane, with its transmission out and back.

**Twice, or more often.** At a surface a wave's ray goes on in one direction k', drawn with the density q over the half
space in front. It carries f / q of what is scattered, so that the expectation of its power is the surface's
S^2 |Gamma|^2 f, whatever q is:

    e' = S |Gamma| sqrt(f / q) (e_theta theta^' + e_phi phi^').

A Lambertian surface has q = cos(theta) / pi = f. A pattern with lobes has q = 1 / (2 pi); with q of the cosine a lobe
along the surface would have weights without a bound. From three bounces on the ray may as well go on as from a mirror.
Both orders of a pair of surfaces are drawn, each with its half of the power; that they add in phase (coherent
backscattering, up to 3 dB) is left out, as in Sionna. Left out too: panes on the way; what ends with a mirror, for
which its reverse stands. The random numbers of a ray are its own, so that its echoes are too.

**Second bounces** are followed with all of a frame's rays only where they matter (docs/notes/planning.md). Waves
scattered twice are found from one ray in many as it is: they are their own estimate. Waves mirrored and then scattered
are looked for along every k-th ray first. Each echo of that share stands for what k rays would bring. Of n echoes alike
in a resolution cell the sum has the standard error 1 / sqrt(n) of itself, so that three times the power of a single one
is the estimate and two standard errors above. Where the group is followed, the other rays are added.

**Chains of mirrors** are the solver's (:mod:`datafactory.paths.solver`); whether there are any, the same share tells.
The sequences of triangles that its rays meet, as from mirrors, hold the chains between faces that these rays do not
miss. Of each the image method says whether there is a way that closes: with I_0 = 0 and I_j the image of I_j-1 in the
plane of mirror j, the wave comes home along the line from I_n to the radar, and meets the mirrors where that line,
unfolded mirror by mirror, crosses their planes. The echo of a chain of length L is at most lambda / (4 pi L), that of
perfect mirrors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from datafactory.defaults import LARGEST_DEPTH
from datafactory.paths.arrivals import DIRECTIONS, Arrivals, Echoes
from datafactory.paths.candidates import CHAIN, MIRRORED, PASSED, TWICE, Candidates
from datafactory.paths.corners import CornerEdges, corners_of
from datafactory.paths.merged_scene import barycentric
from datafactory.paths.scattering import share_at
from datafactory.paths.table import DIFFUSE, SPECULAR
from datafactory.paths.view import AXES, Hits, View, polarization_axis
from shared.physics.compiled import compiled
from shared.physics.vectors import Index, Real, dots, lengths

LEAST_RAYS = 1_000
"""No fewer are followed, where there are as many."""
GRAZING = 1e-4
"""Least cosine of a direction drawn to its surface: nearer ones run into the surface itself in float32."""
THIN_RAYS, THINNEST = 12_500, 16
"""As many rays as find chains between small faces (:data:`datafactory.paths.solver.LEAST_SOLVER_RAYS`)."""
SURE = 3.0
"""Estimate and two standard errors of a cell in which one echo was found, over that echo."""
LARGER = 2.0
"""How much larger than it is, about its centre, a triangle counts in each direction."""


def over_mirrors(first: Arrivals) -> list[Echoes]:
    """What is scattered last, after mirrors alone: for each number of bounces from two on.

    :param first: where the frame's rays meet their first surfaces, or a share of them
    """
    return [arrivals.echoes() for arrivals in _reflected(first, first.view.settings.depth - 1)]


def _reflected(first: Arrivals, most: int) -> list[Arrivals]:
    """Where waves arrive after one mirror, after two, ``most`` at most; empty where there are no mirrors."""
    found = [first]
    for _ in range(most if first.view.settings.specular else 0):
        found.append(found[-1].reflected())
    return found[1:]


def through_panes(arrivals: Arrivals) -> tuple[Arrivals, Hits]:
    """Where those waves arrive next that meet a pane and go on through it, and where they met it."""
    met = arrivals.take(arrivals.view.slabs.lets_through[arrivals.hits.mesh])
    waves, panes = met.waves, met.hits
    field = met.view.slabs.passed(panes.mesh, waves.direction, panes.normal, waves.field)
    beyond, index = met.followed(replace(waves, lifted=panes.clear(-1.0), field=field), met.kinds)
    return beyond, panes.take(index)


def behind_panes(first: Arrivals) -> Echoes:
    """What is scattered back through the first surface by what stands behind it."""
    beyond, panes = through_panes(first)
    waves = beyond.waves
    turned = _turned_back(waves.field, polarization_axis(waves.direction, "V"))
    back = first.view.slabs.passed(panes.mesh, waves.direction, panes.normal, turned)
    return beyond.heard(np.arange(len(back)), back, beyond.reflectivity(), 2)


@compiled()
def _turned_back(field, vertical):
    """[n, 3] fields that go back the way they came: the same along theta^, ``vertical`` [n, 3], reversed along phi^."""
    back = np.empty_like(field)
    for k in range(len(field)):
        along = field[k, 0] * vertical[k, 0] + field[k, 1] * vertical[k, 1] + field[k, 2] * vertical[k, 2]
        for i in range(3):
            back[k, i] = 2.0 * along * vertical[k, i] - field[k, i]
    return back


def scattered_twice(first: Arrivals, seed: int) -> list[Echoes]:
    """What is scattered twice and more often, by the kinds of bounce.

    :param first: where the frame's rays meet their first surfaces, or a share of them
    :param seed: of the directions
    """
    settings, rays = first.view.settings, round(first.rays)
    each = max(min(settings.twice_share, rays // LEAST_RAYS), 1)
    followed = replace(first.share(each), rays=first.rays / each)
    echoes, front = list[Echoes](), [followed]
    for bounce in range(1, settings.depth):
        following = list[Arrivals]()
        for arrivals in front:
            random = np.random.default_rng([seed, DIRECTIONS, *arrivals.kinds]).random((rays // each + 1, 2))
            following.append(_scattered(arrivals, random[arrivals.ray // each]))
            if settings.specular and (DIFFUSE in arrivals.kinds or bounce + 1 < settings.depth):
                following.append(arrivals.reflected())
        front = following
        echoes += [arrivals.echoes() for arrivals in front if DIFFUSE in arrivals.kinds]
    return echoes


def _scattered(arrivals: Arrivals, random: Real) -> Arrivals:
    """Where those waves arrive next that the surfaces scatter on, each in one direction.

    :param random: [n, 2] 0 to 1
    """
    view, waves, hits = arrivals.view, arrivals.waves, arrivals.hits
    direction, weight = _drawn(waves.direction, hits.normal, view.lobes[hits.mesh], random)
    kept = arrivals.reflectivity() * view.slabs.scattering[hits.mesh] * np.sqrt(weight)
    field = np.zeros(waves.field.shape, dtype=np.complex128)
    for which in AXES:
        part = np.einsum("ni,ni->n", waves.field, polarization_axis(waves.direction, which)) * kept
        field += part[:, None] * polarization_axis(direction, which)
    return arrivals.onward(direction, field, DIFFUSE)


@compiled(error_model="numpy")
def _drawn(direction, normal, lobes, random):
    """Directions [n, 3] in which surfaces scatter, and f / q [n] of the module.

    :param direction: [n, 3] of arrival; :param normal: [n, 3] unit, on its side
    :param lobes: [n] whether the pattern has lobes; :param random: [n, 2] 0 to 1
    """
    drawn, weight = np.empty((len(direction), 3)), np.empty(len(direction))
    for k in range(len(direction)):
        d, n = direction[k], normal[k]
        up = random[k, 0] if lobes[k] else np.sqrt(random[k, 0])
        up = max(up, GRAZING)
        level, turn = np.sqrt(max(1.0 - up * up, 0.0)), 2.0 * np.pi * random[k, 1]
        # Two axes across the normal, without a branch but for its sign (Duff et al. 2017, JCGT 6).
        sign = 1.0 if n[2] >= 0.0 else -1.0
        a = -1.0 / (sign + n[2])
        b = n[0] * n[1] * a
        x, y = level * np.cos(turn), level * np.sin(turn)
        drawn[k, 0] = x * (1.0 + sign * n[0] * n[0] * a) + y * b + up * n[0]
        drawn[k, 1] = x * sign * b + y * (sign + n[1] * n[1] * a) + up * n[1]
        drawn[k, 2] = -x * sign * n[0] - y * n[1] + up * n[2]
        incidence, turned = 0.0, 0.0
        for i in range(3):
            incidence -= d[i] * n[i]
            turned += d[i] * drawn[k, i]
        weight[k] = 2.0 * np.pi * share_at(True, incidence, up, turned) if lobes[k] else 1.0
    return drawn, weight


class SecondBounces:
    """What a frame's rays meet after their first surface.

    :param first: where they meet it; :param seed: of the directions in which it scatters
    """

    def __init__(self, first: Arrivals, seed: int) -> None:
        self._first, self._each = first, max(min(THINNEST, len(first.ray) // THIN_RAYS), 1)
        self._thin = first.share(self._each)
        self._reflected, self._twice = _reflected(self._thin, LARGEST_DEPTH - 1), scattered_twice(first, seed)
        self._mirrored = [arrivals.echoes() for arrivals in self._reflected[: first.view.settings.depth - 1]]

    def candidates(self, panes: bool) -> dict[int, Candidates]:
        """Of each group.

        :param panes: whether waves go through any
        """
        mirrored = [_estimates(MIRRORED, echoes, self._each) for echoes in self._mirrored]
        twice = [_estimates(TWICE, echoes, 1) for echoes in self._twice]
        return {
            MIRRORED: Candidates.joined([Candidates.none(), *mirrored]),
            TWICE: Candidates.joined([Candidates.none(), *twice]),
            **self._chains(panes),
        }

    def _chains(self, panes: bool) -> dict[int, Candidates]:
        view = self._thin.view
        found: dict[int, list[Index]] = {CHAIN: [], PASSED: []}
        if not self._reflected:
            return dict.fromkeys(found, Candidates.none())
        passed = [through_panes(self._thin)[0]] if panes else []
        for arrivals in self._reflected:
            found[CHAIN].append(_met(arrivals))
            if panes:
                passed = [beyond.reflected() for beyond in passed]
                passed += [through_panes(before)[0] for before in (arrivals, *passed)]
                found[PASSED] += map(_met, passed)
        corners = {CHAIN: corners_of(view.merged) if view.settings.corners else None, PASSED: None}
        return {family: chain_candidates(family, met, view, corners[family]) for family, met in found.items()}

    def echoes(self, group: int) -> list[Echoes]:
        """All echoes of a group, by the kinds of bounce."""
        if group == TWICE:
            return self._twice
        if self._each == 1:
            return self._mirrored
        both = zip(self._mirrored, over_mirrors(self._first.rest(self._each)), strict=True)
        return [Echoes.joined(parts).by_ray() for parts in both]


def _met(arrivals: Arrivals) -> Index:
    """[n, mirrors] triangles that waves have met, the last one where they arrive."""
    return np.concatenate([arrivals.waves.triangles, arrivals.hits.triangle[:, None]], axis=1)


def _estimates(group: int, echoes: Echoes, stands_for: int) -> Candidates:
    """Of echoes in a thin share: each way round, for what begins with a mirror stands for its reverse as well.

    :param stands_for: as many rays as one of the share
    """
    waves, last = echoes.arrivals.waves, echoes.arrivals.hits.point
    first, range_m = waves.bounced[:, 0], 0.5 * (waves.length + lengths(last))
    power = SURE * stands_for * echoes.power
    there = Candidates.of(group, last, power, range_m, first)
    if echoes.kinds[0] != SPECULAR:
        return there
    return Candidates.joined([there, Candidates.of(group, first, power, range_m, last)])


def chain_candidates(family: int, sequences: Sequence[Index], view: View, corners: CornerEdges | None) -> Candidates:
    """Of every sequence of triangles over which a way closes.

    :param family: ``CHAIN``, or ``PASSED`` where rays went through panes
    :param sequences: triangles [n, mirrors] in the order in which rays met them
    :param corners: right-angled, whose own chains are left out; None where those are the solver's, behind panes
    """
    found, wavelength_m = [Candidates.none()], view.wavelength_m
    for sequence in sequences:
        some = np.unique(sequence, axis=0)
        if corners is not None:
            some = some[~corners.hold(some)]
        image, departure = _closed(view.corners[some], view.normals[some], view.heights[some])
        length = np.linalg.norm(image, axis=1)
        power = (wavelength_m / (4.0 * np.pi * np.maximum(length, wavelength_m))) ** 2
        found.append(Candidates.of(family, image, power, 0.5 * length, departure))
    return Candidates.joined(found)


def _closed(corner: Real, normal: Real, height: Real) -> tuple[Real, Real]:
    """Of the sequences [n, m] whose way closes: the image of the origin [k, 3] and the first mirror's point [k, 3]."""
    count, mirrors = height.shape
    images = [np.zeros((count, 3))]
    for step in range(mirrors):
        n = normal[:, step]
        images.append(images[-1] - 2.0 * (dots(n, images[-1]) - height[:, step])[:, None] * n)
    place, closes = np.zeros((count, 3)), np.ones(count, dtype=bool)
    for step in range(mirrors - 1, -1, -1):
        n, along = normal[:, step], images[step + 1] - place
        slope = dots(n, along)
        share = (height[:, step] - dots(n, place)) / np.where(slope == 0.0, np.inf, slope)
        place = place + share[:, None] * along
        closes &= (share > 0.0) & (share < 1.0)
        closes &= barycentric(corner[:, step], place).min(axis=1) >= (1.0 - LARGER) / 3.0
    return images[-1][closes], place[closes]
