"""Places under the ground or inside something: a pose with a wrong sign of z sees only the insides of solids."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from datafactory.scenes.scene import Scene
from shared.physics.compiled import compiled


def buried(scene: Scene, places: NDArray[np.float64]) -> NDArray[np.bool_]:
    """[n] whether a place [n, 3] is under the ground or inside a solid, by the nearest faces straight above and below
    it of what does not move: there is one above, and none below; or the one above looks up, and the one below down. The
    latter is asked of each object alone too: the floor of a house is in the ground, or on it, and the ground looks up.

    :param places: in the world [m]
    """
    rising, place = np.unique(places, axis=0, return_inverse=True)
    nearest, towards = np.full((2, len(rising)), np.inf), np.ones((2, len(rising)), dtype=bool)
    within = np.zeros(len(rising), dtype=bool)
    for item in scene.objects:
        if not item.moves:
            corners = item.vertices[item.triangles]
            first = np.searchsorted(rising[:, 0], corners[..., 0].min(axis=1))
            own, looks = np.full_like(nearest, np.inf), np.ones_like(towards)
            _meet_vertically(corners, first, rising, own, looks)
            within |= ~looks.any(axis=0)
            towards = np.where(own < nearest, looks, towards)
            nearest = np.minimum(own, nearest)
    above, below = nearest
    hidden = within | np.isfinite(above) & (np.isinf(below) | ~towards.any(axis=0))
    return hidden[place.reshape(-1)]


@compiled()
def _meet_vertically(corners, first, places, nearest, towards):
    """Lower ``nearest`` [2, n] to the distances [m] of triangles [T, 3, 3] straight above and below places [n, 3].

    :param first: [T] place from which on x is the triangle's; places rise in x
    :param towards: [2, n] whether the nearest face looks at the place
    """
    for t in range(len(corners)):
        a, b, c = corners[t]
        most = max(a[0], b[0], c[0])
        for n in range(first[t], len(places)):
            x, y, z = places[n]
            if x > most:
                break
            # Twice the signed areas, from above, of the triangles that the place makes with two corners.
            of_a = (b[0] - x) * (c[1] - y) - (b[1] - y) * (c[0] - x)
            of_b = (c[0] - x) * (a[1] - y) - (c[1] - y) * (a[0] - x)
            of_c = (a[0] - x) * (b[1] - y) - (a[1] - y) * (b[0] - x)
            area = of_a + of_b + of_c
            if area == 0.0 or min(of_a * area, of_b * area, of_c * area) < 0.0:
                continue
            height = (of_a * a[2] + of_b * b[2] + of_c * c[2]) / area - z
            side = 0 if height > 0.0 else 1
            if abs(height) < nearest[side, n]:
                nearest[side, n], towards[side, n] = abs(height), (area > 0.0) == (side == 1)
