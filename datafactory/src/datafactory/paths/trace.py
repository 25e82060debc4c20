"""The only module that calls Sionna's solvers: one trace a frame, from a stage and a pose to a PathTable.

The trace is monostatic, isotropic and vertically polarised, at mid-sweep, in the radar's own frame. Patterns, powers,
array and waveform come later. What is done about Sionna RT 2.2's traits, each with a test in
``tests/datafactory/test_trace.py``:

* First-hit directions are replaced by :class:`datafactory.paths.rays.RayFan` (the solver's lattice covers the sphere).
* A path that ends with a mirror after a diffuse bounce is found once per sequence of planes, whatever the number of
  rays, so that its power is wrong; such paths are dropped. Their reverses, mirror first, are right, and by reciprocity
  each of them stands for both: it enters the table twice, with the TX's and the RX's side exchanged.
* Amplitudes are conjugated: ``Paths.a`` belongs to exp(-j 2 pi f tau), the IF signal to exp(+j 2 pi f tau).
* Line of sight from TX to RX is left out, and the solver runs in its deterministic mode. That fixes which paths are
  found, not their order, which depends on the threads' timing (seen on a busy machine); they are
  sorted here, because sums in float32 depend on it.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datafactory.paths.backend import select_variant
from datafactory.paths.rays import RayFan
from datafactory.paths.stage import Stage
from datafactory.paths.table import PathTable, ScatteredPaths, SpecularPaths
from datafactory.paths.unfold import image_seen_from_tx, segment_lengths, tx_image_seen_from_rx, unit
from datafactory.scenes.materials import MaterialMapping
from datafactory.scenes.poses import Pose
from shared.units import SPEED_OF_LIGHT, db_to_power

SPECULAR, DIFFUSE = 1, 2
"""Sionna's codes of the bounces followed here."""

PATTERNS: dict[str, dict[str, Any]] = {
    "lambertian": {"scattering_pattern": "lambertian"},
    "backscattering": {"scattering_pattern": "backscattering", "alpha_r": 4, "alpha_i": 4, "lambda_": 0.5},
}
"""Diffuse patterns of the material table. With lambda = 1 (or the directive pattern) hardly anything comes back off
normal.
"""


@dataclass(frozen=True)
class TraceSettings:
    """How a frame is traced.

    :param rays: directions sent from the TX
    :param depth: largest number of bounces, 1 to 3
    :param specular, diffuse: kinds of bounce to follow
    """

    rays: int = 200_000
    depth: int = 2
    specular: bool = True
    diffuse: bool = True


@dataclass(frozen=True)
class _Bundle:
    """What the solver returned, on the host: n paths, vertices from TX to RX."""

    vertices: NDArray[np.float64]  # [n, depth, 3]
    interactions: NDArray[np.int64]  # [n, depth], 0 beyond the path's end
    objects: NDArray[np.int64]  # [n, depth] index into the stage's objects, -1 beyond the end
    velocities: NDArray[np.float64]  # [n, depth, 3] relative to the radar
    amplitude: NDArray[np.complex128]  # [n]

    def take(self, index: NDArray) -> _Bundle:
        return _Bundle(**{item.name: getattr(self, item.name)[index] for item in fields(self)})

    def cut(self, depth: int) -> _Bundle:
        """The same paths without the columns beyond ``depth``."""
        columns = {item.name: getattr(self, item.name)[:, :depth] for item in fields(self) if item.name != "amplitude"}
        return _Bundle(amplitude=self.amplitude, **columns)

    def in_fixed_order(self) -> _Bundle:
        """The same paths, sorted by their vertices: the solver's threads hand them over as they happen to finish."""
        count, depth = self.interactions.shape
        return self.take(np.lexsort(self.vertices.reshape(count, 3 * depth).T[::-1]))


