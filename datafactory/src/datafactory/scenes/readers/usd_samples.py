"""The time of a USD stage, the time samples of an attribute as arrays, and skinned meshes as meshes with samples.

A gap, USD's blocked sample, holds the value before it: USD itself has none there, and would put a prim at its parent.
Splines are taken as straight lines, ``LINES_A_SPAN`` from knot to knot.

``UsdSkel.BakeSkinning`` writes the points that a skeleton's animation makes of a mesh, as samples at the animation's
own times, into a layer of this session. From then on the mesh is one with moving points, straight from sample to
sample. Nothing can be written into a native instance: those with skeletons in them become plain prims first.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datafactory.scenes.chain import Samples
from datafactory.scenes.readers.common import MAXIMUM_NESTING, MAXIMUM_SAMPLED, Notes
from datafactory.scenes.readers.usd_stage import EVEN_UNDEFINED
from datafactory.scenes.usd_library import Gf, Usd, UsdGeom, UsdSkel

LINES_A_SPAN = 32
"""Lines that a curve between two knots of a spline is taken as: the rate's error is 1/64 of its change in between."""


@dataclass
class Clock:
    """Time codes to seconds since the scene's time 0.

    :param start: time code of time 0
    :param codes_per_second: time codes in a second
    :param end: last time code that the file states; None where it states none
    :param outside: animations seen so far that have samples outside of the stated range
    """

    start: float
    codes_per_second: float
    end: float | None = None
    outside: int = field(default=0, init=False)

    @staticmethod
    def of(usd_stage: Usd.Stage, notes: Notes) -> Clock:
        """The clock of a USD stage: its authored start, or else the first sample of any prim, or 0.

        A start after the end is said, and the earlier of the two is the start.
        """
        per_second = float(usd_stage.GetTimeCodesPerSecond())
        states_start, states_end = map(usd_stage.HasAuthoredMetadata, ("startTimeCode", "endTimeCode"))
        start = float(usd_stage.GetStartTimeCode()) if states_start else _first_sample(usd_stage)
        end = float(usd_stage.GetEndTimeCode()) if states_end else None
        if end is not None and start > end:
            notes.say(f"startTimeCode {start:g} lies after endTimeCode {end:g}: time 0 is that of {end:g}")
            start, end = end, start
        return Clock(start, per_second, end)

    def seconds(self, code: float) -> float:
        """Seconds since the start."""
        return (code - self.start) / self.codes_per_second

    def saw(self, times_s: list[float]) -> None:
        """Take note of an animation's samples."""
        end_s = np.inf if self.end is None else self.seconds(self.end)
        self.outside += int(times_s[0] < 0.0 or times_s[-1] > end_s)


def _first_sample(usd_stage: Usd.Stage) -> float:
    """The earliest time code at which any attribute has a sample, layers' offsets included; 0 without samples."""
    if not any(layer.ListAllTimeSamples() for layer in usd_stage.GetUsedLayers()):
        return 0.0
    ranges = [
        usd_stage.Traverse(EVEN_UNDEFINED),
        *(Usd.PrimRange(prototype) for prototype in usd_stage.GetPrototypes()),
    ]
    attributes = (item for prims in ranges for prim in prims for item in prim.GetAuthoredAttributes())
    samples = (time for item in attributes if item.ValueMightBeTimeVarying() for time in item.GetTimeSamples())
    return min((time for time in samples if np.isfinite(time)), default=0.0)


def attribute_samples(attribute: Usd.Attribute, clock: Clock, notes: Notes) -> Samples | None:
    """All samples of an attribute as numbers, at seconds since the start; None without any that can be used.

    :return: values [K, ...] of the attribute's own shape, quaternions as w, x, y, z
    """
    if attribute.HasSpline() and not attribute.GetTimeSamples():
        return _of_spline(attribute.GetSpline(), clock, notes)
    codes = [code for code in attribute.GetTimeSamples() if np.isfinite(code)]
    times: list[float] = []
    values: list[NDArray[np.floating]] = []
    gap = False
    for code in codes:
        value = numbers_of(attribute.Get(Usd.TimeCode(code)))
        if value is None:
            gap = True
            notes.count("# gaps in animations (samples without a value) hold the value before them")
            continue
        if gap and values:  # held through the gap, then another value
            times.append(clock.seconds(code))
            values.append(values[-1])
        gap = False
        times.append(clock.seconds(code))
        values.append(value)
    if not values:
        return None
    if any(value.shape != values[0].shape for value in values):
        notes.count("# animated attributes change their size: taken as they are at the start")
        return None
    clock.saw(times)
    return Samples(np.array(times), np.stack(values))


