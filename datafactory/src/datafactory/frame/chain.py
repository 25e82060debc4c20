"""One frame: trace, narrow, within reach, illuminate, prune, measure, image. The method, in its order.

Everything that makes a frame, or a part of one, comes here: the shards' worker, ``plan``, its proof and its timing,
the accuracy sweep. What wants to look in between hands in a hook. A hook is called at every step as
``at(step, function, *arguments)`` and returns what the function returns. It may time the call, keep its value, or let
something else take its place.

Frames are imaged in batches, which share the matrices of the image; a frame has the same bytes in every batch.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from itertools import islice

from datafactory.defaults import CPU, IMAGE_BATCH
from datafactory.frame.deal import DealtFrame, PreparedScene, StoredRow
from datafactory.frame.decision import Decided, doppler_called_for, path_effects
from datafactory.frame.draws import generator
from datafactory.frame.measurement import (
    Hook,
    Measurement,
    Processing,
    boxes_of,
    image,
    measure,
    object_targets,
    plainly,
    targets_beyond,
)
from datafactory.frame.points import CloseTargets, draw_close_targets
from datafactory.paths.backend import select_variant
from datafactory.paths.cells import DEFAULT_LEVEL_DB, lit_cells, pruned
from datafactory.paths.notice import Notice
from datafactory.paths.rays import RayFan
from datafactory.paths.solver import TraceSettings
from datafactory.paths.storage import TracedFrame, read_frame_paths
from datafactory.paths.table import PathTable
from datafactory.paths.trace import trace
from datafactory.scenes.boxes import seen_things
from datafactory.synthesis.cube import kernels_on
from shared.dataset import Frame
from shared.radar import Radar

FRAMES_WITH = "frames_with_"
"""Before an effect's name, in the manifest's counts: how many frames were made with it."""

POINTS_TOLERANCE = 1e-6
"""Of the cube of point targets, whose places are given exactly: they are few, and the tolerance is cheap."""


@dataclass(frozen=True)
class ChainSettings:
    """How a frame is made.

    :param trace: how its scene is traced; the polarisation is the radar's
    :param processing: what turns paths into columns
    :param prune_db: see :func:`datafactory.paths.cells.pruned`
    :param antenna_pattern: an effect: the elements' gain by direction; off: the gain of boresight everywhere
    :param close_targets: distributions of the targets of a point frame
    :param budget_db: what leaving effects out of a frame may change [dB of the peak]: each frame then has what its own
        paths call for, of the effects that are on; None for all of them
    :param below_noise: whether what is left out by the budget has to be below the receiver's noise as well
    :param device: where rays are traced and signals made: "cpu" or "cuda"
    """

    trace: TraceSettings = field(default_factory=TraceSettings)
    processing: Processing = field(default_factory=Processing)
    prune_db: float = DEFAULT_LEVEL_DB
    antenna_pattern: bool = True
    close_targets: CloseTargets = field(default_factory=CloseTargets)
    budget_db: float | None = None
    below_noise: bool = True
    device: str = CPU

    def notice(self, radar: Radar) -> Notice | None:
        """What decides over what is left out of a frame; None where nothing is."""
        if self.budget_db is None:
            return None
        window = self.processing.truth_window
        return Notice(radar, self.budget_db, self.below_noise, self.antenna_pattern, window)

    def signal_effects(self, radar: Radar) -> dict[str, bool]:
        """Effects that work on the paths that there are, by name, on or off.

        What comes with Doppler has no form of its own without it, and the near field is always there. One chirp shows
        of motion what happens within it.
        """
        front_end, moving = radar.front_end, self.processing.doppler
        doppler = moving and radar.waveform.chirps > 1
        directive = not front_end.tx_pattern.kind == front_end.rx_pattern.kind == "isotropic"
        return {
            "doppler": doppler,
            "range_migration": doppler,
            "intra_chirp_motion": moving,
            "near_field": True,
            "antenna_pattern": self.antenna_pattern and directive,
            "noise": self.processing.noise,
        }


@dataclass(frozen=True)
class SceneSource:
    """A scene frame that is traced now."""

    frame: DealtFrame
    scene: PreparedScene
    settings: ChainSettings

    def traced(self, radar: Radar, at: Hook = plainly) -> TracedFrame:
        """Pose and multipath, independent of the radar but for its wavelength, its polarisation, and what it would not
        notice where a budget leaves that out."""
        select_variant(self.settings.device)
        frame, scene, front_end = self.frame, self.scene, radar.front_end
        pose, rays = frame.where, frame.rays()
        fan = RayFan(self.settings.trace.rays, offset=rays.offset)
        settings = replace(self.settings.trace, polarization=(front_end.tx_polarization, front_end.rx_polarization))
        table = at(
            "trace", trace, scene.merged, pose, radar.waveform.mid_sweep_hz, settings, fan,
            rays.solver_seed, frame.target_seed(), self.settings.notice(radar),
        )  # fmt: skip
        return TracedFrame(
            frame_id=frame.frame_id,
            scene=scene.name,
            scene_number=frame.scene,
            seed=frame.seed,
            pose=pose,
            wavelength_m=radar.waveform.wavelength_m,
            point_targets=len(scene.merged.targets),
            table=table,
            things=seen_things(scene.things, pose),
            sequence=frame.sequence,
        )


@dataclass(frozen=True)
class StoredSource:
    """A scene frame that was traced before.

    :param seed: the frame's own, of what is drawn from now on: noise
    """

    row: StoredRow
    seed: int
    settings: ChainSettings

    def traced(self, radar: Radar, at: Hook = plainly) -> TracedFrame:
        """The row."""
        return replace(at("read", read_frame_paths, self.row.shard, self.row.row), seed=self.seed)


@dataclass(frozen=True)
class TracedSource:
    """A scene frame that was traced in this process, to be made more than once."""

    frame: TracedFrame
    settings: ChainSettings

    def traced(self, radar: Radar, at: Hook = plainly) -> TracedFrame:
        """The frame."""
        return self.frame


@dataclass(frozen=True)
class PointSource:
    """A frame of point targets."""

    frame: DealtFrame
    settings: ChainSettings


Source = SceneSource | StoredSource | TracedSource | PointSource


def make_frames(sources: Iterable[Source], radar: Radar, at: Hook = plainly) -> Iterator[tuple[Frame, Counter[str]]]:
    """Frames from their sources, each with what it counted."""
    remaining = iter(sources)
    while batch := list(islice(remaining, IMAGE_BATCH)):
        measurements = [measured(source, radar, at) for source in batch]
        yield from image(measurements, radar, at)


def measured(source: Source, radar: Radar, at: Hook = plainly) -> Measurement:
    """A frame up to its image: trace, narrow, within reach, illuminate, prune, measure."""
    settings = source.settings
    if isinstance(source, PointSource):
        dealt = source.frame
        targets = dealt.targets
        if targets is None:
            targets = draw_close_targets(radar, settings.close_targets, generator(dealt.seed, "targets"))
        targets = targets.echo_points(radar, dealt.target_seed())
        frame = Frame(dealt.frame_id, "points", "points", dealt.seed, targets=targets.truth(radar))
        paths, counted = targets.path_table(radar), dict[str, int]()
        tolerance = min(settings.processing.tolerance, POINTS_TOLERANCE)
        settings = replace(settings, processing=replace(settings.processing, tolerance=tolerance))
    else:
        traced = source.traced(radar, at)
        settings, paths = narrowed(traced, settings, radar, at)
        effects = {**path_effects(paths), **settings.signal_effects(radar)}
        boxes, boxed = boxes_of(traced.things, paths, radar)
        paths = at("prune", pruned, paths, radar, settings.prune_db)
        first = len(paths.objects) - traced.point_targets
        pose, (known, listed) = traced.pose, object_targets(paths, first, radar)
        frame = Frame(
            traced.frame_id, "scene", traced.scene, traced.seed, pose.position, pose.velocity, pose.quaternion(),
            targets=known, boxes=boxes, time=pose.time_s, sequence=traced.sequence,
        )  # fmt: skip
        counted = {
            **lit_cells(paths, radar),
            **boxed,
            **listed,
            "targets_beyond_range": targets_beyond(traced.table.candidates, radar),
            **{f"{FRAMES_WITH}{name}": int(on) for name, on in effects.items()},
        }
    found = measure(frame, paths, radar, settings.processing, at, kernels_on(settings.device))
    return replace(found, counts={**paths.counts, **counted, "frames": 1, "paths": len(paths), **found.counts})


def illuminated(traced: TracedFrame, settings: ChainSettings, radar: Radar, at: Hook = plainly) -> PathTable:
    """A traced frame's paths as this radar lights them, amplitudes in sqrt(W)."""
    table = traced.table.at_wavelength(traced.wavelength_m, radar.waveform.wavelength_m)
    within_reach = at("within reach", PathTable.within, table, radar)
    front_end = radar.front_end if settings.antenna_pattern else radar.front_end.with_boresight_gain()
    return at("illuminate", PathTable.illuminated, within_reach, front_end)


def narrowed(
    traced: TracedFrame, settings: ChainSettings, radar: Radar, at: Hook = plainly
) -> tuple[ChainSettings, PathTable]:
    """The settings with the effects of the signal that this frame calls for, and its illuminated paths, without those
    that the radar would not notice.

    Without a budget nothing is left out but the motion of what stands still.
    """
    notice, window = settings.notice(radar), settings.processing.truth_window
    limit_w = 0.0
    if notice is not None:
        table = traced.table.at_wavelength(traced.wavelength_m, radar.waveform.wavelength_m)
        decided = at("effects", Decided.of, table, notice)
        limit_w = decided.limit_w
        traced = replace(traced, table=decided.kept(traced.table))
    paths = illuminated(traced, settings, radar, at)
    moving = settings.processing.doppler and doppler_called_for(paths, radar, window, limit_w)
    return replace(settings, processing=replace(settings.processing, doppler=moving)), paths
