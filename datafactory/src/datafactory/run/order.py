"""What the user asked for: a frozen value that the command line builds and the pipeline obeys."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

from datafactory.defaults import DEFAULT_BUDGET_DB, DEFAULT_PATTERN, DEFAULT_RAYS
from datafactory.effects.catalogue import ALL, EffectSet
from datafactory.frame.chain import ChainSettings
from datafactory.frame.points import PointTargets
from datafactory.scenes.drives import Drives
from datafactory.scenes.poses import Pose
from datafactory.scenes.scene import Scene
from shared.dataset.locations import Location
from shared.dataset.manifest import read_manifest
from shared.radar import Radar


@dataclass(frozen=True)
class TracedFolder:
    """A folder that ``datafactory trace`` wrote, its manifest read.

    :param split: pattern that its paths were traced with; None where the manifest says nothing of the kind
    :param rays: of a frame that they were traced with, or the usual number where it says nothing of the kind
    """

    folder: Location
    manifest: dict[str, Any]

    @staticmethod
    def opened(folder: Location) -> TracedFolder:
        """:raises InputError: no manifest there, or a damaged one"""
        return TracedFolder(folder, read_manifest(folder))

    @property
    def split(self) -> str | None:
        split = self._argument("split")
        return split if isinstance(split, str) else None

    @property
    def rays(self) -> int:
        trace = self._argument("trace")
        rays = trace.get("rays") if isinstance(trace, dict) else None
        return rays if isinstance(rays, int) else DEFAULT_RAYS

    def _argument(self, name: str) -> Any:
        arguments = self.manifest.get("arguments")
        return arguments.get(name) if isinstance(arguments, dict) else None


@dataclass(frozen=True)
class Order:
    """What the user asked for.

    :param scenes: ``--scene`` arguments, or scenes that were read before, dealt to the frames in turn
    :param frames: scene frames in total
    :param points: close-target frames after them
    :param poses: one frame a pose, instead of ``frames`` drawn ones; empty to draw
    :param tracks: sequences of frames, each at these poses, instead of drawn ones
    :param drives: draw sequences of ``frames`` frames in all
    :param targets: frames of exactly these targets, instead of drawn ones
    :param settings: how a frame is made, with every effect
    :param effects: what is simulated of the scenes; None for what each frame calls for
    :param budget_db: what leaving effects out of a frame may change then
    :param licence: of the data, an SPDX expression; None where none is stated
    :param traced: folder of :func:`datafactory.run.making.trace_paths`, instead of scenes
    """

    radar: Radar
    scenes: tuple[str | Scene, ...] = ()
    frames: int = 0
    points: int = 0
    seed: int = 0
    split: str = DEFAULT_PATTERN
    poses: tuple[Pose, ...] = ()
    tracks: tuple[tuple[Pose, ...], ...] = ()
    drives: Drives | None = None
    targets: tuple[PointTargets, ...] = ()
    traced: TracedFolder | None = None
    settings: ChainSettings = field(default_factory=ChainSettings)
    effects: EffectSet | None = None
    budget_db: float = DEFAULT_BUDGET_DB
    licence: str | None = None

    @property
    def of_scenes(self) -> ChainSettings:
        """How scene frames are made: with what was chosen, or with what each calls for by the budget."""
        if self.effects is not None:
            return self.effects.settings(self.settings)
        every = ALL.settings(self.settings)
        return replace(every, budget_db=self.budget_db, below_noise=self.settings.processing.noise)

    @property
    def given(self) -> tuple[Pose, ...]:
        """Every pose that was given, of tracks one after the other; empty where they are drawn."""
        return self.poses or tuple(pose for track in self.tracks for pose in track)

    @property
    def scene_frames(self) -> int:
        """Number of scene frames, of an order without ``traced``."""
        return len(self.given) or self.frames
