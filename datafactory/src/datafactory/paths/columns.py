"""Values of many things at once: in every array one row a thing."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from datafactory.paths.merged_scene import MergedScene
from datafactory.scenes.poses import Pose
from shared.physics.vectors import Index, Real, lengths, taken

WHOLE = {"kind": "whole"}
"""Metadata of a field that is about all things."""
POINT, DIRECTION, VELOCITY = {"kind": "point"}, {"kind": "direction"}, {"kind": "velocity"}
"""Of fields that turn with the frame of reference: places, vectors, velocities."""


@dataclass(frozen=True)
class Columns:
    """A base of dataclasses whose fields have a row for each thing; but for :data:`WHOLE`, which are about all."""

    def __len__(self) -> int:
        return len(getattr(self, _names(type(self))[0]))

    def take(self, index: NDArray) -> Self:
        """The things at these indices, or where a mask is true."""
        if index.dtype == np.bool_:
            if index.all():
                return self
            index = np.flatnonzero(index)
        elif len(index) == len(self) and np.array_equal(index, np.arange(len(index))):
            return self
        return replace(self, **{name: _rows(getattr(self, name), index) for name in _names(type(self))})

    @classmethod
    def joined(cls, parts: Sequence[Self], **whole: Any) -> Self:
        """The things of several, one after another; what is about all is that of the first, or as said here."""
        rows = {name: one_after_another([getattr(part, name) for part in parts]) for name in _names(cls)}
        return replace(parts[0], **rows, **whole)


@dataclass(frozen=True)
class Placed(Columns, ABC):
    """Things of a scene: in world coordinates at time 0 as they are found, in the radar's after :meth:`seen_from`.

    :param velocity: [n, 3] [m/s]
    :param shift: [n, 3] what is to be added to the points [m]: the displacement of a body that does not turn
    :param counts: what was found and left out, by name
    """

    velocity: Real = field(metadata=VELOCITY, kw_only=True)
    shift: Real = field(kw_only=True)
    counts: dict[str, int] = field(metadata=WHOLE, default_factory=dict, kw_only=True)

    @classmethod
    def of_bodies(cls, parts: Sequence[Self], **whole: Any) -> Self:
        """Those of several bodies, their counts added up."""
        names = dict.fromkeys(name for part in parts for name in part.counts)
        counts = {name: sum(part.counts.get(name, 0) for part in parts) for name in names}
        return cls.joined(parts, counts=counts, **whole)

    def moving_with(self, merged_scene: MergedScene, mesh: Index) -> Self:
        """The same things with the motions of meshes [n] of a merged scene at its time."""
        velocity = np.where(merged_scene.turned[mesh, None], self.velocity, merged_scene.velocities[mesh])
        return replace(self, velocity=velocity, shift=merged_scene.shifts[mesh])

    @abstractmethod
    def nearest(self) -> Real:
        """[n, 3] the point of each that lies nearest to the origin [m]."""

    def within(self, distance_m: float) -> Self:
        """Those of which a part lies nearer than this to the origin [m]: in the radar frame, those in range."""
        return self.take(lengths(self.nearest()) < distance_m)

    def seen_from(self, pose: Pose) -> Self:
        """The same things in the radar frame at the pose's time, velocities relative to the radar."""
        rotation, moved = pose.rotation(), self.shift - np.asarray(pose.position)
        away = {"point": moved, "direction": 0.0, "velocity": -np.asarray(pose.velocity)}
        turned = {
            item.name: (getattr(self, item.name) + away[item.metadata["kind"]]) @ rotation
            for item in fields(self)
            if item.metadata.get("kind") in away
        }
        return replace(self, **turned, shift=np.zeros_like(self.shift))


def apart(points: Real, distance: Real | float) -> Index:
    """Indices of points [n, d] that are not within ``distance``, [n] or one for all, of an earlier one."""
    if len(points) < 2:
        return np.arange(len(points))
    radius = np.broadcast_to(distance, len(points))
    pairs = cKDTree(points).query_pairs(float(radius.max()), output_type="ndarray")
    one, other = np.sort(pairs, axis=1).T
    close = np.linalg.norm(points[one] - points[other], axis=1) <= np.maximum(radius[one], radius[other])
    return np.setdiff1d(np.arange(len(points)), other[close])


def place_in_run(value: Index) -> Index:
    """[n] how many equal values stand before each of values [n], equal ones of which stand side by side."""
    begins = np.concatenate([[True], value[1:] != value[:-1]])[: len(value)]
    return np.arange(len(value)) - np.flatnonzero(begins)[np.cumsum(begins) - 1]


def pairs_in_runs(value: Index) -> tuple[Index, Index]:
    """Every one with every one, itself among them, of equal values, which rise: numbers of the first and the second."""
    first = np.searchsorted(value, value, side="left")
    one = np.repeat(np.arange(len(value)), np.searchsorted(value, value, side="right") - first)
    return one, first[one] + place_in_run(one)


def _names(kind: Any) -> tuple[str, ...]:
    """The fields that have a row for each thing."""
    return tuple(item.name for item in fields(kind) if item.metadata != WHOLE)


def one_after_another(parts: Sequence[Any]) -> Any:
    """The rows of several arrays, or of several :class:`Columns`; of one it is that one, no copy."""
    if len(parts) == 1:
        return parts[0]
    return np.concatenate(parts) if isinstance(parts[0], np.ndarray) else type(parts[0]).joined(parts)


def _rows(values: Any, index: NDArray) -> Any:
    return taken(values, index) if isinstance(values, np.ndarray) else values.take(index)
