"""Single mirrors on curved surfaces: where their echoes come from, how strong they are, when they arrive.

    A = conj(Gamma) sqrt(1 - S^2) lambda / (4 pi 2 R) G F

with Gamma and S as for a plane (:mod:`datafactory.paths.mirror_feet`), the divergence G and the share F of a surface
that ends (:mod:`datafactory.paths.curved_echoes`). The incidence at a foot is normal. Echoes have no cross-polarised
part.
"""

from __future__ import annotations

import numpy as np

from datafactory.paths.curved_echoes import EchoFields, curved_paths, curved_shares
from datafactory.paths.curved_feet import curved_feet
from datafactory.paths.curved_surfaces import curved_surfaces_of
from datafactory.paths.mirror_feet import AHEAD_M, CLOSEST_M, plane_amplitude, way_and_back
from datafactory.paths.table import ScatteredPaths, SpecularPaths
from datafactory.paths.view import View


def curved_mirrors(view: View) -> tuple[ScatteredPaths, SpecularPaths, dict[str, int]]:
    """All single echoes of curved surfaces in a frame, by the delay law that suits each, and counts.

    :return: counts are ``curved_mirrors``, ``curved_mirrors_hidden``, ``triangles_round_their_focus`` of scenes that
        have a curved surface, and ``facets_too_coarse`` of those whose facets may stand for one
    """
    surfaces, settings = curved_surfaces_of(view.merged), view.settings
    counts = {"facets_too_coarse": surfaces.coarse} if surfaces.coarse else dict[str, int]()
    if not len(surfaces) or settings.polarization[0] != settings.polarization[1]:
        return ScatteredPaths.none(), SpecularPaths.none(), counts
    mesh_of_triangle = view.merged.mesh_of_triangle
    moved = view.moved[mesh_of_triangle[surfaces.triangle]]
    every, focused = curved_feet(surfaces, moved, view.rotation, -AHEAD_M)
    every = every.take(every.range_m() >= CLOSEST_M)
    passed, kinds = way_and_back(view, every.seen_to)
    seen = np.flatnonzero(passed != 0.0)
    feet = every.take(seen)
    mesh = mesh_of_triangle[feet.triangle]
    shares = curved_shares(surfaces, feet, view.moved[mesh], view.rotation, view.wavelength_m, settings.finite_mirrors)
    amplitude = plane_amplitude(view, mesh, feet.range_m()) * (shares * passed[seen])
    fields = EchoFields(amplitude, view.owner[feet.triangle], kinds[seen])
    points, images = curved_paths(feet, view.velocity(feet.triangle, feet.foot), fields, view.wavelength_m)
    counts |= {
        "curved_mirrors": len(feet),
        "curved_mirrors_hidden": len(every) - len(feet),
        "triangles_round_their_focus": focused,
    }
    return points, images, counts
