"""The finite size of mirrors: what a facet reflects, relative to an infinite plane.

Geometric optics gives a specular path the amplitude of an infinite plane, whatever the facet's size. Physical optics in
the Fresnel approximation (Goodman, Introduction to Fourier Optics, section 4.2) integrates the field over the mirror's
plane,

    F = -j int exp(j pi rho^2) d(xi) d(eta),   (xi, eta) = sqrt((1/d1 + 1/d2) / lambda) (x cos(theta), y),

with (x, y) in the plane from the specular point, x in the plane of incidence, d1 and d2 the unfolded distances to the
source and to the next point from which the wave spreads. In polar coordinates the radial integral is elementary:

    F = (1 / 2 pi) contour-integral (1 - exp(j pi rho(phi)^2)) d(phi).

The infinite plane has F = 1, at an edge F = 1/2, at a right-angled corner 1/4; a plate far smaller than the zone gives
its cross section 4 pi A^2 / lambda^2. Edges beyond ``TAPER`` Fresnel zones are faded out, exp(-rho^2 / TAPER): their
wave reaches the radar from another point, and is diffraction. The phase grows with the length, as in the PathTable.

Limits: the facet is plane and lit as a whole; successive mirrors are treated one by one; coplanar pieces count as one
mirror of one material (where they overlap, as their mean). Pieces of a curved surface are no mirrors of their own:
:mod:`datafactory.paths.curved_echoes`.
"""

from __future__ import annotations

import numpy as np
from scipy.special import wofz

from datafactory.paths.bodies import bodies_of
from datafactory.paths.merged_scene import MergedScene
from datafactory.paths.planes import COPLANAR_M, Rim, planes_of
from shared.physics.compiled import compiled
from shared.physics.vectors import Complex, Index, Real, dots

TAPER = 16.0
"""Fresnel zones (rho^2) after which an edge's ripple has fallen to 1/e: there it is 4 % of the reflection."""
CUT = 6.0 * TAPER
"""rho^2 beyond which an edge is left out: its ripple is below 1e-4."""
CLOSEST = 1e-9
"""Fresnel radii: an edge nearer to the specular point passes through it, and its angle around the point is 0."""
RATE = complex(1.0 / TAPER, -np.pi)
"""a of the taper and phase exp(-a rho^2)."""
NEAR = 1.5
"""Fresnel radii along an edge from its foot: nearer ends are integrated numerically, farther ones by the half line's
closed form less the tail's asymptotic series, whose error is below 1e-3 there.
"""
NODES, WEIGHTS = np.polynomial.legendre.leggauss(6)
PANELS = np.array([0.0, 0.1, 0.5, 1.0, NEAR])
TABLE_STEP = 0.01
TABLE = wofz(1j * np.sqrt(RATE) * TABLE_STEP * np.arange(int(np.sqrt(CUT) / TABLE_STEP) + 3))
"""erfc(z) exp(z^2) at z = sqrt(a) height: smooth, so that linear interpolation keeps 1e-4."""


def reflected_share(
    merged_scene: MergedScene,
    triangle: Index,
    point: Real,
    arrival: Real,
    before_m: Real,
    after_m: Real,
    wavelength_m: float,
) -> Complex:
    """[n] factor F on the amplitude of a reflection at a specular point.

    :param triangle: [n] that was hit, all meshes' triangles one after another
    :param point: [n, 3] specular points, world [m], without their meshes' shifts
    :param arrival: [n, 3] direction in which the wave arrives (any length)
    :param before_m, after_m: [n] d1 and d2, unfolded distances to source and next spreading point [m]
    """
    if not len(triangle):
        return np.ones(0, dtype=np.complex128)
    scale = np.sqrt((1.0 / before_m + 1.0 / after_m) / wavelength_m)
    rims, ends, normals, place = _rims_of_each(merged_scene, triangle)
    return _mirror_shares(rims, ends, point, arrival, normals, place[triangle], scale)


