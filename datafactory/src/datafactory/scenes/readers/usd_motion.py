"""How USD prims move: chains of transforms with the samples that the file holds.

A prim without samples above it has one matrix, USD's own. Of any other, the operations of its ancestors' transforms are
read with all their samples (:mod:`datafactory.scenes.chain`), instancers' positions, orientations and scales among
them. Time 0 is the USD stage's start, and seconds are time codes over timeCodesPerSecond.

"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from datafactory.scenes.chain import Chain, Factor, Operation, Samples
from datafactory.scenes.motion import Motion, Moving, Track, looked_at
from datafactory.scenes.readers.common import Notes
from datafactory.scenes.readers.usd_prims import whole_numbers
from datafactory.scenes.readers.usd_samples import Clock, attribute_samples, numbers_of
from datafactory.scenes.usd_library import Sdf, Usd, UsdGeom
from shared.physics.errors import InputError
from shared.physics.units import FARTHEST_M, FASTEST_MPS


@dataclass(frozen=True)
class Frame:
    """The coordinates that a prim's transform refers to: the USD stage, or one instance of a point instancer.

    :param root: the prim whose subtree is placed; its own transform is within ``matrix``
    :param label: what replaces the root's parent in the names of objects
    :param matrix: [4, 4] (column vectors) from the root's coordinates to the USD stage's, at time 0
    :param chain: the same for all times; None where it does not move
    :param predicate: which prims below the root are visited
    """

    root: Usd.Prim
    label: str
    matrix: NDArray[np.float64]
    chain: Chain | None
    predicate: Usd._PrimFlagsPredicate

    def name(self, prim: Usd.Prim) -> str:
        """The prim's path, unique in the scene."""
        if self.root.IsPseudoRoot():
            return str(prim.GetPath())
        below = str(prim.GetPath())[len(str(self.root.GetPath())) :]
        return f"{self.label}/{self.root.GetName()}{below}"


@dataclass
class Transforms:
    """World transforms of a USD stage's prims, in USD stage units and axes.

    :param to_world: [4, 4] from there to metres and z up, for motions
    """

    clock: Clock
    to_world: NDArray[np.float64]
    notes: Notes
    _factors: dict[Sdf.Path, tuple[Factor, ...]] = field(default_factory=dict)
    _tracks: dict[str, Track | None] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._cache = UsdGeom.XformCache(Usd.TimeCode(self.clock.start))

    def matrix(self, prim: Usd.Prim, frame: Frame) -> NDArray[np.float64]:
        """[4, 4] acting on column vectors, from the prim's coordinates to the USD stage's, at time 0."""
        chain = self.chain(prim, frame)
        return self.rest(prim, frame) if chain is None else chain.at(0.0)[0]

    def rest(self, prim: Usd.Prim, frame: Frame) -> NDArray[np.float64]:
        """The same of a prim that does not move."""
        if frame.root.IsPseudoRoot():
            return columns(self._cache.GetLocalToWorldTransform(prim))
        relative, _ = self._cache.ComputeRelativeTransform(prim, frame.root)
        return frame.matrix @ columns(relative)

    def chain(self, prim: Usd.Prim, frame: Frame) -> Chain | None:
        """From the prim's coordinates to the USD stage's, at all times; None where it does not move."""
        way: list[Usd.Prim] = []
        moves = resets = False
        while prim != frame.root and not prim.IsPseudoRoot() and not resets:
            way.append(prim)
            moves |= self.moves(prim)
            resets = bool(UsdGeom.Xformable(prim)) and UsdGeom.Xformable(prim).GetResetXformStack()
            prim = prim.GetParent()
        outer = None if resets else frame.chain
        if outer is None and not moves:
            return None
        start = outer or (Chain() if resets else Chain((frame.matrix,)))
        return start.then(*(factor for item in reversed(way) for factor in self.factors(item)))

    def motion(self, prim: Usd.Prim, frame: Frame, chain: Chain | None) -> Motion | None:
        """How the prim moves in the world; None where it rests.

        :param chain: the prim's own
        """
        if chain is None:
            return None
        world = Chain((self.to_world,)).then(*chain.factors)
        # Prims that move alike are one body: what stands below the last operation does not change the motion.
        last = max((n for n, factor in enumerate(world.factors) if isinstance(factor, Operation)), default=-1)
        moving = Chain(world.factors[: last + 1])
        if not moving.moves:
            return None
        body = self._body(prim, frame)
        if moving.turns:
            return Moving(body, world)
        if body not in self._tracks:
            self._tracks[body] = Track.of(moving)
        return self._tracks[body]

    def factors(self, prim: Usd.Prim) -> tuple[Factor, ...]:
        """The prim's own transform, outermost first."""
        path = source_path(prim)  # one for all instances of a prototype
        if path not in self._factors:
            found: tuple[Factor, ...] = ()
            xformable = UsdGeom.Xformable(prim)
            if xformable and xformable.TransformMightBeTimeVarying():
                found = tuple(self._operation(op) for op in xformable.GetOrderedXformOps())
            # Samples that do not differ are those of a prim at rest.
            if xformable and not any(isinstance(factor, Operation) for factor in found):
                found = (columns(self._cache.GetLocalTransformation(prim)[0]),)
            self._factors[path] = found
        return self._factors[path]

    def moves(self, prim: Usd.Prim) -> bool:
        """Whether the prim's own transform has samples that differ."""
        return any(isinstance(factor, Operation) for factor in self.factors(prim))

    def _body(self, prim: Usd.Prim, frame: Frame) -> str:
        """Name of the innermost prim with samples above the prim, itself included."""
        while prim != frame.root and not prim.IsPseudoRoot():
            if self.moves(prim):
                return frame.name(prim)
            prim = prim.GetParent()
        return f"{frame.label}/{frame.root.GetName()}"

    def _operation(self, op: UsdGeom.XformOp) -> Factor:
        """One operation of a transform: a matrix where it has no samples."""
        samples = attribute_samples(op.GetAttr(), self.clock, self.notes)
        if samples is None or not samples.varies:
            return columns(op.GetOpTransform(Usd.TimeCode(self.clock.start)))
        kind = op.GetOpName().split("xformOp:", 1)[1].split(":")[0]
        values = samples.values
        size = 1 if kind in _ALONG else _SIZES.get(kind, 3)
        if values[0].size != size:  # USD would not have it either
            return columns(op.GetOpTransform(Usd.TimeCode(self.clock.start)))
        if kind in _ALONG:  # one coordinate of a translation or a scale
            whole, axis = _ALONG[kind]
            rest = np.full((len(values), 3), 1.0 if whole == "scale" else 0.0)
            rest[:, axis] = values.reshape(len(values))
            return Operation(whole, Samples(samples.times, rest), inverse=op.IsInverseOp())
        if kind == "transform":
            turned = np.swapaxes(values.reshape(-1, 4, 4), 1, 2).copy()  # USD's matrices act on row vectors
            turned[:, 3] = (0.0, 0.0, 0.0, 1.0)
            return Operation("matrix", Samples(samples.times, turned.reshape(-1, 16)), inverse=op.IsInverseOp())
        if kind.startswith("rotate"):
            axes, angles = kind.removeprefix("rotate"), values.reshape(len(values), -1)
            if len(axes) == 3:  # the value's components stand for x, y and z, whatever the order
                angles = angles[:, ["XYZ".index(axis) for axis in axes]]
            return Operation("rotate", Samples(samples.times, angles), axes, op.IsInverseOp())
        return Operation(kind, samples, inverse=op.IsInverseOp())


