"""An order's inputs made ready: scenes opened and merged, frames dealt, and what the manifest will say of them.

Rendering, tracing, ``plan``, the accuracy sweep and the error budget all start from here.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import version
from typing import Any

import numpy as np

from datafactory.effects.catalogue import ALL, NO_CHOICE
from datafactory.frame.deal import PreparedScene, dealt
from datafactory.frame.points import PointTargets, rayleigh_length
from datafactory.paths.merged_scene import merge_scene
from datafactory.paths.storage import paths_schema
from datafactory.run.job import Job
from datafactory.run.memory import Load
from datafactory.run.order import Order
from datafactory.scenes.boxes import boxed_things
from datafactory.scenes.materials.table import MaterialMapping, MaterialTable
from datafactory.scenes.poses import Pose
from datafactory.scenes.readers.open import open_scene
from datafactory.scenes.scene import Scene
from shared.dataset import arrow_schema, description
from shared.radar import Radar
from shared.signal.tdm import statement
from shared.signal.windows import angle_window, point_spread

Announce = Callable[[str], None]


@dataclass(frozen=True)
class Recipe:
    """What a run follows: it is the last that knows of an order.

    :param job: what determines the bytes of the frames
    :param manifest: its entries that are the run's own, ``arguments`` among them
    """

    job: Job
    manifest: dict[str, Any]


def prepare(
    order: Order, table: MaterialTable, announce: Announce = lambda line: None, paths_alone: bool = False
) -> Recipe:
    """Make an order's inputs ready.

    :param paths_alone: for a folder of traced paths in place of a dataset of frames
    :raises InputError: whatever is wrong with a scene or with a folder of traced paths
    """
    if said := _named_in_vain(order):
        announce(said)
    opened = opened_scenes(order)
    scenes = tuple(prepared_scene(scene, table, announce) for scene in opened)
    arguments, of_scenes = _arguments(order, scenes, paths_alone), order.of_scenes
    entries = [_entry(source, scene.materials) for source, scene in zip(opened, scenes, strict=True)]
    if order.traced is not None:
        entries = order.traced.entries
    deal = dealt(order, opened)
    for said in (*(_late_poses(scene, deal.given) for scene in opened), *deal.remarks()):
        if said:
            announce(said)
    about = {} if paths_alone else _frames_described(order)
    schema = paths_schema() if paths_alone else arrow_schema(about)
    job = Job(
        radar=order.radar,
        deal=deal,
        scenes=scenes,
        settings=order.settings,
        of_scenes=of_scenes,
        schema_message=schema.serialize().to_pybytes(),
        paths_alone=paths_alone,
    )
    stated = {name: about[name] for name in STATED if name in about}
    if order.licence is not None:
        stated["license"] = order.licence
    return Recipe(job, {"arguments": arguments, "scenes": entries, **stated})


STATED = ("radar", "array", "virtual_sensor", "axes", "shapes", "conventions", "truth")
"""What the manifest says as each shard's metadata does."""


def _frames_described(order: Order) -> dict[str, Any]:
    """What the frames of an order are, as each shard's metadata says it."""
    processing = order.settings.processing
    conventions = _conventions(order.radar, processing.truth_window)
    return description(order.radar, processing.peaks, processing.store, conventions)


def _conventions(radar: Radar, window: str) -> dict[str, Any]:
    """What a reader of one shard needs to know beside the axes.

    :param window: of the truth, see :func:`shared.signal.windows.angle_window`
    """
    elements = radar.virtual_sensor.channels
    y, wavelength = radar.virtual_sensor.rx[:, 1], radar.waveform.wavelength_m
    spacing = abs(float(y[1] - y[0])) if len(y) > 1 else 0.0
    width = sidelobe = None  # of what is no line of elements
    if spacing > 0.0:
        width, sidelobe = point_spread(angle_window(window, elements), spacing / wavelength)
    return {
        "conventions": {
            "frame": "x forward, y left, z up, origin at the centroid of the full array's RX; u = y / range",
            "units": "range_channel and image_peak in sqrt(W), noise_power in W per channel and range-Doppler cell",
            "velocity": "; ".join(filter(None, ("range rate, positive is receding", statement(radar)))),
            "image": "truth magnitude relative to image_peak; row r in the first Doppler cell of range bin r",
        },
        "truth": {
            "window": window,
            "width_u": width,
            "width_bins": None if width is None else width / radar.grid.step,
            "peak_sidelobe_db": sidelobe,
            "rayleigh_length_u_of_array": rayleigh_length(radar),
        },
    }


def opened_scenes(order: Order) -> list[Scene]:
    """The scenes of an order, read where they are named.

    :raises InputError: a scene that cannot be read
    """
    return [scene if isinstance(scene, Scene) else open_scene(scene) for scene in order.scenes]


