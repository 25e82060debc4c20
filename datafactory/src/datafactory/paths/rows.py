"""Rows of the table from the vertices of paths: what their surfaces do to the amplitude, and the delay law of each.

Mirrors are replaced by mirror images. All arrays hold n paths of the same depth; vertices run from the TX to the RX,
both at the origin of the radar frame. A mirror's normal follows from the law of reflection: it bisects the directions
to the vertices before and after.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from datafactory.paths.rays import RayFan
from datafactory.paths.scattering import surface_phase
from datafactory.paths.solver import Bundle
from datafactory.paths.table import DIFFUSE, REFRACTED, SPECULAR, ScatteredPaths, SpecularPaths
from datafactory.paths.view import View
from shared.physics.vectors import Complex, Index, Real, dots, lengths, unit


def _of_surfaces(part: Bundle, view: View) -> Complex:
    """[n] what their surfaces do to the amplitudes: share of a finite mirror, phase of a rough cell."""
    merged, settings = view.merged, view.settings
    mesh = merged.mesh_of_triangle[part.triangles]
    world = part.vertices.reshape(-1, 3) @ view.rotation.T + np.asarray(view.pose.position)
    world = world.reshape(part.vertices.shape)
    unshifted = world - merged.shifts.take(mesh, axis=0) if merged.shifts.any() else world
    at_rest = unshifted
    if merged.turns:
        carried = merged.carried(part.triangles.reshape(-1), world.reshape(-1, 3), mesh.reshape(-1))
        at_rest = unshifted.copy()
        at_rest.reshape(-1, 3)[carried.index] = carried.at_rest
    factor = np.ones(len(part.amplitude), dtype=np.complex128)
    for step in range(part.interactions.shape[1]):
        rough = part.interactions[:, step] == DIFFUSE
        if settings.surface_phase:
            here = np.flatnonzero(rough)
            owner = merged.owner[part.triangles[here, step]]
            phase = surface_phase(at_rest[:, step].take(here, axis=0), owner)
            factor[here] *= np.exp(1j * phase)
        smooth = np.flatnonzero(~rough)
        if settings.finite_mirrors and len(smooth):
            of_smooth = part.interactions.take(smooth, axis=0)
            vertices = part.vertices.take(smooth, axis=0)
            segments = segment_lengths(vertices)
            before = _unfolded_before(segments, of_smooth, step)
            back = part.interactions.shape[1] - 1 - step
            after = _unfolded_before(segments[:, ::-1], of_smooth[:, ::-1], back)
            towards = np.diff(with_ends(vertices)[:, step : step + 2], axis=1)[:, 0]
            factor[smooth] *= view.reflected_share(
                part.triangles[smooth, step], vertices[:, step], towards, before, after
            )
    return factor


def _unfolded_before(segments: Real, interactions: Index, step: int) -> Real:
    """[n] length of the path [m] from the last point where the wave spread, antenna or diffuse bounce, to ``step``."""
    total = segments[:, step].copy()
    unbroken = np.ones(len(total), dtype=bool)
    for earlier in range(step - 1, -1, -1):
        unbroken &= interactions[:, earlier] == SPECULAR
        total += np.where(unbroken, segments[:, earlier], 0.0)
    return total


def _kinds(part: Bundle) -> NDArray[np.uint8]:
    kinds = np.bitwise_or.reduce(part.interactions, axis=1)
    return (kinds | np.where(part.crossings > 0, REFRACTED, 0)).astype(np.uint8)


def _velocities(part: Bundle, view: View) -> Real:
    """[n, depth, 3] of the surfaces at the vertices, relative to the radar [m/s]."""
    return view.velocity(part.triangles.reshape(-1), part.vertices.reshape(-1, 3)).reshape(part.vertices.shape)


def scattered_rows(part: Bundle, view: View, fan: RayFan) -> list[ScatteredPaths]:
    """Paths whose last bounce is diffuse, and the reverses of those that begin with mirrors."""
    count, depth = part.interactions.shape
    if not count:
        return []
    # A name of its own: into a temporary value NumPy multiplies with the factors exchanged, and last bits differ.
    of_surfaces = _of_surfaces(part, view)
    amplitude = part.amplitude * of_surfaces * np.sqrt(fan.solid_angle_ratio(part.vertices[:, 0]))
    velocities, owner, kinds = _velocities(part, view), view.merged.owner[part.triangles[:, -1]], _kinds(part)
    if depth == 1:  # what is below would make the same of them
        return [ScatteredPaths.of_points(part.vertices[:, 0], velocities[:, 0], amplitude, owner, kinds)]
    mirrors = np.argmax(part.interactions == DIFFUSE, axis=1)
    tx_point, tx_velocity = image_seen_from_tx(part.vertices, velocities, mirrors)
    # Between the first diffuse bounce and the last there may be others, or mirrors: their lengths are one number. Along
    # a mirror the point of reflection does not change it (Fermat), so that its surface's velocity there serves.
    apart, faster = np.diff(part.vertices, axis=1), np.diff(velocities, axis=1)
    inner = np.arange(depth - 1) >= mirrors[:, None]
    between = np.where(inner, lengths(apart), 0.0).sum(axis=1)
    rates = dots(unit(apart).reshape(-1, 3), faster.reshape(-1, 3)).reshape(count, depth - 1)
    rate = np.where(inner, rates, 0.0).sum(axis=1)
    paths = ScatteredPaths(
        tx_point=tx_point,
        rx_point=part.vertices[:, -1],
        tx_velocity=tx_velocity,
        rx_velocity=velocities[:, -1],
        between_m=between,
        between_rate_mps=rate,
        amplitude=amplitude,
        depth=np.full(count, depth, dtype=np.int8),
        object_index=owner,
        kinds=kinds,
    )
    return [paths, paths.take(mirrors > 0).reversed()]


def specular_rows(part: Bundle, view: View) -> SpecularPaths:
    """Paths of mirrors alone."""
    image, velocity, axes = tx_image_seen_from_rx(part.vertices, _velocities(part, view))
    of_surfaces, owner = _of_surfaces(part, view), view.merged.owner[part.triangles[:, -1]]
    return SpecularPaths.of(
        image, velocity, axes, part.amplitude * of_surfaces, owner, _kinds(part), part.interactions.shape[1]
    )


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
    approach = dots(normal, velocity - mirror_velocity)
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