_ALONG = {f"{whole}{axis}": (whole, n) for whole in ("translate", "scale") for n, axis in enumerate("XYZ")}
_SIZES = {"rotateX": 1, "rotateY": 1, "rotateZ": 1, "orient": 4, "transform": 16}
"""Numbers in a value of an operation, where they are not three."""


def instance_frames(
    instancer: UsdGeom.PointInstancer, frame: Frame, transforms: Transforms, predicate: Usd._PrimFlagsPredicate
) -> list[tuple[Frame, int]]:
    """One frame for each visible instance, in the order of the instancer's arrays, and how many have its prototype.

    :raises ValueError: the arrays contradict one another, or a prototype is missing
    """
    prim = instancer.GetPrim()
    start = Usd.TimeCode(transforms.clock.start)
    prototypes = [prim.GetStage().GetPrimAtPath(path) for path in instancer.GetPrototypesRel().GetForwardedTargets()]
    chosen = whole_numbers(instancer.GetProtoIndicesAttr(), start)
    if not all(prototypes):
        raise ValueError("a target of 'prototypes' does not exist")
    if not len(chosen):
        return []
    if not (chosen.min() >= 0 and chosen.max() < len(prototypes)):
        raise ValueError(f"protoIndices run from {chosen.min()} to {chosen.max()} with {len(prototypes)} prototypes")
    shown = np.flatnonzero(instancer.ComputeMaskAtTime(start) or [True] * len(chosen)).tolist()
    local = np.array(
        instancer.ComputeInstanceTransformsAtTime(
            start, start, UsdGeom.PointInstancer.IncludeProtoXform, UsdGeom.PointInstancer.IgnoreMask
        ),
        dtype=np.float64,
    )
    if len(local) < len(chosen):
        raise ValueError(f"{len(chosen)} protoIndices but {len(local)} instance transforms")
    world = transforms.matrix(prim, frame)
    chain_of = _instance_chains(instancer, frame, transforms, prototypes, len(chosen))
    name = frame.name(prim)
    repeats = Counter(chosen[shown].tolist())
    frames = []
    for index in shown:
        prototype = int(chosen[index])
        chain = chain_of(index, prototype)
        matrix = world @ columns(local[index]) if chain is None else chain.at(0.0)[0]
        frame = Frame(prototypes[prototype], f"{name}[{index}]", matrix, chain, predicate)
        frames.append((frame, repeats[prototype]))
    return frames


