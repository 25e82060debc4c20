"""One trace a frame: from a merged scene and a pose to a PathTable.

What rough surfaces scatter is found by the frame's own rays (:mod:`datafactory.paths.scattered_once` and
:mod:`datafactory.paths.scattered_twice`). The solver (:mod:`datafactory.paths.solver`) finds chains of mirrors, and
where panes let waves through, those beyond them. All paths are brought into the table's two delay laws, and into the
physics that the solver leaves out:

* single mirrors are found without rays (:mod:`datafactory.paths.mirror_feet`), those of the solver are left out;
* facets that sample a curved surface reflect as the surface does (:mod:`datafactory.paths.curved_mirrors`);
* a mirror reflects with the share of its facet's size (:mod:`datafactory.paths.facets`);
* a diffuse bounce takes on the phase of its surface cell (:mod:`datafactory.paths.roughness`);
* no ray ends with a mirror after a diffuse bounce. The reverses of such paths, mirror first, are found, and by
  reciprocity each of them stands for both: it enters the table twice, with the TX's and the RX's side exchanged;
* targets given by a radar cross section are added, directly and over mirrors (:mod:`datafactory.paths.targets`), and
  what edges send back (:mod:`datafactory.paths.diffraction`);
* right-angled corners send back what runs into their edges (:mod:`datafactory.paths.corners`).
"""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
from numpy.typing import NDArray

from datafactory.paths.aim import aimed
from datafactory.paths.arrivals import Arrivals
from datafactory.paths.corners import echoes_of_corners, without_corners
from datafactory.paths.curved_mirrors import curved_mirrors
from datafactory.paths.diffraction import edge_echoes
from datafactory.paths.edges import edges_of
from datafactory.paths.facets import mirrors_of, reflected_share
from datafactory.paths.geometry import placed
from datafactory.paths.merged_scene import MergedScene, slabs_of
from datafactory.paths.mirror_feet import single_mirrors
from datafactory.paths.ray_hits import clear_between
from datafactory.paths.rays import RayFan
from datafactory.paths.roughness import surface_phase
from datafactory.paths.scattered_once import behind_panes, over_mirrors
from datafactory.paths.scattered_twice import scattered_twice
from datafactory.paths.solver import Bundle, Solved, TraceSettings, radio_scene, solve
from datafactory.paths.surfaces import Surfaces
from datafactory.paths.table import DIFFUSE, REFRACTED, SPECULAR, PathTable, ScatteredPaths, SpecularPaths
from datafactory.paths.targets import EDGES_WITHIN_M, target_echoes
from datafactory.paths.unfold import image_seen_from_tx, segment_lengths, tx_image_seen_from_rx, unit, with_ends
from datafactory.scenes.materials.table import MaterialMapping
from datafactory.scenes.poses import Pose
from shared.physics.units import SPEED_OF_LIGHT