def trace(
    stage: Stage,
    materials: MaterialMapping,
    pose: Pose,
    frequency_hz: float,
    settings: TraceSettings,
    fan: RayFan,
    seed: int,
) -> PathTable:
    """All multipath of one frame, the point targets' single bounces among it.

    :param frequency_hz: mid-sweep; materials take their values at 77 GHz whatever it is
    :param seed: of the solver's choices between kinds of bounce; 0 to 2**32 - 1
    """
    paths = _solve(stage, materials, pose, frequency_hz, settings, fan, seed)
    bundle = _on_host(paths, stage, pose)
    targets, hidden = _point_targets(paths.scene, stage, pose, frequency_hz)
    scattered, specular, dropped = [targets], [], 0
    lengths = (bundle.interactions > 0).sum(axis=1)
    for depth in range(1, settings.depth + 1):
        part = bundle.take(lengths == depth).cut(depth).in_fixed_order()
        mirrors = (part.interactions == SPECULAR).all(axis=1)
        ends_diffuse = part.interactions[:, -1] == DIFFUSE
        dropped += int((~mirrors & ~ends_diffuse).sum())
        scattered += _scattered(part.take(ends_diffuse), fan)
        specular.append(_specular(part.take(mirrors)))
    return PathTable(
        scattered=ScatteredPaths.concatenate(scattered),
        specular=_joined(specular),
        objects=stage.objects,
        counts={
            "rays": settings.rays,
            "traced": len(bundle.amplitude),
            "diffuse_then_specular_dropped": dropped,
            "truncated": int(len(bundle.amplitude) >= _capacity(settings)),
            "invalid": paths.invalid,
            "point_targets_hidden": hidden,
        },
    )


def _capacity(settings: TraceSettings) -> int:
    """Paths the solver may keep: every ray can leave a path at every bounce, so that nothing is ever truncated."""
    return settings.rays * settings.depth + 1_000_000


@dataclass(frozen=True)
class _Solved:
    scene: Any  # sionna.rt.Scene
    paths: Any  # sionna.rt.Paths
    invalid: int
    shapes: dict[int, int]  # object id of Sionna -> index of the stage's mesh


def _solve(stage, materials, pose, frequency_hz, settings, fan, seed) -> _Solved:
    select_variant()
    from sionna import rt

    scene = rt.load_scene()
    by_name = {material.name: material for material, _ in materials.entries.values()}
    radio = {
        name: rt.RadioMaterial(
            name=f"m-{name}",
            relative_permittivity=material.relative_permittivity,
            conductivity=material.conductivity_s_per_m,
            thickness=material.thickness_m,
            scattering_coefficient=material.scattering_coefficient,
            **PATTERNS[material.pattern],
        )
        for name, material in by_name.items()
    }
    objects = [
        rt.SceneObject(
            mi_mesh=_mitsuba_mesh(f"part-{index}", mesh.seen_from(pose), mesh.triangles),
            name=f"part-{index}",
            radio_material=radio[mesh.material],
        )
        for index, mesh in enumerate(stage.meshes)
    ]
    scene.edit(add=objects)
    scene.frequency = frequency_hz
    antenna = rt.PlanarArray(
        num_rows=1, num_cols=1, vertical_spacing=0.5, horizontal_spacing=0.5, pattern="iso", polarization="V"
    )
    scene.tx_array = scene.rx_array = antenna
    scene.add(rt.Transmitter("radar-tx", position=[0.0, 0.0, 0.0]))
    scene.add(rt.Receiver("radar-rx", position=[0.0, 0.0, 0.0]))
    with _directions(fan):
        paths = rt.PathSolver(deterministic=True)(
            scene,
            max_depth=settings.depth,
            samples_per_src=settings.rays,
            max_num_paths_per_src=_capacity(settings),
            synthetic_array=True,
            los=False,
            specular_reflection=settings.specular,
            diffuse_reflection=settings.diffuse,
            refraction=False,
            seed=seed,
        )
    valid = paths.valid.numpy()
    shapes = {scene.objects[f"part-{index}"].object_id: index for index in range(len(stage.meshes))}
    return _Solved(scene=scene, paths=paths, invalid=int((~valid).sum()), shapes=shapes)


