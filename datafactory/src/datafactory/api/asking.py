"""What a caller says, as the values that a run takes: scenes, radar, poses, materials, an order.

The commands and the functions of :mod:`datafactory` share it, so that both refuse the same things in the same words.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

from datafactory.api.options import (
    LoadOptions,
    MaterialsLike,
    OrderOptions,
    PosesLike,
    RadarLike,
    SceneLike,
    SceneOptions,
    TargetsLike,
    TrajectoryLike,
)
from datafactory.defaults import (
    AUTO_DEVICE,
    CPU,
    CUDA,
    DEFAULT_BUDGET_DB,
    DEFAULT_DEPTH,
    DEFAULT_FRAMES,
    DEFAULT_PATTERN,
    DEFAULT_RAYS,
    INSTALL_TORCH,
)
from datafactory.effects.catalogue import parse_effects
from datafactory.frame.chain import ChainSettings
from datafactory.frame.deal import StoredRow
from datafactory.frame.draws import parse_split_pattern
from datafactory.frame.measurement import Processing
from datafactory.frame.points import PointTargets, read_targets
from datafactory.paths.backend import cuda_device
from datafactory.paths.solver import TraceSettings
from datafactory.run.card import stated_licence
from datafactory.run.preparation import Order, stored_paths
from datafactory.scenes.drives import WORD, Drives, parse_drives
from datafactory.scenes.materials.table import MaterialTable, load_materials
from datafactory.scenes.poses import Pose, Speeds, parse_speeds, read_poses
from datafactory.scenes.readers.common import Reading, parse_variants
from datafactory.scenes.readers.open import open_scene
from datafactory.scenes.scene import Scene
from datafactory.scenes.tracks import read_track, track_of
from datafactory.scenes.traffic.arrange import Asked, parse_populate
from datafactory.scenes.traffic.population import populated
from datafactory.synthesis.cube import synthesis_problem
from shared.dataset.locations import locate
from shared.physics.errors import InputError
from shared.processes.declared import declared, taking
from shared.radar import Radar, load_radar

T = TypeVar("T")


@taking(LoadOptions)
def load_scene(asked: LoadOptions) -> Scene:
    """Read a scene: meshes in metres, z up, float64, each with the name of its material.

    :raises InputError: an unknown suffix or name, a file that is missing, damaged or empty; with ``populate`` one that
        has no free ground
    """
    scene, traffic = asked.source, asked.populate
    traffic = parse_populate(traffic) if isinstance(traffic, str) else traffic
    if not isinstance(traffic, Asked | None):
        raise InputError("--populate", repr(traffic), "text such as 'cars=20,parked=0.6'")
    reading = Reading(parse_variants(asked.variant), asked.allow_missing)
    if not isinstance(scene, Scene):
        scene = open_scene(str(scene), reading)
    elif reading != Reading():
        raise InputError(scene.name, "has been read", "--variant and --allow-missing of a file")
    return scene if traffic is None else populated(scene, traffic, asked.seed)


def radar_of(radar: RadarLike) -> Radar:
    """:raises InputError: an unknown name, an unreadable file, a value that no radar has"""
    return radar if isinstance(radar, Radar) else load_radar(str(radar))


def poses_of(poses: PosesLike | None) -> tuple[Pose, ...]:
    """:raises InputError: a file that is unreadable or wrong, or what is no pose"""
    if poses is None:
        return ()
    found = read_poses(Path(poses)) if isinstance(poses, str | Path) else _each(Pose, poses, "--poses")
    if not found:
        raise InputError("--poses", repr(poses), "one pose or more")
    return found


def _each(kind: type[T], values: object, option: str) -> tuple[T, ...]:
    """:raises InputError: no sequence, or one of anything else"""
    found = tuple(values) if isinstance(values, Iterable) else None
    for wrong in (values,) if found is None else (item for item in found if not isinstance(item, kind)):
        raise InputError(option, repr(wrong), f"{kind.__name__} objects, or a file")
    return found or ()


def trajectory_of(
    trajectory: TrajectoryLike | None, frame_rate: float | None
) -> tuple[tuple[tuple[Pose, ...], ...], Drives | None]:
    """The tracks that were given, and the drives that are to be drawn: one of them, or neither.

    :param frame_rate: [Hz]; None for one frame a row of a file
    :raises InputError: a file that is unreadable or wrong, a rate out of bounds, drives beside files
    """
    if trajectory is None:
        if frame_rate is not None:
            raise InputError("--frame-rate", "without --trajectory", "--trajectory FILE, or none of both")
        return (), None
    if isinstance(trajectory, Drives):
        return (), trajectory if frame_rate is None else replace(trajectory, rate_hz=frame_rate)
    several = (trajectory,) if isinstance(trajectory, str | Path) else trajectory
    several = tuple(several) if isinstance(several, Iterable) else ()
    if not several:
        raise InputError("--trajectory", repr(trajectory), "drives, or files or tracks of poses, one or more")
    drawn = [item for item in several if isinstance(item, str) and item.partition(":")[0] == WORD]
    if drawn:
        if len(several) > 1:
            raise InputError("--trajectory", f"{drawn[0]!r} beside others", "drives, or files")
        return (), parse_drives(drawn[0], frame_rate)
    return tuple(_track_of(item, frame_rate) for item in several), None


def _track_of(item: str | Path | Sequence[Pose], frame_rate: float | None) -> tuple[Pose, ...]:
    if isinstance(item, Pose):
        raise InputError("--trajectory", "a pose in place of a track", "tracks in a list, each a sequence of poses")
    if not isinstance(item, str | Path):
        if frame_rate is not None:
            raise InputError("--frame-rate", "beside poses", "a file, whose rows it lies between")
        track = _each(Pose, item, "--trajectory")
        if not track:
            raise InputError("--trajectory", "a track without poses", "one or more")
        return track_of(track, "--trajectory")
    curve = read_track(Path(item))
    return curve.rows() if frame_rate is None else curve.resampled(frame_rate)


def speeds_of(asked: OrderOptions, drives: Drives | None) -> Speeds | None:
    """Ends of the speeds that are to be drawn; None where none are asked for.

    :raises InputError: no two speeds, out of bounds, or beside what states them
    """
    if asked.speed is None:
        return None
    stated = {
        "--poses": asked.poses is not None,
        "--trajectory FILE": asked.trajectory is not None and drives is None,
        "--trajectory drive:speed=": drives is not None and drives.speed_mps is not None,
    }
    for other in (name for name, there in stated.items() if there):
        raise InputError("--speed", f"beside {other}, which states them", "one of them")
    return parse_speeds(asked.speed)


def materials_of(materials: MaterialsLike | None) -> MaterialTable:
    """:raises InputError: a file that is unreadable or wrong"""
    if isinstance(materials, MaterialTable):
        return materials
    return load_materials(None if materials is None else Path(materials))


def scenes_of(
    scenes: SceneLike | Sequence[SceneLike] | None, asked: SceneOptions, seed: int
) -> tuple[str | Scene, ...]:
    """One scene or several, paths as text; read already where they are to be read or populated in a way of their own.

    :raises InputError: nothing to populate, a scene that cannot be read so
    """
    several: Sequence[SceneLike] = (scenes,) if isinstance(scenes, str | Path | Scene) else scenes or ()
    if not isinstance(several, Iterable):
        raise InputError("--scene", repr(scenes), "a path, a name or a Scene, or several")
    if asked.populate is not None and not several:
        raise InputError("--populate", "given without a scene", "--scene with it")
    if not (asked.variant or asked.allow_missing or asked.populate is not None):
        return tuple(scene if isinstance(scene, Scene) else str(scene) for scene in several)
    same = {name: getattr(asked, name) for name in ("variant", "allow_missing", "populate")}
    return tuple(load_scene(scene, **same, seed=seed) for scene in several)


def targets_of(targets: TargetsLike) -> tuple[PointTargets, ...]:
    """:raises InputError: a file that is unreadable or wrong, or what is no targets of a frame"""
    if isinstance(targets, str | Path):
        return read_targets(Path(targets))
    return _each(PointTargets, targets, "--targets")


def device_of(asked: str, tracing: bool, synthesis: bool) -> str:
    """``"cpu"`` or ``"cuda"``: what was asked for, or what is there.

    The device is chosen once, before anything is made, and is one of the arguments that determine the bytes. A run that
    is resumed on another device is therefore refused, also where ``auto`` finds another one than before.

    :param asked: one of :data:`datafactory.defaults.ASKED_DEVICES`; ``"auto"`` is CUDA where it can be used
    :param tracing: whether rays are to be traced on it, which needs OptiX
    :param synthesis: whether signals are to be made on it, which needs torch
    :raises InputError: CUDA was asked for and something that it needs is missing
    """
    if asked == CPU:
        return CPU
    found = _lacking(tracing, synthesis)
    if found is None:
        return CUDA
    if asked == AUTO_DEVICE:
        return CPU
    problem, remedy = found
    raise InputError("--device", f"{asked}: {problem}", remedy)


def _lacking(tracing: bool, synthesis: bool) -> tuple[str, str] | None:
    """What CUDA lacks, and what would be right."""
    device = cuda_device()
    if device.problem and (tracing or not device.name):
        return device.problem, device.remedy
    problem = synthesis_problem() if synthesis else None
    return None if problem is None else (problem, f"{INSTALL_TORCH}; or --device cpu")


SETTLED = (
    "variant", "allow_missing", "populate", "materials", "poses", "trajectory", "frames", "speed", "rays", "depth",
)  # fmt: skip
"""Options of :class:`OrderOptions` that traced paths have settled: beside them they would change nothing."""


def order_of(asked: OrderOptions, synthesis: bool = True) -> Order:
    """The order of a run.

    :param synthesis: whether signals will be made, and not paths alone
    :raises InputError: a file that cannot be read, options that exclude each other, nothing to render
    """
    traced = asked.paths is not None
    scenes = scenes_of(asked.scenes, asked, asked.seed or 0)
    if scenes and traced:
        raise InputError("--scene", "given together with --paths", "either --scene or --paths")
    for item in declared(OrderOptions):
        if traced and item.name in SETTLED and getattr(asked, item.name) != item.default:
            expected = f"--paths alone, or datafactory trace with {item.flag}"
            raise InputError(item.flag, "beside --paths: the trace has settled it", expected)
    if asked.split is not None:
        parse_split_pattern(asked.split)
    poses, targets = poses_of(asked.poses), targets_of(asked.targets)
    if asked.trajectory is not None and asked.poses is not None:
        raise InputError("--trajectory", "beside --poses", "one of them")
    tracks, drives = trajectory_of(asked.trajectory, asked.frame_rate)
    for other, stated in (("--poses", poses), ("--trajectory FILE", tracks)):
        if stated and asked.frames:
            raise InputError("--frames", f"beside {other}, which has a frame a pose", "one of them")
    if targets and asked.points:
        raise InputError("--points", "beside targets, which are those of each frame", "one of them")
    drawn = DEFAULT_FRAMES if asked.frames is None else asked.frames
    frames = 0 if poses or tracks else drawn
    of_scenes = bool(poses or tracks or frames)
    if of_scenes and not scenes and not traced:
        raise InputError("--scene", "missing", "a scene file or sionna:NAME, or --paths")
    if not (of_scenes or traced or asked.points or targets):
        raise InputError("--frames", "0 and --points 0: nothing to render", "at least one frame")
    if scenes and not of_scenes:
        raise InputError("--scene", "beside --frames 0, which makes none of it", "one of them")
    if not isinstance(asked.effects, Iterable):
        raise InputError("--effects", repr(asked.effects), "auto, all, or names of effects")
    effects = parse_effects(asked.effects if isinstance(asked.effects, str) else ",".join(asked.effects))
    if traced and asked.error_budget is not None and effects is not None:
        expected = "--effects auto, or datafactory trace with --error-budget"
        raise InputError("--error-budget", "beside --paths and chosen effects: it would change nothing", expected)
    radar, folder, rows = radar_of(asked.radar), None, tuple[StoredRow, ...]()
    if asked.paths is not None:
        folder, rows = stored_paths(locate(asked.paths), radar, asked.split, effects)
    return Order(
        radar=radar,
        scenes=scenes,
        traced=folder,
        stored=rows,
        frames=frames,
        points=asked.points,
        seed=(folder.arguments.seed if folder else 0) if asked.seed is None else asked.seed,
        split=asked.split or (folder and folder.arguments.split) or DEFAULT_PATTERN,
        poses=poses,
        tracks=tracks,
        drives=drives if drawn else None,
        speed_mps=speeds_of(asked, drives),
        targets=targets,
        settings=ChainSettings(
            trace=TraceSettings(rays=asked.rays or DEFAULT_RAYS, depth=asked.depth or DEFAULT_DEPTH),
            processing=Processing(noise=asked.noise, store=asked.store, truth_window=asked.truth_window),
            device=device_of(asked.device, bool(scenes), synthesis),
        ),
        effects=effects,
        budget_db=asked.error_budget or DEFAULT_BUDGET_DB,
        license=stated_licence(asked.license),
    )