def load_of(order: Order, scenes: Sequence[Scene], rendered: bool = True) -> Load:
    """What decides over the memory of a run.

    :param scenes: of the order, see :func:`opened_scenes`
    :param rendered: whether cubes are made
    """
    return Load(
        order.radar,
        order.settings,
        triangles=sum(scene.triangle_count for scene in scenes),
        traced=bool(scenes),
        rendered=rendered,
        stored_rays=0 if order.traced is None else order.traced.rays,
    )


def _arguments(order: Order, scenes: Sequence[PreparedScene], paths_alone: bool) -> dict[str, Any]:
    """What of an order determines the bytes, by the names that the user knows."""
    settings, found = order.settings, dict[str, Any]()
    if order.traced is not None:
        found["paths"] = list(order.traced.checksums)
    else:
        found |= {
            "scenes": [{"scene": scene.name, "content": scene.content} for scene in scenes],
            "materials": [scene.materials.to_json() for scene in scenes],
            "frames": order.frames,
            "poses": [asdict(pose) for pose in order.poses],
            "tracks": [[asdict(pose) for pose in track] for track in order.tracks],
            "drives": None if order.drives is None else asdict(order.drives),
            "trace": asdict(settings.trace),
        }
        if order.speeds is not None:
            found["speed_mps"] = list(order.speeds)
    if not paths_alone:
        found["processing"] = asdict(settings.processing)
        found["prune_db"] = settings.prune_db
        found["close_targets"] = asdict(settings.close_targets)
    if order.licence is not None:
        found["license"] = order.licence
    return {
        "effects": "auto" if order.effects is None else order.effects.names,
        "budget_db": order.budget_db if order.effects is None else None,
        "points": order.points,
        "targets": [_as_lists(targets) for targets in order.targets],
        "seed": order.seed,
        "split": order.split,
        "radar": order.radar.model_dump(mode="json"),
        "device": settings.device,
        "versions": {name: version(name) for name in ("sparseradar-datafactory", "sionna-rt")},
        **found,
    }


def _as_lists(targets: PointTargets) -> dict[str, Any]:
    arrays = {name: values.tolist() for name, values in vars(targets).items() if name != "models"}
    return arrays | ({"models": [repr(target) for target in targets.models]} if targets.models else {})


def prepared_scene(scene: Scene, table: MaterialTable, announce: Announce) -> PreparedScene:
    """A scene merged, its materials mapped; what was ignored or assumed is announced."""
    materials = table.map_materials([item.material for item in scene.objects])
    for warning in scene.warnings:
        announce(f"{scene.name}: {warning}")
    if scene.population is not None:
        announce(f"{scene.name}: {scene.population.line()}")
    mapped = [f"{name or '(none)'} -> {material.name}" for name, (material, _) in materials.entries.items()
              if name != material.name]  # fmt: skip
    told = f"{len(materials.entries)} materials{', ' if mapped else ''}{', '.join(mapped)}"
    announce(f"{scene.name}: {len(scene.objects)} objects, {scene.triangle_count} triangles, {told}")
    unknown = ", ".join(name or "(none)" for name in materials.unknown)
    if unknown:
        announce(f"{scene.name}: unknown materials given the default: {unknown}")
    return PreparedScene(
        scene.name, scene.content_hash(), merge_scene(scene, materials), materials, boxed_things(scene)
    )


def _named_in_vain(order: Order) -> str:
    """What to say of effects that were chosen and are no choice; "" without such."""
    if order.effects is None or order.effects == ALL or order.traced is not None:
        return ""
    named = ", ".join(name for name in NO_CHOICE if getattr(order.effects, name))
    return f"--effects: {named} made no difference: simulated wherever something to work on is" if named else ""


def _late_poses(scene: Scene, poses: Sequence[Pose]) -> str:
    """What to say of poses at which everything that had samples stands still; "" without such."""
    motions = [item.motion for item in scene.objects] + [target.motion for target in scene.targets]
    ends_s = max((motion.ends_s for motion in motions if motion is not None), default=np.inf)
    late = sum(pose.time_s >= ends_s for pose in poses)
    if not late:
        return ""
    return (
        f"{scene.name}: {late} of {len(poses)} poses are not before {ends_s:g} s, from when on what has samples rests"
    )


def _entry(scene: Scene, materials: MaterialMapping) -> dict[str, Any]:
    return {
        "name": scene.name,
        "source": scene.source,
        "content_sha256": scene.content_hash(),
        "objects": len(scene.objects),
        "triangles": scene.triangle_count,
        "point_targets": len(scene.targets),
        "warnings": list(scene.warnings),
        "materials": materials.to_json(),
        **({} if scene.population is None else {"population": scene.population.to_json()}),
    }
