"""What a scene file holds, what becomes of it, and what the radar will not see of it: before anything is traced."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from datafactory.paths.curved_surfaces import curved_surfaces_of
from datafactory.paths.edges import edges_of
from datafactory.paths.merged_scene import merge_scene
from datafactory.paths.slabs import Slabs
from datafactory.scenes.ground import sensor_ground
from datafactory.scenes.materials.table import MaterialMapping, MaterialTable
from datafactory.scenes.motion import Moving, Track
from datafactory.scenes.scene import Scene, SceneObject
from shared.dataset.folder import SPLITS
from shared.physics.errors import InputError
from shared.physics.units import SPEED_OF_LIGHT, amplitude_to_db

MID_SWEEP_HZ = 77.5e9
WAVELENGTH_M = SPEED_OF_LIGHT / MID_SWEEP_HZ
PANE_DB = -20.0
"""One-way transmission at normal incidence above which a material counts as a pane."""
SMALL_FACET_M = 3.0 * WAVELENGTH_M
"""Facets with no longer side than this have no use of ray optics: their echo is that of the whole they belong to."""


@dataclass(frozen=True)
class MaterialUse:
    """What became of one material name of the file.

    :param name: in the file; "" where it gives none
    :param material: in the table; :param rule: that chose it, or that none did
    :param known: False for a name that no rule knows: it has the default
    :param objects, triangles: that have it; :param area_m2: of these triangles
    """

    name: str
    material: str
    rule: str
    known: bool
    objects: int
    triangles: int
    area_m2: float


@dataclass(frozen=True)
class MotionUse:
    """How many parts of a scene move in one way.

    :param fastest_mps: largest speed among them
    :param rests_from_s: when the last of them comes to rest; None: never
    """

    kind: str
    parts: int
    fastest_mps: float
    rests_from_s: float | None


@dataclass(frozen=True)
class SceneReport:
    """Everything that ``datafactory check`` says.

    :param size_m: x, y, z
    :param dropped: what the reader left out, or took otherwise than written
    :param ground_m2: free ground of each split, where a sensor may be drawn
    :param remarks: what the radar will not see, or not as it is, and what is unusual
    """

    name: str
    source: str
    size_m: tuple[float, float, float]
    objects: int
    triangles: int
    point_targets: int
    materials: tuple[MaterialUse, ...]
    motions: tuple[MotionUse, ...]
    dropped: tuple[str, ...]
    ground_m2: dict[str, float]
    remarks: tuple[str, ...]


def examine_scene(scene: Scene, table: MaterialTable) -> SceneReport:
    """The report on a scene that was read."""
    mapping = table.map_materials([item.material for item in scene.objects], scene.stated)
    lower, upper = scene.bounds()
    x, y, z = (float(side) for side in upper - lower)
    ground, no_ground = _ground(scene)
    unmatched = table.unmatched(sorted(mapping.entries))
    return SceneReport(
        name=scene.name,
        source=scene.source,
        size_m=(x, y, z),
        objects=len(scene.objects),
        triangles=scene.triangle_count,
        point_targets=len(scene.targets),
        materials=tuple(_materials(scene, mapping)),
        motions=tuple(_motions(scene)),
        dropped=scene.warnings,
        ground_m2=ground,
        remarks=(*no_ground, *([unmatched] if unmatched else ()), *_remarks(scene, mapping)),
    )


def _materials(scene: Scene, mapping: MaterialMapping) -> Iterator[MaterialUse]:
    for name, (material, rule) in mapping.entries.items():
        items = [item for item in scene.objects if item.material == name]
        edges = np.concatenate([_edges(item) for item in items])
        area = 0.5 * float(np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1).sum())
        known = name not in mapping.unknown
        yield MaterialUse(name, material.name, rule, known, len(items), len(edges), area)


def _edges(item: SceneObject) -> NDArray[np.float64]:
    """[T, 3, 3] sides of the triangles [m]."""
    corners = item.vertices[item.triangles]
    return np.roll(corners, -1, axis=1) - corners


def _motions(scene: Scene) -> Iterator[MotionUse]:
    speeds: dict[str, list[float]] = defaultdict(list)
    ends: dict[str, list[float]] = defaultdict(list)
    parts = [(item.motion, item.velocity, item.fastest_mps) for item in scene.objects]
    parts += [(target.motion, target.velocity, target.fastest_mps) for target in scene.targets]
    for motion, velocity, fastest in parts:
        if motion is None:
            kind = "straight on" if any(velocity) else ""
        elif isinstance(motion, Track):
            kind = "along a track"
        else:
            assert isinstance(motion, Moving)
            kind = "turns or changes its size" if motion.shape is None else "changes its shape"
        if kind:
            speeds[kind].append(fastest)
            ends[kind].append(np.inf if motion is None else float(motion.times[-1]))
    for kind, values in speeds.items():
        rests = max(ends[kind])
        yield MotionUse(kind, len(values), max(values), rests if np.isfinite(rests) else None)


def _ground(scene: Scene) -> tuple[dict[str, float], tuple[str, ...]]:
    try:
        ground = sensor_ground(scene)
    except InputError as error:
        return dict.fromkeys(SPLITS, 0.0), (f"no sensor can be drawn: {error}",)
    areas: dict[str, float] = {split: ground.area_m2(split) for split in SPLITS}
    short = [split for split, area in areas.items() if not area]
    remark = f"no free ground for {', '.join(short)}: too small for three regions {ground.gap_m:.1f} m apart"
    return areas, (remark,) if short else ()


def _remarks(scene: Scene, mapping: MaterialMapping) -> Iterator[str]:
    """Sentences, each with its figure."""
    if scene.population is not None:
        yield scene.population.line()
    if not scene.objects:
        return
    merged = merge_scene(scene, mapping)
    every = np.arange(len(merged.slabs))
    one_way, _ = Slabs(list(merged.slabs), MID_SWEEP_HZ).transmission(every, np.ones(len(every)))
    panes = {slab.name for slab, level in zip(merged.slabs, amplitude_to_db(one_way), strict=True) if level > PANE_DB}
    if panes:
        yield f"{', '.join(sorted(panes))} let waves through; every surface is one slab: a pane drawn as a box is two"
    yield from curved_surfaces_of(merged).notes()
    counts = edges_of(merged).counts
    for key, sentence in (
        ("half_planes", "rims of open sheets, each the edge of a half plane: a closed wall would have corners there"),
        ("non_manifold", "edges of more than two triangles send no edge wave"),
        ("doubled_triangles", "triangles lie twice in the same place: one of each pair is used for edges"),
    ):
        if counts.get(key):
            yield f"{counts[key]} {sentence}"
    small = sum(int((np.linalg.norm(_edges(item), axis=2).max(axis=1) < SMALL_FACET_M).sum()) for item in scene.objects)
    if small:
        yield (
            f"{small} triangles have no side above {SMALL_FACET_M * 1e3:.0f} mm, three wavelengths: rays meet them "
            "rarely, and alone they are no mirrors; a radar cross section says more"
        )
    turning = [item for item in scene.objects if isinstance(item.motion, Moving)]
    if turning:
        yield f"{len(turning)} objects turn or deform: within a frame each point goes straight on with its own velocity"
