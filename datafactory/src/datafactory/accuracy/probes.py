"""The frames that accuracy is measured on: the same poses, effects and streams of randomness that a run would have."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from datafactory.accuracy.knobs import POWER_EFFECTS, Settings
from datafactory.accuracy.variants import FrontOfSphere, SphereLattice
from datafactory.effects.catalogue import EffectSet
from datafactory.effects.evidence import FLOOR_DB
from datafactory.frame.seeds import frame_seed, generator
from datafactory.paths.merged_scene import Stage
from datafactory.paths.rays import RayFan
from datafactory.paths.table import PathTable
from datafactory.paths.trace import trace
from datafactory.run.cache import Announce
from datafactory.run.job import SceneWork
from datafactory.run.order import Order
from datafactory.run.shards import split_of
from datafactory.run.sources import sources_of
from datafactory.scenes.materials.table import MaterialMapping, MaterialTable
from datafactory.scenes.poses import Pose, sample_pose
from shared.radar import Radar

LATTICES = {"fan": RayFan, "sphere": FrontOfSphere, "all around": SphereLattice}
AHEAD = -1e-6
"""Directions with x above this are ahead: those straight below, at 0 but for rounding, are."""


@dataclass(frozen=True)
class PlannedScene:
    """A scene of an order, made ready, with what a run would simulate of it.

    :param content: hash of the scene
    :param absent: effects that the scene or the radar has nothing for
    """

    content: str
    work: SceneWork
    absent: frozenset[str]

    @property
    def complete(self) -> EffectSet:
        """The planned effects and whatever the plan leaves out of the paths although the scene has it."""
        effects = self.work.effects
        for name in POWER_EFFECTS:
            if name not in self.absent:
                effects = effects.with_also(name)
        return effects


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


def planned_scenes(order: Order, table: MaterialTable, announce: Announce) -> list[PlannedScene]:
    """The order's scenes as :func:`datafactory.run.sources.sources_of` makes them ready and plans them.

    Where the user chose the effects, nothing else is looked at: all others count as absent.

    :raises InputError: whatever is wrong with a scene
    """
    sources = sources_of(order, table, announce)
    scenes = []
    for work, entry in zip(sources.works, sources.entries, strict=True):
        decisions = entry["effect_plan"]["effects"]
        absent = {item["effect"] for item in decisions if item["loss_db"] <= FLOOR_DB}
        if order.effects is not None:
            absent = {item["effect"] for item in decisions if not item["on"]}
        scenes.append(PlannedScene(entry["content_sha256"], work, frozenset(absent)))
    return scenes


def probes_of(work: SceneWork, order: Order, frame_ids: Sequence[int]) -> tuple[Probe, ...]:
    """Frames ``frame_ids`` of a run of this scene, at the order's poses or else at those that the run draws.

    :raises InputError: no free ground for a pose
    """
    probes = []
    for index in frame_ids:
        own = frame_seed(order.seed, index)
        if work.ground is None:
            pose = order.poses[index]
        else:
            pose = sample_pose(work.ground, split_of(index, order.split), generator(own, "pose"))
        probes.append(Probe(index, own, work.stage, work.materials, pose))
    return tuple(probes)


def traced(probe: Probe, settings: Settings, radar: Radar, realisation: int = 0) -> PathTable:
    """Illuminated paths of one realisation; number 0 has the rays of the run itself."""
    stream = generator(probe.seed if realisation == 0 else frame_seed(probe.seed, realisation), "rays")
    fan = LATTICES[settings.lattice](settings.rays, offset=(float(stream.random()), float(stream.random())))
    front_end = radar.front_end
    polarization = (front_end.tx_polarization, front_end.rx_polarization)
    traced_as = replace(settings.trace(), polarization=polarization)
    frequency_hz = radar.waveform.mid_sweep_hz
    paths = trace(probe.stage, probe.materials, probe.pose, frequency_hz, traced_as, fan, int(stream.integers(2**31)))
    if settings.lattice == "sphere":
        paths = _ahead(paths)
    return paths.within(radar).illuminated(settings.effects.front_end(front_end))


def _ahead(paths: PathTable) -> PathTable:
    """Without the paths of rays that the fan does not send: amplitude zero, or mirrors behind at both ends."""
    scattered, specular = paths.scattered, paths.specular
    ahead = (specular.departure()[:, 0] >= AHEAD) | (specular.image[:, 0] >= AHEAD)
    return replace(
        paths,
        scattered=scattered.take(np.flatnonzero(scattered.amplitude != 0.0)),
        specular=specular.take(np.flatnonzero(ahead)),
    )
