"""The frames that accuracy is measured on: the same poses and streams of randomness that a run would draw."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from datafactory.accuracy.knobs import Settings
from datafactory.accuracy.variants import SphereLattice
from datafactory.paths.density import cell_power
from datafactory.paths.rays import RayFan
from datafactory.paths.stage import Stage, stage_of
from datafactory.paths.table import PathTable
from datafactory.paths.trace import trace
from datafactory.scenes.ground import free_ground
from datafactory.scenes.materials import MaterialMapping, MaterialTable
from datafactory.scenes.poses import Pose, sample_pose
from datafactory.scenes.scene import Scene
from datafactory.seeds import frame_seed, generator
from datafactory.shards import split_of
from shared.radar import Radar


@dataclass(frozen=True)
class Probe:
    """A frame to measure on.

    :param frame_id: its index in the run
    :param seed: the frame's own seed
    """

    frame_id: int
    seed: int
    stage: Stage
    materials: MaterialMapping
    pose: Pose


def probes_of(
    scene: Scene,
    table: MaterialTable,
    poses: tuple[Pose, ...],
    frame_ids: tuple[int, ...],
    seed: int,
    split: str = "6:1:1",
) -> tuple[Probe, ...]:
    """Frames ``frame_ids`` of a run of this scene, at the given poses or else at those that the run draws.

    :raises InputError: no free ground for a pose
    """
    materials = table.map_materials([item.material for item in scene.objects])
    stage = stage_of(scene, materials)
    ground = None if poses else free_ground(scene)
    probes = []
    for index in frame_ids:
        own = frame_seed(seed, index)
        pose = poses[index] if ground is None else sample_pose(ground, split_of(index, split), generator(own, "pose"))
        probes.append(Probe(index, own, stage, materials, pose))
    return tuple(probes)


def traced(probe: Probe, settings: Settings, radar: Radar, realisation: int = 0) -> PathTable:
    """Illuminated paths of one realisation; number 0 has the rays of the run itself."""
    stream = generator(probe.seed if realisation == 0 else frame_seed(probe.seed, realisation), "rays")
    lattice = SphereLattice if settings.lattice == "sphere" else RayFan
    fan = lattice(settings.rays, offset=(float(stream.random()), float(stream.random())))
    frequency_hz = radar.waveform.mid_sweep_hz
    paths = trace(
        probe.stage, probe.materials, probe.pose, frequency_hz, settings.trace(), fan, int(stream.integers(2**31))
    )
    return paths.within(radar).illuminated(radar.front_end)


def mean_cell_power(
    probe: Probe, settings: Settings, radar: Radar, realisations: range
) -> tuple[NDArray[np.float64], float]:
    """[R, U'] :func:`cell_power` averaged over realisations of the rays, and the mean number of paths."""
    power, paths = [], []
    for number in realisations:
        table = traced(probe, settings, radar, number)
        power.append(cell_power(table, radar))
        paths.append(len(table))
    return np.mean(power, axis=0), float(np.mean(paths))
