"""Which frame is frame i: its kind, scene, split, seed and pose.

This is the only place that says so. Rendering, tracing, stored paths, ``plan``, the error budget and its
check all ask a :class:`Deal`. Scene frames come first, close-target frames after them.

Frames may come in sequences, each along one track. A whole sequence belongs to one split and one scene: where single
frames are dealt by their index, sequences are dealt by theirs. Its frames share the ray lattice and the cycle of moving
parts, so that what stands still gives the same echoes in each, and what walks goes on walking; noise is each frame's
own.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from itertools import accumulate, groupby
from typing import Literal

from datafactory.defaults import DEFAULT_PATTERN
from datafactory.frame.draws import drawn_scene, frame_seed, generator, sequence_seed, split_of
from datafactory.frame.points import PointTargets
from datafactory.paths.merged_scene import MergedScene
from datafactory.scenes.boxes import BoxedThing, Movers
from datafactory.scenes.drives import CRUISING_SPEEDS, Drives, draw_drive
from datafactory.scenes.ground import Ground, sensor_ground
from datafactory.scenes.materials.table import MaterialMapping
from datafactory.scenes.poses import DRAWN_SPEEDS, Pose, Speeds, sample_pose
from datafactory.scenes.scene import Scene
from shared.dataset.folder import Split
from shared.dataset.locations import Location

SOLVER_SEEDS = 2**31
"""The solver takes seeds below 2**32; half of that fits every signed integer of its interface."""
Kind = Literal["scene", "points"]


@dataclass(frozen=True)
class PreparedScene:
    """What a trace needs of a scene.

    :param name: as the ``scene`` column has it
    :param content: hash of the scene
    :param merged: its meshes and targets as the ray tracer takes them
    :param things: what of it gets a box in each frame
    :param triangles: of its meshes
    """

    name: str
    content: str
    merged: MergedScene
    materials: MaterialMapping
    things: tuple[BoxedThing, ...] = ()
    triangles: int = 0


@dataclass(frozen=True)
class Rays:
    """What is random in one trace.

    :param offset: shift of the ray lattice in its unit square, see :class:`datafactory.paths.rays.RayFan`
    :param solver_seed: of the solver's choices between kinds of bounce
    """

    offset: tuple[float, float]
    solver_seed: int


@dataclass(frozen=True)
class StoredRow:
    """A frame whose paths were traced before: where they lie, and what their row says of the frame.

    :param row: of the shard
    :param scene: number of the scene among those of the trace
    :param sequence: number of the sequence that the frame belongs to; -1 for none
    """

    shard: Location
    row: int
    scene: int
    sequence: int


@dataclass(frozen=True)
class DealtFrame:
    """One frame of a run, before anything is simulated.

    :param frame_id: index in the dataset
    :param seed: the frame's own seed, as the ``seed`` column holds it
    :param scene: number of the scene among the run's; -1 of a point frame
    :param pose: of the radar, of a scene frame; None where its paths were traced before, whose row has it
    :param targets: of a point frame: exactly these, or None to draw close targets
    :param realisation: of the rays; 0 is the run's own, others are for measuring how far the rays matter
    :param stored: of a scene frame whose paths were traced before
    :param sequence: number of the sequence it belongs to; -1 of a frame of its own
    :param shared_seed: of what a sequence's frames have in common; None: the frame's own seed
    """

    frame_id: int
    kind: Kind
    split: Split
    seed: int
    scene: int = -1
    pose: Pose | None = None
    targets: PointTargets | None = None
    realisation: int = 0
    stored: StoredRow | None = None
    sequence: int = -1
    shared_seed: int | None = None

    @property
    def where(self) -> Pose:
        """The pose of a scene frame.

        :raises ValueError: a point frame has none
        """
        if self.pose is None:
            raise ValueError(f"frame {self.frame_id} is a {self.kind} frame; expected a scene frame, which has a pose")
        return self.pose

    @property
    def _scene_seed(self) -> int:
        return self.seed if self.shared_seed is None else self.shared_seed

    def rays(self) -> Rays:
        """What is random in the frame's trace."""
        seed = self._scene_seed if self.realisation == 0 else frame_seed(self._scene_seed, self.realisation)
        stream = generator(seed, "rays")
        offset = (float(stream.random()), float(stream.random()))
        return Rays(offset, int(stream.integers(SOLVER_SEEDS)))

    def target_seed(self) -> int:
        """Of where in their cycle the moving parts of targets are: of the frame, whatever its rays."""
        return int(generator(self._scene_seed, "targets").integers(SOLVER_SEEDS))

    def with_rays(self, realisation: int) -> DealtFrame:
        """The same frame with other rays."""
        return replace(self, realisation=realisation)


