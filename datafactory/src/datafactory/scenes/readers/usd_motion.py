"""Positions and velocities of USD prims.

Positions are those at the USD stage's start. A velocity is the finite difference over the first time interval of the
animation, v = (M(t1) c - M(t0) c) / (t1 - t0) * timeCodesPerSecond, with c the mean of the object's vertices and M its
local-to-world transform. t0 and t1 are authored samples. USD interpolates linearly between them, so that v is exact for
a translation. Of an object that also turns, v is the velocity of c.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from datafactory.scenes.readers.usd_prims import whole_numbers
from datafactory.scenes.usd_library import Usd, UsdGeom

RESTING_SPEED = 1e-6  # USD stage units per second below which float64 transforms cannot tell motion from rounding


@dataclass(frozen=True)
class Frame:
    """The coordinates that a prim's transform refers to: the USD stage, or one instance of a point instancer.

    :param root: the prim whose subtree is placed; its own transform is within ``matrix_at``
    :param label: what replaces the root's parent in the names of objects
    :param matrix_at: time code to the [4, 4] matrix (column vectors) from the root's coordinates to the USD stage's
    :param sample_times: time codes at which that matrix has samples
    :param predicate: which prims below the root are visited
    """

    root: Usd.Prim
    label: str
    matrix_at: Callable[[float], NDArray[np.float64]]
    sample_times: tuple[float, ...]
    predicate: Usd._PrimFlagsPredicate

    def name(self, prim: Usd.Prim) -> str:
        """The prim's path, unique in the scene."""
        if self.root.IsPseudoRoot():
            return str(prim.GetPath())
        below = str(prim.GetPath())[len(str(self.root.GetPath())) :]
        return f"{self.label}/{self.root.GetName()}{below}"


class Transforms:
    """World transforms and velocities of a USD stage's prims, in USD stage units and axes."""

    def __init__(self, usd_stage: Usd.Stage) -> None:
        self._codes_per_second = float(usd_stage.GetTimeCodesPerSecond())
        self._caches: dict[float, UsdGeom.XformCache] = {}
        self._times: dict[str, frozenset[float]] = {}
        self.start = _start_time(usd_stage)

    def matrix(self, prim: Usd.Prim, frame: Frame, time: float | None = None) -> NDArray[np.float64]:
        """[4, 4] acting on column vectors, from the prim's coordinates to the USD stage's."""
        time = self.start if time is None else time
        cache = self._cache(time)
        if frame.root.IsPseudoRoot():
            return _columns(cache.GetLocalToWorldTransform(prim))
        relative, _ = cache.ComputeRelativeTransform(prim, frame.root)
        return product(frame.matrix_at(time), _columns(relative))

    def velocity(self, prim: Usd.Prim, frame: Frame, centre: NDArray[np.float64]) -> tuple[NDArray[np.float64], bool]:
        """World velocity [units of the USD stage / s] of a point of the prim, and whether the prim turns.

        :param centre: [3] the point in the prim's coordinates
        """
        interval = _first_interval(self.sample_times(prim, frame), self.start)
        if interval is None:
            return np.zeros(3), False
        before, after = (self.matrix(prim, frame, time) for time in interval)
        seconds = (interval[1] - interval[0]) / self._codes_per_second
        with np.errstate(over="ignore", invalid="ignore"):
            step = (after - before)[:3]
            velocity = (step[:, :3] @ centre + step[:, 3]) / seconds
            turns = not np.abs(step[:, :3]).max() <= 1e-9 * np.abs(before[:3, :3]).max()
            rests = np.linalg.norm(velocity) <= RESTING_SPEED  # false for NaN, which the caller refuses
        return np.where(rests, 0.0, velocity), turns

    def sample_times(self, prim: Usd.Prim, frame: Frame) -> tuple[float, ...]:
        """Time codes with a transform sample on the prim or above it, rising."""
        times = set(frame.sample_times)
        while prim != frame.root and not prim.IsPseudoRoot():
            path = str(prim.GetPath())
            if path not in self._times:
                xformable = UsdGeom.Xformable(prim)
                self._times[path] = frozenset(xformable.GetTimeSamples() if xformable else ())
            times |= self._times[path]
            prim = prim.GetParent()
        return tuple(sorted(times))

    def _cache(self, time: float) -> UsdGeom.XformCache:
        if time not in self._caches:
            self._caches[time] = UsdGeom.XformCache(Usd.TimeCode(time))
        return self._caches[time]