def _point_targets(scene: Any, stage: Stage, pose: Pose, frequency_hz: float) -> tuple[ScatteredPaths, int]:
    """Echoes of the point targets that the radar can see, and the number of those that it cannot.

    Radar equation for isotropic antennas of unit power: lambda sqrt(sigma) / ((4 pi)^(3/2) R^2).
    """
    import mitsuba as mi

    first = len(stage.objects) - len(stage.targets)
    position = np.array([target.position for target in stage.targets]).reshape(-1, 3)
    velocity = np.array([target.velocity for target in stage.targets]).reshape(-1, 3)
    rotation = pose.rotation()
    position = (position + velocity * pose.time_s - np.asarray(pose.position)) @ rotation
    velocity = (velocity - np.asarray(pose.velocity)) @ rotation
    range_m = np.linalg.norm(position, axis=1)
    visible = range_m > 0.0
    if len(position):
        direction = position / np.where(visible, range_m, 1.0)[:, None]
        ray = mi.Ray3f(mi.Point3f(0.0), mi.Vector3f(*direction.T.astype(np.float32)))
        ray.maxt = range_m.astype(np.float32)
        visible &= ~scene.mi_scene.ray_test(ray).numpy()
    cross_section = db_to_power([target.rcs_dbsm for target in stage.targets])
    amplitude = SPEED_OF_LIGHT / frequency_hz * np.sqrt(cross_section) / (4.0 * np.pi) ** 1.5
    amplitude = amplitude / np.where(visible, range_m, 1.0) ** 2
    index = np.arange(first, len(stage.objects), dtype=np.int32)
    echoes = ScatteredPaths.of_points(position, velocity, amplitude, index)
    return echoes.take(visible), int((~visible).sum())


def _mitsuba_mesh(name: str, vertices: NDArray[np.float32], triangles: NDArray[np.int32]):
    import mitsuba as mi

    mesh = mi.Mesh(name, vertex_count=len(vertices), face_count=len(triangles))
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = vertices.ravel()
    parameters["faces"] = triangles.astype(np.uint32).ravel()
    parameters.update()
    return mesh


@contextmanager
def _directions(fan: RayFan) -> Iterator[None]:
    """Let the solver's candidate generator send its rays into the fan instead of its full-sphere lattice."""
    import mitsuba as mi
    from sionna.rt.path_solvers import sb_candidate_generator as generator
    from sionna.rt.path_solvers import sb_deterministic as deterministic

    def lattice(count: int):
        across, up = fan.unit_square().T
        return mi.Point2f(across.astype(np.float32), up.astype(np.float32))

    replaced = [(module, module.fibonacci_lattice) for module in (generator, deterministic)]
    try:
        for module, _ in replaced:
            module.fibonacci_lattice = lattice
        yield
    finally:
        for module, original in replaced:
            module.fibonacci_lattice = original


def _on_host(solved: _Solved, stage: Stage, pose: Pose) -> _Bundle:
    """The valid paths as float64, with the radar's own motion taken off the objects' velocities."""
    paths = solved.paths
    valid = paths.valid.numpy().reshape(-1)
    vertices = np.moveaxis(paths.vertices.numpy()[:, 0, 0], 0, 1)[valid].astype(np.float64)
    interactions = np.moveaxis(paths.interactions.numpy()[:, 0, 0], 0, 1)[valid].astype(np.int64)
    shape = np.moveaxis(paths.objects.numpy()[:, 0, 0], 0, 1)[valid].astype(np.int64)
    primitive = np.moveaxis(paths.primitives.numpy()[:, 0, 0], 0, 1)[valid].astype(np.int64)
    real, imaginary = (part.numpy().reshape(-1)[valid].astype(np.float64) for part in paths.a)
    rotation = pose.rotation()
    objects = np.full(shape.shape, -1, dtype=np.int64)
    velocities = np.zeros(vertices.shape)
    for object_id, index in solved.shapes.items():
        mesh = stage.meshes[index]
        here = (shape == object_id) & (interactions > 0)
        objects[here] = mesh.object_of_triangle[primitive[here]]
        velocities[here] = (mesh.velocity - np.asarray(pose.velocity)) @ rotation
    return _Bundle(vertices, interactions, objects, velocities, real - 1j * imaginary)


def _scattered(part: _Bundle, fan: RayFan) -> list[ScatteredPaths]:
    """Paths whose last bounce is diffuse, and the reverses of those that begin with mirrors."""
    if not len(part.amplitude):
        return []
    count, depth = part.interactions.shape
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
    )
    return [paths, paths.take(mirrors > 0).reversed()]


def _specular(part: _Bundle) -> SpecularPaths:
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
    )


def _joined(parts: list[SpecularPaths]) -> SpecularPaths:
    names = [item.name for item in fields(SpecularPaths) if item.name != "reference"]
    return SpecularPaths(
        reference=np.zeros(3), **{name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
    )
