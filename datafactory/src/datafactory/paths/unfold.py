"""From the vertices of traced paths to the two delay laws of the PathTable: mirrors replaced by mirror images.

All arrays hold n paths of the same depth; vertices run from the TX to the RX, both at the origin of the radar frame.
A mirror's normal follows from the law of reflection: it bisects the directions to the vertices before and after.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from shared.physics.vectors import Index, Real, lengths


def unit(vector: Real) -> Real:
    """[..., 3] vectors of length 1; a zero vector stays zero."""
    length = lengths(vector)[..., None]
    return vector / np.where(length > 0.0, length, 1.0)


def apart(points: Real, distance: Real | float) -> Index:
    """Indices of points [n, d] that are not within ``distance``, [n] or one for all, of an earlier one."""
    if len(points) < 2:
        return np.arange(len(points))
    radius = np.broadcast_to(distance, len(points))
    pairs = cKDTree(points).query_pairs(float(radius.max()), output_type="ndarray")
    one, other = np.sort(pairs, axis=1).T
    close = np.linalg.norm(points[one] - points[other], axis=1) <= np.maximum(radius[one], radius[other])
    return np.setdiff1d(np.arange(len(points)), other[close])


def with_ends(vertices: Real) -> Real:
    """[n, depth + 2, 3] vertices with the origin before and after."""
    end = np.zeros((len(vertices), 1, 3))
    return np.concatenate([end, vertices, end], axis=1)


def mirror_normals(vertices: Real) -> Real:
    """[n, depth, 3] unit normals that reflect each segment into the next."""
    chain = with_ends(vertices)
    return unit(unit(chain[:, :-2] - vertices) + unit(chain[:, 2:] - vertices))


def segment_lengths(vertices: Real) -> Real:
    """[n, depth + 1] lengths [m] of the segments, TX leg first."""
    return lengths(np.diff(with_ends(vertices), axis=1))


def mirrored_velocity(velocity: Real, normal: Real, mirror_velocity: Real) -> Real:
    """[n, 3] velocity of the image of a point moving with ``velocity`` in a plane mirror that moves itself.

    The image of x in the plane n . (x - o) = 0 is x - 2 n . (x - o) n; its time derivative is below.
    """
    approach = np.einsum("ni,ni->n", normal, velocity - mirror_velocity)
    return velocity - 2.0 * approach[:, None] * normal


def image_seen_from_tx(vertices: Real, velocities: Real, mirrors: Index) -> tuple[Real, Real]:
    """Position [n, 3] and velocity [n, 3] of the scattering vertex behind the first ``mirrors`` [n] reflections.

    :param vertices: [n, depth, 3] [m]; :param velocities: [n, depth, 3] of the objects there [m/s]
    """
    count, depth = vertices.shape[:2]
    rows = np.arange(count)
    reached = np.cumsum(segment_lengths(vertices), axis=1)[rows, mirrors]
    position = unit(vertices[:, 0]) * reached[:, None]
    normals = mirror_normals(vertices)
    velocity = velocities[rows, mirrors].copy()
    for step in range(depth - 1, -1, -1):
        behind = step < mirrors
        velocity[behind] = mirrored_velocity(velocity[behind], normals[behind, step], velocities[behind, step])
    return position, velocity


def tx_image_seen_from_rx(vertices: Real, velocities: Real) -> tuple[Real, Real, Real]:
    """Image of the TX behind all mirrors: position [n, 3], velocity [n, 3], and H [n, 3, 3] of the delay law."""
    count, depth = vertices.shape[:2]
    position = unit(vertices[:, -1]) * segment_lengths(vertices).sum(axis=1)[:, None]
    normals = mirror_normals(vertices)
    velocity = np.zeros((count, 3))
    axes = np.tile(np.eye(3), (count, 1, 1))
    for step in range(depth):
        normal = normals[:, step]
        velocity = mirrored_velocity(velocity, normal, velocities[:, step])
        axes = axes - 2.0 * np.einsum("ni,nj,njk->nik", normal, normal, axes)
    return position, velocity, axes
