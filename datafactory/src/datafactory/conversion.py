"""MCAP files for Foxglove (https://mcap.dev, https://docs.foxglove.dev/docs/sdk/schemas): one file for each split.

/tf        foxglove.FrameTransform    where the radar stands: from ``world`` to ``radar``
/truth     foxglove.CompressedImage   the truth over range (up) and u (to the left), PNG
/input     foxglove.CompressedImage   delay-and-sum of all channels, likewise
/targets   foxglove.PointCloud        x, y, z [m], velocity [m/s], amplitude_db; z = 0, as targets have no height
/boxes     foxglove.SceneUpdate       a box for each object that moves or has a class, with its name and class
"""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import foxglove
import numpy as np
from foxglove import channels, messages
from matplotlib import colormaps
from matplotlib.image import imsave
from numpy.typing import NDArray

from shared.dataset import Box, Frame
from shared.dataset.folder import Dataset
from shared.dataset.reading import radar_of
from shared.pictures import COLOUR_MAP, SPAN_DB, range_weighted_db
from shared.radar import Radar
from shared.signal.imaging import delay_and_sum

WORLD, RADAR = "world", "radar"
GAP_S = 1.0
"""Between two sequences, and two frames whose times do not rise, or stand far apart: those of drawn poses are all at
time 0, or at that of some traffic."""
COLOURS = {
    "car": (0.12, 0.47, 0.71),
    "truck": (0.58, 0.4, 0.74),
    "bus": (0.58, 0.4, 0.74),
    "pedestrian": (0.84, 0.15, 0.16),
    "bicycle": (1.0, 0.5, 0.05),
}
OTHER_COLOUR = (0.5, 0.5, 0.5)

POINT = np.dtype([(name, "<f4") for name in ("x", "y", "z", "velocity", "amplitude_db")])
NO_SOFTWARE: dict[str, Any] = {"Software": None}
"""Of a picture: the same frame gives the same bytes."""
COLUMNS = ("range_channel", "image", "targets", "boxes")


def write_mcap(dataset: Dataset, out: Path, progress: Callable[[int, int], None]) -> tuple[int, tuple[str, ...]]:
    """Write ``out/<split>.mcap`` for each split; returns the number of frames, and what is said of them."""
    radar = radar_of(dataset.description(), dataset.path)
    total, done = sum(len(dataset.rows(split)) for split in dataset.splits), 0
    progress(done, total)
    stepped = 0
    for split in dataset.splits:
        context = foxglove.Context()
        written = _Channels(context)
        options = foxglove.mcap.MCAPWriteOptions(compression_threads=0)  # the same bytes on every machine
        with foxglove.open_mcap(out / f"{split}.mcap", context=context, writer_options=options):
            clock = _Clock()
            for frame in dataset.frames(split, COLUMNS):
                written.log(frame, radar, clock.at(frame))
                done += 1
                progress(done, total)
            stepped += clock.stepped
    notes = [f"{stepped} frames follow the one before after {GAP_S:g} s, whatever their times"] if stepped else []
    return done, (*notes, "targets have no height: they stand at the radar's")


class _Clock:
    """Times that rise: a new sequence, or a frame whose time does not, follows the one before after :data:`GAP_S`; a
    frame of its own does so at the latest."""

    def __init__(self) -> None:
        self.stepped = 0
        self._offset, self._before = 0.0, -np.inf
        self._sequence = -1

    def at(self, frame: Frame) -> int:
        """The frame's time [ns] in the file; none is before 0."""
        time_s = frame.time if np.isfinite(frame.time) else 0.0
        after = time_s + self._offset - self._before
        longest = GAP_S if frame.sequence < 0 else np.inf
        if self._before == -np.inf:
            self._offset = max(0.0, -time_s)
        elif frame.sequence != self._sequence or not 0.0 < after <= longest:
            self._offset = self._before + GAP_S - time_s
            self.stepped += 1
        self._before, self._sequence = time_s + self._offset, frame.sequence
        return round(1e9 * self._before)


class _Channels:
    """The channels of one file."""

    def __init__(self, context: foxglove.Context) -> None:
        self._pose = channels.FrameTransformChannel("/tf", context=context)
        self._truth = channels.CompressedImageChannel("/truth", context=context)
        self._input = channels.CompressedImageChannel("/input", context=context)
        self._targets = channels.PointCloudChannel("/targets", context=context)
        self._boxes = channels.SceneUpdateChannel("/boxes", context=context)

    def log(self, frame: Frame, radar: Radar, time_ns: int) -> None:
        """Everything of one frame, at one time."""
        stamp = messages.Timestamp(*divmod(time_ns, 1_000_000_000))
        measured = np.abs(delay_and_sum(frame.range_channel[0], radar))
        self._pose.log(sensor_pose(frame, stamp), log_time=time_ns)
        self._truth.log(picture(frame.image * np.float32(frame.image_peak), stamp), log_time=time_ns)
        self._input.log(picture(measured, stamp), log_time=time_ns)
        self._targets.log(points(frame, stamp), log_time=time_ns)
        self._boxes.log(scene(frame, stamp), log_time=time_ns)