def _rims_of_each(merged_scene: MergedScene, triangle: Index) -> tuple[Rim, Index, Real, Index]:
    """Rims of the planes of M triangles that are met as one, which of its stretches are each triangle's, from [M, 0] to
    before [M, 1], the normals [M, 3] on the side from which the rims are seen, and which of the M a triangle [T] is."""
    place = np.zeros(len(merged_scene.normals), dtype=np.int64)
    met = np.flatnonzero(np.bincount(triangle, minlength=len(place)))
    place[met] = np.arange(len(met))
    normals, origin, mesh = merged_scene.normals[met], merged_scene.corners[met, 0], merged_scene.mesh_of_triangle[met]
    planes = {index: planes_of(body) for body in bodies_of(merged_scene) for index in body.meshes}
    own = [planes[mesh[m]].rim(which, origin[m], normals[m]) for m, which in enumerate(met.tolist())]
    rims = list({id(rim): rim for rim, _ in own}.values())  # triangles of one plane share its rim
    last = dict(zip(map(id, rims), np.cumsum([len(rim.radius) for rim in rims]).tolist(), strict=True))
    ends = [(last[id(rim)] - len(rim.radius), last[id(rim)]) for rim, _ in own]
    turned = dots(normals, np.array([side for _, side in own])) < 0.0
    return Rim.joined(rims), np.array(ends), np.where(turned[:, None], -normals, normals), place


@compiled()
def _mirror_shares(rims, ends, point, arrival, normals, mirror, scale):
    """[n] F of specular points [n, 3] on mirrors, each with some of the stretches of ``rims``.

    :param ends: [M, 2] of each mirror the first of its stretches, and the one after the last
    :param normals: [M, 3] unit, on the side from which the stretches are seen
    :param mirror: [n] of the M; :param scale: [n] of xi and eta to lengths across the wave
    """
    share = np.ones(len(point), dtype=np.complex128)
    along, across, seen = np.empty(3), np.empty(3), np.empty_like(rims.edges)
    for k in range(len(point)):
        a, n = arrival[k], normals[mirror[k]]
        length = np.sqrt(a[0] ** 2 + a[1] ** 2 + a[2] ** 2)
        slope = a[0] * n[0] + a[1] * n[1] + a[2] * n[2]
        for i in range(3):
            along[i] = a[i] - slope * n[i]
        size = np.sqrt(along[0] ** 2 + along[1] ** 2 + along[2] ** 2)
        if size < 1e-9 * length:  # any direction in the plane will do
            least = np.argmin(np.abs(n))
            for i in range(3):
                along[i] = (1.0 if i == least else 0.0) - n[least] * n[i]
            size = np.sqrt(along[0] ** 2 + along[1] ** 2 + along[2] ** 2)
        for i in range(3):
            along[i] /= size
        for i in range(3):
            across[i] = (n[i - 2] * along[i - 1] - n[i - 1] * along[i - 2]) * scale[k]
        for i in range(3):
            along[i] *= abs(slope) / length * scale[k]
        # In (xi, eta) a length shrinks by the slope at most; points and edges lie off the plane by COPLANAR_M at most.
        reach = np.sqrt(CUT) / max(abs(slope) / length * scale[k], CLOSEST) + 2.0 * COPLANAR_M
        count = _as_seen(rims, ends[mirror[k]], point[k], reach, seen)
        total, turned, _ = _along_edges(seen[:count], point[k], along, across)
        share[k] = total / max(turned, 2.0 * np.pi)
    return share


@compiled(cache=False)
def _as_seen(rims, ends, point, reach, seen):
    """Fill ``seen`` [E, 2, 3] with the edges of stretches of which a part may lie within ``reach`` of a point [3], and
    with the chords of the others; how many."""
    count = 0
    for stretch in range(ends[0], ends[1]):
        first, last = rims.begins[stretch], rims.begins[stretch + 1]
        square = 0.0
        for i in range(3):
            square += (rims.centre[stretch, i] - point[i]) ** 2
        if square > (reach + rims.radius[stretch]) ** 2:
            for i in range(3):
                seen[count, 0, i], seen[count, 1, i] = rims.edges[first, 0, i], rims.edges[last - 1, 1, i]
            count += 1
            continue
        for edge in range(first, last):
            for end in range(2):
                for i in range(3):
                    seen[count, end, i] = rims.edges[edge, end, i]
            count += 1
    return count


@compiled()
def share_within_rims(rims, point, along, across):
    """F of a specular point [3] inside an area of which only a part of the boundary is given, the rest being far away.

    The integral of exp(-a rho^2) d(phi) along the ``rims`` [E, 2, 3] is what the plane beyond them is missed by.
    """
    total, turned, through = _along_edges(rims, point, along, across)
    return 1.0 + (total - turned) / (2.0 * np.pi) - (0.5 if through else 0.0)