@dataclass(frozen=True, kw_only=True)
class Wanted:
    """Which frames a run is to have.

    :param seed: of the dataset
    :param split: pattern of the splits, see :func:`split_of`
    :param frames: drawn scene frames; of ``drives`` in all
    :param poses: one scene frame a pose, to the scenes in turn, instead of drawn ones
    :param tracks: sequences of scene frames, each at these poses, instead of drawn ones
    :param drives: draw sequences, of ``frames`` frames in all
    :param speed_mps: ends of the speed of drawn poses, or of the drives' cruising speed; None: each kind's own
    :param stored: every scene frame, where their paths were traced before; a row says which frame and scene it is, and
        is believed
    :param points: close-target frames after the scene frames
    :param targets: frames of exactly these targets, instead of drawn ones
    """

    seed: int = 0
    split: str = DEFAULT_PATTERN
    frames: int = 0
    poses: tuple[Pose, ...] = ()
    tracks: tuple[tuple[Pose, ...], ...] = ()
    drives: Drives | None = None
    speed_mps: Speeds | None = None
    stored: tuple[StoredRow, ...] = ()
    points: int = 0
    targets: tuple[PointTargets, ...] = ()

    @property
    def given(self) -> tuple[Pose, ...]:
        """Every pose that was given, of tracks one after the other; empty where they are drawn."""
        return self.poses or tuple(pose for track in self.tracks for pose in track)

    @cached_property
    def scene_frames(self) -> int:
        """Number of scene frames."""
        return len(self.stored) or len(self.given) or self.frames

    def __len__(self) -> int:
        return self.scene_frames + (len(self.targets) or self.points)


