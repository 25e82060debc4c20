"""What a caller says, as the values that a run takes: scenes, radar, poses, materials, an order.

The commands and the functions of :mod:`datafactory` share it, so that both refuse the same things in the same words.
An argument is named as its option is, ``--frames`` for ``frames``.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeAlias

from datafactory.effects.catalogue import AUTO, EffectSet, parse_effects
from datafactory.frame.chain import ChainSettings
from datafactory.frame.deal import parse_split_pattern
from datafactory.frame.defaults import (
    DEFAULT_BUDGET_DB,
    DEFAULT_PATTERN,
    LARGEST_BUDGET_DB,
    SMALLEST_BUDGET_DB,
)
from datafactory.frame.device import device_of
from datafactory.frame.measurement import Processing
from datafactory.frame.points import PointTargets
from datafactory.paths.defaults import CPU, DEFAULT_DEPTH, DEFAULT_RAYS, LARGEST_DEPTH, MOST_RAYS
from datafactory.paths.solver import TraceSettings
from datafactory.run.licences import stated_licence
from datafactory.run.order import Order
from datafactory.run.stored import traced_split
from datafactory.scenes.drives import WORD, Drives, parse_drives
from datafactory.scenes.materials.table import MaterialTable, load_materials
from datafactory.scenes.poses import Pose, read_poses
from datafactory.scenes.readers.open import open_scene
from datafactory.scenes.readers.reading import Reading, parse_variants
from datafactory.scenes.scene import Scene
from datafactory.scenes.track_files import read_track
from datafactory.scenes.traffic.asked import Asked, parse_populate
from datafactory.scenes.traffic.population import populated
from shared.dataset import STORES
from shared.dataset.locations import Location, locate
from shared.physics.errors import InputError, meant
from shared.processes.defaults import LARGEST_SEED
from shared.radar import Radar, load_radar
from shared.signal.windows import ANGLE_WINDOWS

FileName: TypeAlias = str | Path
SceneLike: TypeAlias = str | Path | Scene
"""A file's path, ``"shipped:NAME"``, ``"sionna:NAME"``, or a scene that was read or built before."""
RadarLike: TypeAlias = str | Path | Radar
"""A preset's name, the path of a TOML file, or a radar."""
PosesLike: TypeAlias = str | Path | Sequence[Pose]
"""The path of a JSON file, see :func:`datafactory.scenes.poses.read_poses`, or the poses themselves."""
TrajectoryLike: TypeAlias = str | Path | Drives | Sequence[str | Path | Sequence[Pose]]
"""The path of a CSV or JSON file, see :func:`datafactory.scenes.track_files.read_track`; several, or the poses of
several tracks, a sequence each; or ``"drive"``, ``"drive:speed=10,seconds=4"`` or what that means, to draw them."""
MaterialsLike: TypeAlias = str | Path | MaterialTable
"""The path of a TOML file that overrides the built-in table, or a table."""
Effects: TypeAlias = str | Collection[str]
"""``"auto"``, ``"all"``, names separated by commas, or a collection of names."""

Announce: TypeAlias = Callable[[str], None]
"""Takes a line for the user: how materials were mapped, what was left out, a warning."""
Progress: TypeAlias = Callable[[str, int, int], None]
"""Takes what is being done, how much of it is done, and of how much: ``("planning", 1, 3)``, ``("frames", 5, 8)``; with
an error budget also ``(what is measured, 7, 40)``."""


def silent(*_: object) -> None:
    """An :data:`Announce` and a :data:`Progress` that do nothing."""


def load_scene(
    source: FileName,
    *,
    variant: Sequence[str] = (),
    allow_missing: bool = False,
    populate: str | Asked | None = None,
    seed: int = 0,
) -> Scene:
    """Read a scene: meshes in metres, z up, float64, each with the name of its material.

    :param source: a ``.usd .usda .usdc .usdz``, Mitsuba ``.xml``, ``.glb .gltf .obj .ply .stl`` file, or
        ``"shipped:NAME"`` or ``"sionna:NAME"`` for a scene that this package or Sionna ships
    :param variant: ``"set=name"`` each: variants of a USD scene, over those that the file selects
    :param allow_missing: go on without geometry that cannot be opened
    :param populate: traffic and street furniture to put on its free ground, ``"cars=20,parked=0.6"``
    :param seed: of the dataset; what is put where follows from it and from the scene
    :raises InputError: an unknown suffix or name, a file that is missing, damaged or empty; with ``populate`` one that
        has no free ground
    """
    asked = parse_populate(populate) if isinstance(populate, str) else populate
    scene = open_scene(str(source), Reading(parse_variants(variant), allow_missing))
    return scene if asked is None else populated(scene, asked, seed)


def radar_of(radar: RadarLike) -> Radar:
    """:raises InputError: an unknown name, an unreadable file, a value that no radar has"""
    return radar if isinstance(radar, Radar) else load_radar(str(radar))


def poses_of(poses: PosesLike | None) -> tuple[Pose, ...]:
    """:raises InputError: a file that is unreadable or wrong"""
    if poses is None:
        return ()
    return read_poses(Path(poses)) if isinstance(poses, str | Path) else tuple(poses)


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
    several = (trajectory,) if isinstance(trajectory, str | Path) else tuple(trajectory)
    drawn = [item for item in several if isinstance(item, str) and item.partition(":")[0] == WORD]
    if drawn:
        if len(several) > 1:
            raise InputError("--trajectory", f"{drawn[0]!r} beside others", "drives, or files")
        return (), parse_drives(drawn[0], frame_rate)
    return tuple(_track_of(item, frame_rate) for item in several), None