def instance_frames(
    instancer: UsdGeom.PointInstancer, frame: Frame, transforms: Transforms, predicate: Usd._PrimFlagsPredicate
) -> list[Frame]:
    """One frame for each visible instance, in the order of the instancer's arrays.

    :raises ValueError: the arrays contradict one another, or a prototype is missing
    """
    prim = instancer.GetPrim()
    start = Usd.TimeCode(transforms.start)
    prototypes = [prim.GetStage().GetPrimAtPath(path) for path in instancer.GetPrototypesRel().GetForwardedTargets()]
    chosen = whole_numbers(instancer.GetProtoIndicesAttr(), start)
    if not all(prototypes):
        raise ValueError("a target of 'prototypes' does not exist")
    if len(chosen) and not (chosen.min() >= 0 and chosen.max() < len(prototypes)):
        raise ValueError(f"protoIndices run from {chosen.min()} to {chosen.max()} with {len(prototypes)} prototypes")
    mask = instancer.ComputeMaskAtTime(start) or [True] * len(chosen)
    at_time: dict[float, tuple[NDArray[np.float64], NDArray[np.float64]]] = {}

    def placed(time: float, index: int) -> NDArray[np.float64]:
        if time not in at_time:
            code = Usd.TimeCode(time)
            matrices = instancer.ComputeInstanceTransformsAtTime(
                code, code, UsdGeom.PointInstancer.IncludeProtoXform, UsdGeom.PointInstancer.IgnoreMask
            )
            at_time[time] = transforms.matrix(prim, frame, time), np.array(matrices, dtype=np.float64)
        world, local = at_time[time]
        if index >= len(local):
            raise ValueError(f"{len(chosen)} protoIndices but {len(local)} instance transforms")
        return product(world, _columns(local[index]))

    if len(chosen):
        placed(transforms.start, len(chosen) - 1)  # arrays of unequal length are refused before any prim is read
    attributes = (instancer.GetPositionsAttr(), instancer.GetOrientationsAttr(), instancer.GetScalesAttr())
    times = {time for attribute in attributes for time in attribute.GetTimeSamples()}
    times.update(transforms.sample_times(prim, frame))
    of_prototype = [tuple(sorted(times.union(UsdGeom.Xformable(item).GetTimeSamples()))) for item in prototypes]
    name = frame.name(prim)
    return [
        Frame(
            prototypes[prototype], f"{name}[{index}]", partial(placed, index=index), of_prototype[prototype], predicate
        )
        for index, prototype in enumerate(chosen.tolist())
        if mask[index]
    ]


def _columns(matrix: object) -> NDArray[np.float64]:
    """[4, 4] acting on column vectors; USD's matrices act on row vectors. The projective part is dropped."""
    columns = np.array(matrix, dtype=np.float64).T
    columns[3] = (0.0, 0.0, 0.0, 1.0)
    return columns


def product(outer: NDArray[np.float64], inner: NDArray[np.float64]) -> NDArray[np.float64]:
    """The transform ``inner``, then ``outer``; what is infinite or NaN in them stays so."""
    with np.errstate(over="ignore", invalid="ignore"):
        product: NDArray[np.float64] = outer @ inner
    return product


def _first_interval(times: tuple[float, ...], start: float) -> tuple[float, float] | None:
    """The two samples around the start; the first two where the start lies before them."""
    if len(times) < 2 or start >= times[-1]:
        return None
    after = min(max(1, int(np.searchsorted(times, start, side="right"))), len(times) - 1)  # NaN sorts last
    return times[after - 1], times[after]


def _start_time(usd_stage: Usd.Stage) -> float:
    """The authored start, or else the first sample in any layer, or 0."""
    if usd_stage.HasAuthoredTimeCodeRange():
        return float(usd_stage.GetStartTimeCode())
    samples = [time for layer in usd_stage.GetUsedLayers() for time in layer.ListAllTimeSamples()]
    return min(samples, default=0.0)