@dataclass(frozen=True, kw_only=True)
class Deal(Wanted):
    """What was wanted, dealt to scenes.

    :param scenes: number of scenes
    :param tracks: poses of every sequence, given or drawn
    :param track_scenes: number of the scene of every track
    :param grounds: where poses are drawn, one a scene; empty where they are given
    :param traffic: of every scene: in a populated one a drawn frame has a time of its own
    """

    scenes: int = 0
    track_scenes: tuple[int, ...] = ()
    grounds: tuple[Ground, ...] = field(default=(), repr=False)
    traffic: tuple[Movers, ...] = field(default=(), repr=False)

    @cached_property
    def _ends(self) -> tuple[int, ...]:
        """Frame index after the last of each track."""
        return tuple(accumulate(map(len, self.tracks)))

    def splits(self) -> tuple[Split, ...]:
        """Split of every frame."""
        return tuple(self.split_of(frame_id) for frame_id in range(len(self)))

    def sequence_of(self, frame_id: int) -> int:
        """Number of the sequence that a frame belongs to; -1 for a frame of its own."""
        if frame_id >= self.scene_frames:
            return -1
        if self.stored:
            return self.stored[frame_id].sequence
        return bisect_right(self._ends, frame_id) if self.tracks else -1

    @property
    def sequences(self) -> tuple[int, ...]:
        """How many frames each sequence has."""
        numbers = [self.sequence_of(frame_id) for frame_id in range(self.scene_frames)]
        return tuple(len(list(members)) for number, members in groupby(numbers) if number >= 0)

    def split_of(self, frame_id: int) -> Split:
        """Split of a frame: by the index of its sequence, or its own."""
        sequence = self.sequence_of(frame_id)
        return split_of(frame_id if sequence < 0 else sequence, self.split)

    def pose_of(self, frame_id: int) -> Pose | None:
        """The pose of a scene frame that was given or belongs to a track; None for one to be drawn by itself."""
        if self.tracks:
            sequence = self.sequence_of(frame_id)
            return self.tracks[sequence][frame_id - (self._ends[sequence - 1] if sequence else 0)]
        return self.poses[frame_id] if self.poses else None

    def scene_of(self, frame_id: int) -> int:
        """Number of the scene that a scene frame stands in."""
        if self.stored:
            return self.stored[frame_id].scene
        if self.tracks:
            return self.track_scenes[self.sequence_of(frame_id)]
        if self.poses:
            return frame_id % self.scenes
        return drawn_scene(frame_id, self.scenes, self.split)

    def frames_of(self, scene: int) -> tuple[int, ...]:
        """Frame indices of one scene, rising."""
        return tuple(frame_id for frame_id in range(self.scene_frames) if self.scene_of(frame_id) == scene)

    def place_of(self, frame_id: int) -> tuple[Split, int]:
        """Split of a frame, and its row among the split's frames."""
        split = self.split_of(frame_id)
        return split, sum(self.split_of(other) == split for other in range(frame_id))

    def frame(self, frame_id: int) -> DealtFrame:
        """Frame ``frame_id``.

        :raises InputError: no free ground for its pose
        """
        if not 0 <= frame_id < len(self):
            raise IndexError(f"frame {frame_id}; expected 0 to {len(self) - 1}")
        seed, split = frame_seed(self.seed, frame_id), self.split_of(frame_id)
        if frame_id >= self.scene_frames:
            targets = self.targets[frame_id - self.scene_frames] if self.targets else None
            return DealtFrame(frame_id, "points", split, seed, targets=targets)
        scene, pose = self.scene_of(frame_id), self.pose_of(frame_id)
        stored = self.stored[frame_id] if self.stored else None
        if pose is None and stored is None:
            stream = generator(seed, "pose")
            pose = sample_pose(self.grounds[scene], split, stream, self.speed_mps or DRAWN_SPEEDS)
            if self.traffic and self.traffic[scene].populated_s is not None:
                pose = self.traffic[scene].at_a_clear_time(pose, generator(seed, "traffic"))
        sequence = self.sequence_of(frame_id)
        shared = None if sequence < 0 else sequence_seed(self.seed, sequence)
        return DealtFrame(
            frame_id, "scene", split, seed, scene=scene, pose=pose, stored=stored, sequence=sequence, shared_seed=shared
        )


def dealt(wanted: Wanted, scenes: Sequence[Scene]) -> Deal:
    """What is wanted, dealt to scenes that were opened: what is to be drawn of tracks is drawn here.

    :raises InputError: no free ground, or no lane for a drive
    """
    grounds = () if wanted.given else tuple(sensor_ground(scene) for scene in scenes)
    traffic = tuple(map(Movers, scenes))
    tracks, numbers = wanted.tracks, [number % len(scenes) for number in range(len(wanted.tracks))]
    if wanted.drives is not None and wanted.frames:
        sequences = range(-(-wanted.frames // wanted.drives.frames))
        numbers = [drawn_scene(number, len(scenes), wanted.split) for number in sequences]
        drawn = []
        for number, scene in zip(sequences, numbers, strict=True):
            stream, speeds = generator(sequence_seed(wanted.seed, number), "pose"), wanted.speed_mps or CRUISING_SPEEDS
            split = split_of(number, wanted.split)
            drawn.append(draw_drive(grounds[scene], traffic[scene], split, wanted.drives, stream, speeds))
        over = len(drawn) * wanted.drives.frames - wanted.frames  # the last is cut where the frames end
        tracks = (*drawn[:-1], drawn[-1][: wanted.drives.frames - over])
    same = {item.name: getattr(wanted, item.name) for item in fields(Wanted)}
    several = {"scenes": len(scenes), "track_scenes": tuple(numbers), "grounds": grounds, "traffic": traffic}
    return Deal(**same | several | {"tracks": tracks, "frames": 0 if tracks else wanted.frames})