def trace(
    merged: MergedScene,
    materials: MaterialMapping,
    pose: Pose,
    frequency_hz: float,
    settings: TraceSettings,
    fan: RayFan,
    seed: int,
    target_seed: int = 0,
) -> PathTable:
    """All multipath of one frame, the point targets' echoes among it.

    :param merged: at any time; the frame is traced at the pose's
    :param frequency_hz: mid-sweep; materials take their values at 77 GHz whatever it is
    :param seed: of the solver's choices between kinds of bounce; 0 to 2**32 - 1
    :param target_seed: of where in their cycle the moving parts of targets are at time 0
    """
    merged = merged.at(pose.time_s)
    kept = placed(merged, materials, pose)
    geometry = kept.mi_scene
    by_rays = list[Bundle]()
    if settings.diffuse and merged.meshes:
        surfaces = Surfaces(geometry, merged, materials, pose, frequency_hz)
        fan = aimed(fan, surfaces)
        first = Arrivals.first(surfaces, settings, fan)
        groups = [first.echoes(), *over_mirrors(first), *scattered_twice(first, seed)]
        if settings.refraction:
            groups.append(behind_panes(first))
        by_rays = [group.thinned(seed) for group in groups]
    smooth = beyond = Solved.nothing()
    if settings.depth > 1 and settings.specular and merged.meshes:
        scene = radio_scene(kept, slabs_of(merged, materials), frequency_hz, settings)
        smooth = solve(scene, merged, pose, settings.of_mirrors, fan, seed)
        if settings.refraction:
            beyond = solve(scene, merged, pose, settings.beyond_panes, fan, seed).beyond_panes()
    chains = smooth.bundle
    scattered: list[ScatteredPaths] = []
    specular: list[SpecularPaths] = []
    more = dict[str, int]()
    if settings.point_targets:
        echoes, counts = target_echoes(geometry, merged, materials, pose, frequency_hz, settings, target_seed)
        scattered.append(echoes)
        more |= counts
    if settings.diffraction:
        across, along, counts = edge_echoes(
            edges_of(merged).seen_from(pose).within(EDGES_WITHIN_M), slabs_of(merged, materials), frequency_hz,
            lambda start, end: clear_between(geometry, start, end),
            settings.polarization, settings.finite_mirrors and settings.specular,
        )  # fmt: skip
        scattered.append(across)
        specular.append(along)
        more |= counts
    if settings.corners:
        chains, by_the_solver = without_corners(chains, merged)
        small, wide, counts = echoes_of_corners(geometry, merged, materials, pose, frequency_hz, settings)
        scattered += small
        specular += wide
        more |= counts | {"corners_by_the_solver": by_the_solver}
    if settings.specular:
        singles, counts = single_mirrors(geometry, merged, materials, pose, frequency_hz, settings)
        specular.append(singles)
        points, images, round_ones = curved_mirrors(geometry, merged, materials, pose, frequency_hz, settings)
        scattered.append(points)
        specular.append(images)
        counts |= round_ones
        more |= counts
    for part in by_rays:
        scattered += _scattered(_with_surfaces(part, merged, pose, SPEED_OF_LIGHT / frequency_hz, settings), fan)
    for bundle in (chains, beyond.bundle):
        for depth in range(2, bundle.interactions.shape[1] + 1):
            part = bundle.of_bounces(depth).in_fixed_order()
            specular.append(_specular(_with_surfaces(part, merged, pose, SPEED_OF_LIGHT / frequency_hz, settings)))
    return PathTable(
        scattered=_joined_scattered(scattered),
        specular=_joined(specular),
        objects=merged.objects,
        counts={
            "rays": settings.rays,
            "traced": len(chains.amplitude) + len(beyond.bundle.amplitude),
            "scattered_once": sum(len(part.amplitude) for part in by_rays if part.scatterings == 1),
            "scattered_twice": sum(len(part.amplitude) for part in by_rays if part.scatterings > 1),
            "truncated": max(smooth.truncated, beyond.truncated),
            "invalid": smooth.invalid + beyond.invalid,
            **more,
        },
    )


def _with_surfaces(
    part: Bundle, merged: MergedScene, pose: Pose, wavelength_m: float, settings: TraceSettings
) -> Bundle:
    """The paths with what their surfaces do to the amplitude: share of a finite mirror, phase of a rough cell."""
    rotation = pose.rotation()
    triangle = np.maximum(part.triangles, 0)  # -1 stands beyond a path's end, where nothing is looked at
    mesh = merged.mesh_of_triangle[triangle] if len(merged.mesh_of_triangle) else triangle
    shift = np.array([item.shift for item in merged.meshes]).reshape(-1, 3)
    world = (part.vertices.reshape(-1, 3) @ rotation.T + np.asarray(pose.position)).reshape(part.vertices.shape)
    unshifted = world - shift.take(mesh, axis=0) if shift.any() else world
    at_rest = unshifted
    if merged.turns:
        carried = merged.carried(triangle.reshape(-1), world.reshape(-1, 3), mesh.reshape(-1))
        at_rest = unshifted.copy()
        at_rest.reshape(-1, 3)[carried.index] = carried.at_rest
    factor = np.ones(len(part.amplitude), dtype=np.complex128)
    for step in range(part.interactions.shape[1]):
        rough = part.interactions[:, step] == DIFFUSE
        if settings.surface_phase:
            here = np.flatnonzero(rough)
            phase = surface_phase(at_rest[:, step].take(here, axis=0), part.objects[here, step])
            factor[here] *= np.exp(1j * phase)
        smooth = np.flatnonzero(~rough)
        if settings.finite_mirrors and len(smooth):
            of_smooth = part.interactions.take(smooth, axis=0)
            vertices = part.vertices.take(smooth, axis=0)
            lengths = segment_lengths(vertices)
            before = _unfolded_before(lengths, of_smooth, step)
            back = part.interactions.shape[1] - 1 - step
            after = _unfolded_before(lengths[:, ::-1], of_smooth[:, ::-1], back)
            towards = np.diff(with_ends(vertices)[:, step : step + 2], axis=1)[:, 0] @ rotation.T
            factor[smooth] *= reflected_share(
                mirrors_of(merged), part.triangles[smooth, step], unshifted[smooth, step], towards, before, after,
                wavelength_m,
            )  # fmt: skip
    return Bundle(**{**vars(part), "amplitude": part.amplitude * factor})