def sensor_pose(frame: Frame, stamp: messages.Timestamp) -> messages.FrameTransform:
    """From the world to the radar."""
    x, y, z = frame.sensor_position
    qw, qx, qy, qz = frame.sensor_orientation
    return messages.FrameTransform(
        timestamp=stamp, parent_frame_id=WORLD, child_frame_id=RADAR,
        translation=messages.Vector3(x=x, y=y, z=z), rotation=messages.Quaternion(x=qx, y=qy, z=qz, w=qw),
    )  # fmt: skip


def picture(magnitude: NDArray[np.floating], stamp: messages.Timestamp) -> messages.CompressedImage:
    """An image [R, U] in the colours and levels of the other pictures, 0 dB its maximum: far up, left on the left."""
    share = 1.0 + range_weighted_db(magnitude) / SPAN_DB
    buffer = io.BytesIO()
    colours = colormaps[COLOUR_MAP](share[::-1, ::-1], bytes=True)
    imsave(buffer, np.ascontiguousarray(colours), format="png", metadata=NO_SOFTWARE)
    return messages.CompressedImage(timestamp=stamp, frame_id=RADAR, data=buffer.getvalue(), format="png")


def points(frame: Frame, stamp: messages.Timestamp) -> messages.PointCloud:
    """The targets at the radar's height: x = r sqrt(1 - u^2), y = r u."""
    values = np.zeros(len(frame.targets), POINT)
    for row, target in zip(values, frame.targets, strict=True):
        across = target.range_m * target.u
        ahead = target.range_m * np.sqrt(max(0.0, 1.0 - target.u**2))
        row["x"], row["y"] = ahead, across
        row["velocity"], row["amplitude_db"] = target.velocity_mps, target.amplitude_db
    fields = [
        messages.PackedElementField(name=name, offset=4 * place, type=messages.PackedElementFieldNumericType.Float32)
        for place, name in enumerate(POINT.names or ())
    ]
    return messages.PointCloud(
        timestamp=stamp, frame_id=RADAR, pose=_pose(), point_stride=POINT.itemsize, fields=fields, data=values.tobytes()
    )


def scene(frame: Frame, stamp: messages.Timestamp) -> messages.SceneUpdate:
    """The boxes, in place of those of the frame before."""
    gone = messages.SceneEntityDeletion(timestamp=stamp, type=messages.SceneEntityDeletionType.All)
    return messages.SceneUpdate(deletions=[gone], entities=[_entity(box, stamp) for box in frame.boxes])


def _entity(box: Box, stamp: messages.Timestamp) -> messages.SceneEntity:
    red, green, blue = COLOURS.get(box.class_name, OTHER_COLOUR)
    length, width, height = box.size
    top = (box.center[0], box.center[1], box.center[2] + 0.5 * height + 0.3)
    return messages.SceneEntity(
        timestamp=stamp,
        frame_id=RADAR,
        id=box.object,
        cubes=[
            messages.CubePrimitive(
                pose=_pose(box.center, box.yaw),
                size=messages.Vector3(x=length, y=width, z=height),
                color=messages.Color(r=red, g=green, b=blue, a=0.4 if box.power > 0.0 else 0.1),
            )
        ],
        texts=[
            messages.TextPrimitive(
                pose=_pose(top), billboard=True, font_size=12.0, scale_invariant=True,
                color=messages.Color(r=red, g=green, b=blue, a=1.0), text=box.class_name,
            )
        ],
        metadata=list(_facts(box)),
    )  # fmt: skip


def _facts(box: Box) -> Iterator[messages.KeyValuePair]:
    vx, vy, vz = box.velocity
    yield messages.KeyValuePair(key="class", value=box.class_name)
    yield messages.KeyValuePair(key="object", value=box.object)
    yield messages.KeyValuePair(key="velocity relative to the radar [m/s]", value=f"{vx:.3f} {vy:.3f} {vz:.3f}")
    yield messages.KeyValuePair(key="power [W]", value=f"{box.power:.3e}")


def _pose(place: tuple[float, float, float] = (0.0, 0.0, 0.0), yaw: float = 0.0) -> messages.Pose:
    x, y, z = place
    turn = messages.Quaternion(x=0.0, y=0.0, z=float(np.sin(0.5 * yaw)), w=float(np.cos(0.5 * yaw)))
    return messages.Pose(position=messages.Vector3(x=x, y=y, z=z), orientation=turn)