def note_instancer(instancer: UsdGeom.PointInstancer, start: Usd.TimeCode, notes: Notes) -> None:
    """Count what a point instancer states of its motion and is not used."""
    for rate, samples in (("velocities", "positions"), ("angularVelocities", "orientations")):
        stated = instancer.GetPrim().GetAttribute(rate).HasAuthoredValue()
        notes.count(f"# point instancers have '{rate}', which are not used ({samples}' samples are)", stated)
    chosen = instancer.GetProtoIndicesAttr(), instancer.GetIdsAttr(), instancer.GetInvisibleIdsAttr()
    changes = any(
        not np.array_equal(whole_numbers(attribute, Usd.TimeCode(code)), whole_numbers(attribute, start))
        for attribute in chosen
        for code in attribute.GetTimeSamples()
    )
    notes.count("# point instancers change which instances they have: taken as at the start", changes)


def _instance_chains(
    instancer: UsdGeom.PointInstancer, frame: Frame, transforms: Transforms, prototypes: list[Usd.Prim], count: int
) -> Callable[[int, int], Chain | None]:
    """The chain of an instance, by its index and its prototype's; None where it does not move."""
    prim = instancer.GetPrim()
    outer = transforms.chain(prim, frame)
    turning = [transforms.moves(item) for item in prototypes]
    arrays: list[tuple[str, Samples]] = []
    start = Usd.TimeCode(transforms.clock.start)
    orientations = instancer.GetOrientationsfAttr()  # finer, and counts more
    if not orientations.HasAuthoredValue():
        orientations = instancer.GetOrientationsAttr()
    moves = False
    for kind, attribute in (
        ("translate", instancer.GetPositionsAttr()), ("orient", orientations), ("scale", instancer.GetScalesAttr())
    ):  # fmt: skip
        samples = None
        if attribute.ValueMightBeTimeVarying():
            samples = attribute_samples(attribute, transforms.clock, transforms.notes)
        if samples is None:
            value = numbers_of(attribute.Get(start))
            samples = None if value is None else Samples(np.zeros(1), np.asarray(value, dtype=np.float64)[None])
        else:
            moves |= samples.varies
        if samples is None or samples.values.ndim != 3 or samples.values.shape[1] < count:
            continue
        if kind == "orient":  # NumPy has USD's quaternions as x, y, z, w
            samples = Samples(samples.times, samples.values[..., [3, 0, 1, 2]])
        arrays.append((kind, samples))

    def chain(index: int, prototype: int) -> Chain | None:
        if outer is None and not moves and not turning[prototype]:
            return None
        start_at = outer or Chain((transforms.matrix(prim, frame),))
        steps = [Operation(kind, Samples(samples.times, samples.values[:, index])) for kind, samples in arrays]
        return start_at.then(*steps, *transforms.factors(prototypes[prototype]))

    return chain


def source_path(prim: Usd.Prim) -> Sdf.Path:
    """The path under which a prim's values are kept: within an instance, that of the prototype's prim."""
    return (prim.GetPrimInPrototype() if prim.IsInstanceProxy() else prim).GetPath()


def columns(matrix: object) -> NDArray[np.float64]:
    """[4, 4] acting on column vectors; USD's matrices act on row vectors. The projective part is dropped."""
    found = np.array(matrix, dtype=np.float64).T
    found[3] = (0.0, 0.0, 0.0, 1.0)
    return found


def check_motion(source: object, name: str, motion: Motion, points: NDArray[np.floating] = np.zeros((1, 3))) -> None:
    """Refuse a motion that leaves every map or is faster than anything.

    :param points: [P, 3] some of what moves, in its own coordinates
    :raises InputError: naming what moves, where to or how fast
    """
    if isinstance(motion, Track):
        places, velocities = np.array(motion.places), np.array(motion.velocities)
    else:
        instants = [motion.at(points, np.arange(len(points)), time) for time in looked_at(motion)]
        places = np.concatenate([item.vertices for item in instants])
        velocities = np.concatenate([item.velocities for item in instants])
    for values, limit, verb, unit in (
        (velocities, FASTEST_MPS, "moves at", "m/s"),
        (places, FARTHEST_M, "gets to", "m"),
    ):
        bad = np.flatnonzero(~(np.abs(values) <= limit).all(axis=1))  # NaN is not within
        if len(bad):
            x, y, z = (float(value) for value in values[bad[0]])
            raise InputError(source, f"{name} {verb} ({x}, {y}, {z}) {unit}", f"at most {limit:g} {unit}")