def _unfolded_before(lengths: NDArray[np.float64], interactions: NDArray[np.int64], step: int) -> NDArray[np.float64]:
    """[n] length of the path [m] from the last point where the wave spread, antenna or diffuse bounce, to ``step``."""
    total = lengths[:, step].copy()
    unbroken = np.ones(len(total), dtype=bool)
    for earlier in range(step - 1, -1, -1):
        unbroken &= interactions[:, earlier] == SPECULAR
        total += np.where(unbroken, lengths[:, earlier], 0.0)
    return total


def _kinds(part: Bundle) -> NDArray[np.uint8]:
    kinds = np.bitwise_or.reduce(part.interactions, axis=1)
    return (kinds | np.where(part.crossings > 0, REFRACTED, 0)).astype(np.uint8)


def _scattered(part: Bundle, fan: RayFan) -> list[ScatteredPaths]:
    """Paths whose last bounce is diffuse, and the reverses of those that begin with mirrors."""
    if not len(part.amplitude):
        return []
    count, depth = part.interactions.shape
    if depth == 1:
        return [_scattered_at_first(part, fan)]
    rows = np.arange(count)
    mirrors = np.argmax(part.interactions == DIFFUSE, axis=1)
    tx_point, tx_velocity = image_seen_from_tx(part.vertices, part.velocities, mirrors)
    first = part.vertices[rows, mirrors]
    # Between the first diffuse bounce and the last there may be others, or mirrors: their length is one number.
    lengths = segment_lengths(part.vertices)
    inner = np.arange(depth + 1)[None, :]
    between = np.where((inner > mirrors[:, None]) & (inner < depth), lengths, 0.0).sum(axis=1)
    direction = unit(part.vertices[:, -1] - first)
    rate = np.einsum("ni,ni->n", direction, part.velocities[:, -1] - part.velocities[rows, mirrors])
    paths = ScatteredPaths(
        tx_point=tx_point,
        rx_point=part.vertices[:, -1],
        tx_velocity=tx_velocity,
        rx_velocity=part.velocities[:, -1],
        between_m=between,
        between_rate_mps=rate,
        amplitude=part.amplitude * np.sqrt(fan.solid_angle_ratio(part.vertices[:, 0])),
        depth=np.full(count, depth, dtype=np.int8),
        object_index=part.objects[:, -1].astype(np.int32),
        kinds=_kinds(part),
    )
    return [paths, paths.take(mirrors > 0).reversed()]


def _scattered_at_first(part: Bundle, fan: RayFan) -> ScatteredPaths:
    """Paths of one bounce, which is diffuse: what :func:`_scattered` would make of them too."""
    amplitude = part.amplitude * np.sqrt(fan.solid_angle_ratio(part.vertices[:, 0]))
    points = ScatteredPaths.of_points(
        part.vertices[:, 0], part.velocities[:, 0], amplitude, part.objects[:, 0].astype(np.int32)
    )
    return replace(points, kinds=_kinds(part))


def _specular(part: Bundle) -> SpecularPaths:
    count, depth = part.interactions.shape
    image, velocity, axes = tx_image_seen_from_rx(part.vertices, part.velocities)
    return SpecularPaths(
        image=image,
        image_velocity=velocity,
        axes=axes,
        reference=np.zeros(3),
        amplitude=part.amplitude,
        depth=np.full(count, depth, dtype=np.int8),
        object_index=part.objects[:, -1].astype(np.int32),
        kinds=_kinds(part),
    )


def _joined_scattered(parts: list[ScatteredPaths]) -> ScatteredPaths:
    none = ScatteredPaths.none()
    return ScatteredPaths.concatenate([none, *parts])


def _joined(parts: list[SpecularPaths]) -> SpecularPaths:
    parts = [SpecularPaths.none(), *parts]
    names = [item.name for item in fields(SpecularPaths) if item.name != "reference"]
    return SpecularPaths(
        reference=np.zeros(3), **{name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
    )
