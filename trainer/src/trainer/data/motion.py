"""The sensor's own velocity: told beside a cube (docs/points.md), or estimated from what a frame shows."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, cast

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, FiniteFloat, ValidationError

from shared.physics.errors import InputError
from shared.radar import Radar, first_validation_error
from shared.radar.validation import Described
from shared.signal.ego_motion import EgoMotion, StaticWorld, estimated_motion
from trainer.estimators.array import LineArray, uniform_axis

SUFFIX = ".motion.json"
POINTS_PER_CELL = 8
CLEAR_DB = 20.0
"""Of a cell's strongest angle over the noise there: its angle is then right to a tenth of a resolution cell."""
MOST_DETECTIONS = 400
"""The strongest, relative to the noise, that are asked for the velocity."""

Velocity = tuple[FiniteFloat, FiniteFloat]


class MotionFile(Described):
    """``NAME.motion.json`` beside ``NAME.npz`` or ``NAME.npy``.

    :param velocity: of the vehicle at the radar, forward and to the left [m/s]: of all frames, or of each
    :param mounting_yaw_deg: by how much the radar is turned to the left on it
    """

    velocity: Velocity | Annotated[tuple[Velocity, ...], Field(min_length=1)]
    mounting_yaw_deg: Annotated[FiniteFloat, Field(ge=-360, le=360)] = 0.0

    def motions(self, frames: int) -> list[EgoMotion] | None:
        """The motion of each of so many frames; None where the file has another number."""
        several = [one for one in self.velocity if isinstance(one, tuple)]
        each = several or [cast("Velocity", self.velocity)] * frames
        yaw = math.radians(self.mounting_yaw_deg)
        return [EgoMotion.of_vehicle(*one, yaw) for one in each] if len(each) == frames else None


def read_motion(cube: Path, frames: int) -> list[EgoMotion] | None:
    """The sensor's motion in each frame of a cube, of the file beside it; None where there is none.

    :raises InputError: a damaged file, or of another number of frames
    """
    path = cube.with_suffix(SUFFIX)
    if not path.is_file():
        return None
    try:
        content = MotionFile.model_validate(json.loads(path.read_text("utf-8")))
    except ValidationError as error:
        raise InputError(path, *first_validation_error(error, keys=MotionFile.model_fields)) from error
    except (ValueError, RecursionError, OSError) as error:
        raise InputError(path, f"not JSON: {error}", 'e.g. {"velocity": [8.3, 0.0]}') from error
    if (motions := content.motions(frames)) is None:
        raise InputError(path, f"{len(content.velocity)} velocities", f"one, or one for each of {frames} frames")
    return motions


def known_world(frame: Mapping[str, Any], radar: Radar) -> StaticWorld:
    """What the sensor's motion says of the rows [R] of a frame of a dataset at their strongest Doppler peaks.

    :param frame: its arrays or tensors by name, the velocity among them
    """
    velocity, orientation = (np.asarray(frame[f"sensor_{name}"]).tolist() for name in ("velocity", "orientation"))
    return StaticWorld(EgoMotion.of_pose(velocity, orientation), np.asarray(frame["velocity"][0]), radar)


def seen_motion(
    cells: NDArray[np.complexfloating],
    velocity_mps: NDArray[np.floating],
    line: LineArray,
    radar: Radar,
    noise_power: float,
    seed: int,
) -> EgoMotion | None:
    """The velocity that range-Doppler cells agree on, see :func:`shared.signal.ego_motion.estimated_motion`.

    Each cell stands for one detection, at the strongest angle of delay-and-sum.

    :param cells: [N, C] channels of ``line`` [sqrt(W)], no cell twice
    :param velocity_mps: [N] of their Doppler
    :param noise_power: of one channel and cell [W]
    """
    axis = uniform_axis(line, POINTS_PER_CELL)
    magnitude = np.abs(np.asarray(cells, dtype=np.complex128) @ line.manifold(axis).conj()) / line.channels
    level = magnitude.max(axis=1)
    clear = np.flatnonzero(level > math.sqrt(10.0 ** (CLEAR_DB / 10.0) * noise_power / line.channels))
    strongest = clear[np.argsort(-level[clear], kind="stable")[:MOST_DETECTIONS]]
    u, velocity = axis[magnitude[strongest].argmax(axis=1)], np.asarray(velocity_mps, dtype=np.float64)[strongest]
    return estimated_motion(u, velocity, radar, seed)