@compiled(cache=False)
def _along_edges(edges, point, along, across):
    """Integrals of 1 - exp(-a rho^2) d(phi), and of d(phi), along edges [E, 2, 3] around a point [3].

    Last, whether an edge passes through the point: it adds to neither. The ends a and b of a far edge, as complex
    numbers, give conj(a) b, whose argument is the angle that the edge fills. The product of all of these has the sum of
    the angles, but for the turns that are counted beside it.
    """
    total, turned, through = 0.0j, 0.0, False
    real, imaginary, turns = 1.0, 0.0, 0
    for e in range(len(edges)):
        ax = ay = bx = by = 0.0
        for i in range(3):
            from_point, to_point = edges[e, 0, i] - point[i], edges[e, 1, i] - point[i]
            ax += from_point * along[i]
            ay += from_point * across[i]
            bx += to_point * along[i]
            by += to_point * across[i]
        dx, dy, cross = bx - ax, by - ay, ax * by - ay * bx
        if (ax * dx + ay * dy) * (bx * dx + by * dy) < 0.0:
            far = cross * cross > CUT * (dx * dx + dy * dy)
        else:
            far = min(ax * ax + ay * ay, bx * bx + by * by) > CUT
        length = 0.0 if far else max(np.hypot(dx, dy), CLOSEST)
        size = CUT if far else abs(cross) / length
        if size < CLOSEST:
            tx, ty = dx / length, dy / length
            through = through or (ax * tx + ay * ty) * (bx * tx + by * ty) < 0.0
        elif far:  # exp(-a rho^2) is 0 all along it, and the integral is the angle that the edge fills
            dot = ax * bx + ay * by
            before = imaginary
            real, imaginary = real * dot - imaginary * cross, real * cross + imaginary * dot + 0.0
            if cross >= 0.0 and before >= 0.0 and imaginary < 0.0:
                turns += 1
            elif cross < 0.0 and before < 0.0 and imaginary >= 0.0:
                turns -= 1
            largest = max(abs(real), abs(imaginary))
            if largest > 1e100:
                real, imaginary = real / largest, imaginary / largest
        else:
            tx, ty = dx / length, dy / length
            start, stop = ax * tx + ay * ty, bx * tx + by * ty
            side = 1.0 if cross >= 0.0 else -1.0
            total += side * (_integral_from_foot(size, stop) - _integral_from_foot(size, start))
            turned += side * (np.arctan2(stop, size) - np.arctan2(start, size))
    angle = np.arctan2(imaginary, real) + 2.0 * np.pi * turns
    return total + angle, turned + angle, through


@compiled(cache=False)
def _integral_from_foot(height, end):
    """Integral of 1 - exp(-a rho^2) d(phi) along a line at ``height`` from its foot to ``end``; odd in ``end``.

    With u along the line, d(phi) = height du / (height^2 + u^2), and for the half line (Gradshteyn and Ryzhik, 3.466)

        int_0^inf exp(-a (height^2 + u^2)) d(phi) = pi / 2 erfc(sqrt(a) height).
    """
    far = abs(end)
    if far > NEAR:
        total = complex(np.arctan2(far, height))
        square = height * height
        if square < CUT:
            place = height / TABLE_STEP
            index = int(place)
            scaled = TABLE[index] + (place - index) * (TABLE[index + 1] - TABLE[index])
            total -= 0.5 * np.pi * scaled * np.exp(-RATE * square)
        if square + far * far < CUT:
            density = height / (square + far * far)
            slope = -2.0 * far * density / (square + far * far)
            first = density / (2.0 * RATE * far)
            second = (slope * far - density) / (2.0 * RATE * far * far) / (2.0 * RATE * far)
            total += np.exp(-RATE * (square + far * far)) * (first + second)
    else:
        total = 0.0j
        for panel in range(len(PANELS) - 1):
            low, high = PANELS[panel], min(PANELS[panel + 1], far)
            if low >= far:
                break
            for q in range(len(NODES)):
                u = 0.5 * (high + low) + 0.5 * (high - low) * NODES[q]
                rho2 = height * height + u * u
                total += 0.5 * (high - low) * WEIGHTS[q] * height / rho2 * (1.0 - np.exp(-RATE * rho2))
    return total if end >= 0.0 else -total
