"""Steps of a wave, for hundreds of thousands at a time: onto a plane, off it as from a mirror, through it as a slab."""

from __future__ import annotations

import numpy as np

from shared.physics.compiled import compiled, inlined

ON_ITS_PLANE = 1e-2
"""A point may move by this share of its distance onto its triangle's plane; by more where the plane is seen edge on,
and then the ray caster's own distance is kept.
"""
STEEP = 1e-6
"""Sine of an angle of incidence below which there is no plane of incidence; R_TE = -R_TM and T_TE = T_TM there, and any
will do.
"""


@compiled()
def onto_planes(index, start, direction, distance, triangle, normals, heights):
    """Where n of m rays meet triangles.

    :param index: [n] of the rays that do
    :param start: [m, 3] [m]; :param direction: [m, 3] unit
    :param distance: [m] along the ray as the ray caster has it, to float32 [m]
    :param triangle: [n] that was met
    :param normals: [T, 3] unit, of all triangles; :param heights: [T] of their planes over the origin [m]
    :return: points [n, 3], normals [n, 3] on the side of arrival, cosines [n] of incidence, 0 where the triangle has no
        area, and distances [n]
    """
    count = len(index)
    point, normal, cosine, length = np.empty((count, 3)), np.empty((count, 3)), np.zeros(count), np.empty(count)
    for k in range(count):
        ray, which = index[k], triangle[k]
        slope, height = 0.0, heights[which]
        for i in range(3):
            slope += normals[which, i] * direction[ray, i]
            height -= normals[which, i] * start[ray, i]
        along = distance[ray]
        if slope != 0.0 and abs(height / slope - along) <= ON_ITS_PLANE * along:
            along = height / slope
        side = -1.0 if slope > 0.0 else 1.0
        square = 0.0
        for i in range(3):
            point[k, i] = start[ray, i] + along * direction[ray, i]
            normal[k, i] = side * normals[which, i]
            square += normals[which, i] ** 2
        if square > 0.5:
            cosine[k] = min(max(abs(slope), 1e-9), 1.0)
        length[k] = along
    return point, normal, cosine, length


@compiled()
def reflected_fields(direction, normal, field, te, tm):
    """Directions [n, 3] and fields [n, 3] of waves reflected by planes.

    With n the normal, k and k' the directions before and after, the field across the plane of incidence, along
    s = k x n, is multiplied with R_TE, and that along k x s comes back along k' x s, multiplied with R_TM.

    :param direction: [n, 3] unit; :param normal: [n, 3] unit; :param field: [n, 3] complex, across ``direction``
    :param te, tm: [n] reflection coefficients of the electric field across and in the plane of incidence
    """
    count = len(direction)
    onward, reflected = np.empty((count, 3)), np.empty((count, 3), dtype=np.complex128)
    s, p, q = np.empty(3), np.empty(3), np.empty(3)
    for k in range(count):
        d, n = direction[k], normal[k]
        along = d[0] * n[0] + d[1] * n[1] + d[2] * n[2]
        _across(d, n, s)
        for i in range(3):
            onward[k, i] = d[i] - 2.0 * along * n[i]
        _cross(d, s, p)
        _cross(onward[k], s, q)
        across, within = 0.0j, 0.0j
        for i in range(3):
            across += field[k, i] * s[i]
            within += field[k, i] * p[i]
        across *= te[k]
        within *= tm[k]
        for i in range(3):
            reflected[k, i] = across * s[i] + within * q[i]
    return onward, reflected


@compiled()
def reflectivity(direction, normal, field, te, tm):
    """[n] |R e| / |e| of waves reflected by planes; arguments as in :func:`reflected_fields`."""
    share = np.empty(len(direction))
    s, p = np.empty(3), np.empty(3)
    for k in range(len(direction)):
        _across(direction[k], normal[k], s)
        _cross(s, direction[k], p)
        across, within, square = 0.0j, 0.0j, 0.0
        for i in range(3):
            across += field[k, i] * s[i]
            within += field[k, i] * p[i]
            square += field[k, i].real ** 2 + field[k, i].imag ** 2
        across *= te[k]
        within *= tm[k]
        reflected = across.real**2 + across.imag**2 + within.real**2 + within.imag**2
        share[k] = np.sqrt(reflected / square) if square > 0.0 else 0.0
    return share


@compiled()
def passed_fields(direction, normal, field, te, tm):
    """Fields [n, 3] of waves behind plane slabs, which keep their directions.

    :param direction: [n, 3] unit, in either sense; :param normal: [n, 3] unit; :param field: [n, 3] complex
    :param te, tm: [n] transmission of the electric field across and in the plane of incidence
    """
    passed = np.empty((len(direction), 3), dtype=np.complex128)
    s, p = np.empty(3), np.empty(3)
    for k in range(len(direction)):
        _across(direction[k], normal[k], s)
        _cross(s, direction[k], p)
        across, within = 0.0j, 0.0j
        for i in range(3):
            across += field[k, i] * s[i]
            within += field[k, i] * p[i]
        across *= te[k]
        within *= tm[k]
        for i in range(3):
            passed[k, i] = across * s[i] + within * p[i]
    return passed


@inlined()
def _across(d, n, out):
    """The unit vector d x n across the plane of incidence, of unit vectors."""
    _cross(d, n, out)
    length = np.sqrt(out[0] ** 2 + out[1] ** 2 + out[2] ** 2)
    if length < STEEP:
        axis = np.zeros(3)
        axis[np.argmin(np.abs(d))] = 1.0
        _cross(d, axis, out)
        length = np.sqrt(out[0] ** 2 + out[1] ** 2 + out[2] ** 2)
    for i in range(3):
        out[i] /= length


@inlined()
def _cross(a, b, out):
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]
