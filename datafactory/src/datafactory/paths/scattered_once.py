"""Echoes that are scattered once, by the surface they reach last: every ray scatters wherever it arrives.

The solver follows one kind of bounce a ray and surface. It lets a ray scatter with a probability near S^2, so that one
in eleven rays on concrete (S = 0.3) becomes an echo, with eleven times the power. Here every ray scatters at the
surface that the sensor sees, and at the surfaces that it reaches through mirrors; the expectation of the power is the
same. :mod:`datafactory.paths.arrivals` has the amplitudes. Of the surfaces in sight they are lambda^2 / (4 pi)^3 times
the integral of sigma^0 / R^4 over the surface, sigma^0 = 4 pi S^2 |Gamma|^2 f cos(theta) (:func:`lambertian_sigma0` of
the material table).

A mirror before has the factor sqrt(1 - S^2) R. The first surface may be seen through one pane, out and back, with the
pane's transmission both ways.

What is dear is a path and not a ray, so that crowded resolution cells keep some of their paths, with the power of all
(:mod:`datafactory.paths.thinning`).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from datafactory.paths.arrivals import Arrivals, Echoes, clear_of
from datafactory.paths.panes import polarization_axis
from datafactory.paths.wave_steps import passed_fields, reflectivity
from shared.physics.compiled import compiled


def over_mirrors(first: Arrivals) -> list[Echoes]:
    """What is scattered last, after mirrors alone: for each number of bounces from two on.

    :param first: where the frame's rays meet their first surfaces, or a share of them
    """
    echoes, arrivals = list[Echoes](), first
    while first.settings.specular and len(arrivals.kinds) + 1 < first.settings.depth:
        arrivals = arrivals.reflected()
        echoes.append(arrivals.echoes())
    return echoes


def behind_panes(first: Arrivals) -> Echoes:
    """What is scattered back through the first surface by what stands behind it."""
    view = first.view
    first = first.take(np.flatnonzero(view.slabs.lets_through[first.hits.mesh]))
    waves, panes = first.waves, first.hits
    te, tm = view.transmission(panes)
    field = passed_fields(waves.direction, panes.normal, waves.field, te, tm)
    waves = replace(waves, lifted=clear_of(panes, -1.0), field=field)
    index, hits = view.hit_by(waves)
    waves, panes, te, tm = waves.arrived(index, hits), panes.take(index), te[index], tm[index]
    turned = _turned_back(waves.field, polarization_axis(waves.direction, "V"))
    back = passed_fields(waves.direction, panes.normal, turned, te, tm)
    te, tm = view.reflection(hits)
    kept = reflectivity(waves.direction, hits.normal, waves.field, te, tm)
    behind = replace(first, waves=waves, hits=hits, te=te, tm=tm, ratio=first.ratio[index], ray=first.ray[index])
    return behind.heard(np.arange(len(back)), back, kept, 2)


@compiled()
def _turned_back(field, vertical):
    """[n, 3] fields that go back the way they came: the same along theta^, ``vertical`` [n, 3], reversed along phi^."""
    back = np.empty_like(field)
    for k in range(len(field)):
        along = field[k, 0] * vertical[k, 0] + field[k, 1] * vertical[k, 1] + field[k, 2] * vertical[k, 2]
        for i in range(3):
            back[k, i] = 2.0 * along * vertical[k, i] - field[k, i]
    return back