def _of_spline(spline: Any, clock: Clock, notes: Notes) -> Samples | None:
    """A spline's knots, and straight lines between them."""
    knots = [float(time) for time in spline.GetKnots()]
    if not knots:
        return None
    notes.count(f"# animation splines taken as {LINES_A_SPAN} lines from knot to knot, held outside of them")
    codes, values = [knots[0]], [float(spline.Eval(knots[0]))]
    for low, high in pairwise(knots):
        for code in np.linspace(low, high, LINES_A_SPAN + 1)[1:-1]:
            codes.append(float(code))
            values.append(float(spline.Eval(float(code))))
        codes += [high, high]
        values += [float(spline.EvalPreValue(high)), float(spline.Eval(high))]
    times = [clock.seconds(code) for code in codes]
    clock.saw(times)
    return Samples(np.array(times), np.array(values)[:, None])


def numbers_of(value: Any) -> NDArray[np.floating] | None:
    """A value as an array [n] of float64, or [P, n] as it is; a quaternion as w, x, y, z; None without numbers."""
    if value is None or isinstance(value, str | bool):
        return None
    if isinstance(value, Gf.Quatd | Gf.Quatf | Gf.Quath):
        return np.array([value.GetReal(), *value.GetImaginary()], dtype=np.float64)
    try:
        found = np.array(value)
    except (TypeError, ValueError):
        return None
    if found.dtype.kind not in "fiu":
        return None
    return found if found.ndim > 1 else found.reshape(-1).astype(np.float64)


def point_track(mesh: UsdGeom.Mesh, count: int, clock: Clock, notes: Notes) -> Samples | None:
    """The samples of a mesh's points [K, P, 3]; None where they do not move, or not in a way that can be used.

    :param count: P, at the start
    """
    points = mesh.GetPointsAttr()
    if not points.ValueMightBeTimeVarying():
        return None
    if any(
        item.ValueMightBeTimeVarying() for item in (mesh.GetFaceVertexCountsAttr(), mesh.GetFaceVertexIndicesAttr())
    ):
        notes.count("# meshes change their faces: taken as they are at the start")
        return None
    if points.GetNumTimeSamples() * count * 3 > MAXIMUM_SAMPLED:
        notes.count(f"# meshes with more than {MAXIMUM_SAMPLED} sampled coordinates taken as they are at the start")
        return None
    samples = attribute_samples(points, clock, notes)
    if samples is None or samples.values.shape[1:] != (count, 3) or not samples.varies:
        return None
    if not np.isfinite(samples.values).all():
        notes.count("# meshes with moving points that are not numbers taken as they are at the start")
        return None
    return samples


def bake_skinning(usd_stage: Usd.Stage, notes: Notes) -> None:
    """Bake the skinned meshes of a USD stage, as many as ``MAXIMUM_SAMPLED`` coordinates hold; the rest is said."""
    usd_stage.SetEditTarget(Usd.EditTarget(usd_stage.GetSessionLayer()))
    for _ in range(MAXIMUM_NESTING):  # instances within instances come to light one level at a time
        instances = _instances_with_skeletons(usd_stage)
        if not instances:
            break
        for prim in instances:
            prim.SetInstanceable(False)
    total = 0
    for prim in [item for item in usd_stage.Traverse() if item.IsA(UsdSkel.Root)]:
        size = _sampled(prim)
        if total + size > MAXIMUM_SAMPLED:
            notes.count(f"# skeletons left in their rest pose: only {MAXIMUM_SAMPLED} coordinates may be sampled")
            continue
        total += size
        UsdSkel.BakeSkinning(UsdSkel.Root(prim), Gf.Interval.GetFullInterval())


def is_baked(mesh: UsdGeom.Mesh) -> bool:
    """Whether a mesh's points come from :func:`bake_skinning`."""
    session = mesh.GetPrim().GetStage().GetSessionLayer()
    return any(spec.layer == session for spec in mesh.GetPointsAttr().GetPropertyStack(Usd.TimeCode.Default()))


def _instances_with_skeletons(usd_stage: Usd.Stage) -> list[Usd.Prim]:
    """The native instances, within no other, that have a skeleton in them."""
    found = []
    for prototype in usd_stage.GetPrototypes():
        within = any(prim.IsA(UsdSkel.Root) for prim in Usd.PrimRange(prototype))
        # The root of a prototype has no type: it may be the skeleton's root in each instance.
        instances = [prim for prim in prototype.GetInstances() if within or prim.IsA(UsdSkel.Root)]
        found += [prim for prim in instances if not prim.IsInPrototype()]
    return found


def _sampled(root: Usd.Prim) -> int:
    """Coordinates that baking will write, at most: samples of all animations times points of all meshes."""
    samples = points = 0
    for prim in Usd.PrimRange(root):
        if prim.IsA(UsdSkel.Animation):
            animation = UsdSkel.Animation(prim)
            attributes = (animation.GetTranslationsAttr(), animation.GetRotationsAttr(), animation.GetScalesAttr())
            samples = max(samples, *(attribute.GetNumTimeSamples() for attribute in attributes))
        elif prim.IsA(UsdGeom.Mesh):
            values = UsdGeom.Mesh(prim).GetPointsAttr().Get(Usd.TimeCode.EarliestTime())
            points += len(values) if values is not None else 0
    return 3 * samples * points