def _track_of(item: str | Path | Sequence[Pose], frame_rate: float | None) -> tuple[Pose, ...]:
    if not isinstance(item, str | Path):
        if frame_rate is not None:
            raise InputError("--frame-rate", "beside poses", "a file, whose rows it lies between")
        return tuple(item)
    curve = read_track(Path(item))
    return curve.rows() if frame_rate is None else curve.resampled(frame_rate)


def materials_of(materials: MaterialsLike | None) -> MaterialTable:
    """:raises InputError: a file that is unreadable or wrong"""
    if isinstance(materials, MaterialTable):
        return materials
    return load_materials(None if materials is None else Path(materials))


def scenes_of(scenes: SceneLike | Sequence[SceneLike] | None) -> tuple[str | Scene, ...]:
    """One scene or several, paths as text; none for None."""
    if scenes is None:
        return ()
    several: Sequence[SceneLike] = (scenes,) if isinstance(scenes, str | Path | Scene) else scenes
    return tuple(scene if isinstance(scene, Scene) else str(scene) for scene in several)


def effects_of(effects: Effects) -> EffectSet | None:
    """None for what the plan says; :raises InputError: an unknown name"""
    return parse_effects(effects if isinstance(effects, str) else ",".join(effects))


def require(option: str, value: float, least: float, most: float = float("inf")) -> None:
    """Refuse what is out of bounds.

    :raises InputError: naming both
    """
    if not least <= value <= most:
        expected = f"at least {least:g}" if most == float("inf") else f"{least:.12g} to {most:.12g}"
        raise InputError(option, f"{value!r}", expected)


def choice(option: str, value: str, allowed: Sequence[str]) -> str:
    """``value``, if it is one of ``allowed``.

    :raises InputError: naming them
    """
    if value not in allowed:
        raise InputError(option, repr(value), f"one of {', '.join(allowed)}{meant(value, allowed)}")
    return value


def order_of(
    scenes: SceneLike | Sequence[SceneLike] | None,
    *,
    paths: FileName | Location | None = None,
    radar: RadarLike,
    frames: int = 0,
    points: int = 0,
    targets: Sequence[PointTargets] = (),
    poses: PosesLike | None = None,
    trajectory: TrajectoryLike | None = None,
    frame_rate: float | None = None,
    seed: int = 0,
    split: str | None = None,
    rays: int | None = None,
    depth: int | None = None,
    effects: Effects = AUTO,
    error_budget: float | None = None,
    noise: bool = True,
    store: str = STORES[0],
    truth_window: str = "taylor-30",
    device: str = CPU,
    synthesis: bool = True,
    license: str | None = None,
) -> Order:
    """The order of a run; the arguments are those of :func:`datafactory.render`.

    :param split: None for that of ``paths``, or the usual one
    :param rays, depth, error_budget: None for the usual ones
    :param device: "auto" is settled here
    :param synthesis: whether signals will be made, and not paths alone
    :raises InputError: a value out of its bounds, a file that cannot be read, nothing to render
    """
    folder, wanted = None if paths is None else locate(paths), scenes_of(scenes)
    if wanted and folder is not None:
        raise InputError("--scene", "given together with --paths", "either --scene or --paths")
    if split is not None:
        parse_split_pattern(split)
    for option, value, least, most in (
        ("--frames", frames, 0, float("inf")),
        ("--points", points, 0, float("inf")),
        ("--seed", seed, 0, LARGEST_SEED),
        ("--rays", DEFAULT_RAYS if rays is None else rays, 1, MOST_RAYS),
        ("--depth", DEFAULT_DEPTH if depth is None else depth, 1, LARGEST_DEPTH),
        (
            "--error-budget",
            DEFAULT_BUDGET_DB if error_budget is None else error_budget,
            SMALLEST_BUDGET_DB,
            LARGEST_BUDGET_DB,
        ),
    ):
        require(option, value, least, most)
    given = poses_of(poses)
    if trajectory is not None and (poses is not None or folder is not None):
        raise InputError("--trajectory", f"beside --{'poses' if folder is None else 'paths'}", "one of them")
    tracks, drives = trajectory_of(trajectory, frame_rate)
    if (given or tracks or frames) and not wanted and folder is None:
        raise InputError("--scene", "missing", "a scene file or sionna:NAME, or --paths")
    if not (given or tracks or folder or frames or points or targets):
        raise InputError("--frames", "0 and --points 0: nothing to render", "at least one frame")
    if split is None and folder is not None:
        split = traced_split(folder)
    return Order(
        radar=radar_of(radar),
        scenes=wanted if given or tracks or frames else (),
        paths=folder,
        frames=0 if given or tracks else frames,
        points=0 if targets else points,
        seed=seed,
        split=split or DEFAULT_PATTERN,
        poses=given,
        tracks=tracks,
        drives=drives if frames else None,
        targets=tuple(targets),
        settings=ChainSettings(
            trace=TraceSettings(
                rays=DEFAULT_RAYS if rays is None else rays, depth=DEFAULT_DEPTH if depth is None else depth
            ),
            processing=Processing(
                noise=noise,
                store=choice("--store", store, STORES),
                truth_window=choice("--truth-window", truth_window, ANGLE_WINDOWS),
            ),
            device=device_of(device, bool(wanted), synthesis),
        ),
        effects=effects_of(effects),
        budget_db=DEFAULT_BUDGET_DB if error_budget is None else error_budget,
        licence=stated_licence(license),
    )
