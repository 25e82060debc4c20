"""Chains of transforms against USD's own evaluation, their rates against differences of their positions."""

from __future__ import annotations

import numpy as np
import pytest
from pxr import Gf, Usd, UsdGeom

from datafactory.scenes.chain import Chain, Operation, Samples
from datafactory.scenes.readers.common import Notes
from datafactory.scenes.readers.usd_motion import Frame, Transforms, columns
from datafactory.scenes.readers.usd_samples import Clock

CODES = (0.0, 3.0, 4.5, 20.0)  # non-uniform keys, 10 codes a second
STEP_S = 1e-6


def add_operation(xform: UsdGeom.Xform, kind: str, random: np.random.Generator, inverse: bool) -> None:
    """One operation with a random value at each of ``CODES``."""
    precision = UsdGeom.XformOp.PrecisionDouble
    if inverse:  # USD has an inverse of an operation that is there
        add_operation(xform, kind, random, False)
        first = xform.GetOrderedXformOps()[-1]
        xform.AddXformOp(first.GetOpType(), precision, first.GetOpName().split(":")[2], True)
        return
    suffix = f"n{len(xform.GetOrderedXformOps())}"
    op = getattr(xform, f"Add{kind[0].upper()}{kind[1:]}Op")(precision, suffix)
    for code in CODES:
        if kind == "transform":
            value = Gf.Matrix4d(
                *np.vstack([random.normal(size=(3, 4)) * [1, 1, 1, 0], [*random.normal(size=3), 1]]).ravel()
            )
        elif kind == "orient":
            value = Gf.Quatd(*random.normal(size=4)).GetNormalized()
        elif kind.startswith("rotate"):
            angles = random.uniform(-400.0, 400.0, 3)
            value = float(angles[0]) if len(kind) == 7 else Gf.Vec3d(*angles)
        else:
            value = Gf.Vec3d(*random.uniform(0.5, 2.0, 3))
        op.Set(value, code)


def moved_stage(kinds: list[str], random: np.random.Generator, inverse: bool = False) -> tuple[Usd.Stage, Usd.Prim]:
    """A stage with two animated prims in one another, and a prim at rest within them."""
    stage = Usd.Stage.CreateInMemory()
    stage.SetTimeCodesPerSecond(10)
    outer, inner = UsdGeom.Xform.Define(stage, "/outer"), UsdGeom.Xform.Define(stage, "/outer/inner")
    for kind in kinds:
        add_operation(outer, kind, random, inverse)
        add_operation(inner, kind, random, False)
    leaf = UsdGeom.Xform.Define(stage, "/outer/inner/leaf")
    leaf.AddTranslateOp().Set(Gf.Vec3d(3.0, -2.0, 1.0))
    return stage, leaf.GetPrim()


def chain_of(stage: Usd.Stage, prim: Usd.Prim) -> Chain:
    notes = Notes()
    transforms = Transforms(Clock.of(stage, notes), np.eye(4), notes)
    frame = Frame(stage.GetPseudoRoot(), "", np.eye(4), None, Usd.TraverseInstanceProxies())
    chain = transforms.chain(prim, frame)
    assert chain is not None
    return chain


KINDS = ["translate", "scale", "rotateX", "rotateY", "rotateZ", "orient", "transform"]
KINDS += ["rotateXYZ", "rotateXZY", "rotateYXZ", "rotateYZX", "rotateZXY", "rotateZYX"]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("inverse", [False, True])
def test_a_chain_is_what_usd_evaluates_and_its_rate_the_difference(kind: str, inverse: bool) -> None:
    random = np.random.default_rng(KINDS.index(kind))
    stage, prim = moved_stage(["translate", kind], random, inverse)
    chain = chain_of(stage, prim)
    for time in (-1.0, 0.0, 0.1, 0.3, 0.41, 0.45, 1.2, 1.9999, 2.0, 3.0):
        theirs = columns(UsdGeom.XformCache(Usd.TimeCode(10.0 * time)).GetLocalToWorldTransform(prim))
        ours, rate = chain.at(time)
        scale = np.abs(theirs).max()
        np.testing.assert_allclose(ours, theirs, atol=1e-9 * scale)
        # One sided, to the right, as the rate at a sample is that of the interval that begins there.
        one, two = (chain.at(time + steps * STEP_S)[0] for steps in (1, 2))
        np.testing.assert_allclose(rate, (4.0 * one - 3.0 * ours - two) / (2.0 * STEP_S), atol=1e-5 * scale)


def test_a_turn_of_many_rounds_between_two_samples_is_not_lost() -> None:
    wheel = Operation("rotate", Samples(np.array([0.0, 1.0]), np.array([[0.0], [3600.0]])), "X")
    assert wheel.turns
    _, rate = Chain((wheel,)).at(0.2)
    np.testing.assert_allclose(rate[1:3, 1:3], [[0.0, -20.0 * np.pi], [20.0 * np.pi, 0.0]], rtol=0, atol=1e-9)


def test_a_jump_has_no_rate() -> None:
    jump = Samples(np.array([0.0, 1.0, 1.0, 2.0]), np.array([[0.0], [0.0], [8.0], [9.0]]))
    assert [float(jump.at(time)[0][0]) for time in (0.5, 0.999, 1.0, 1.5)] == pytest.approx([0.0, 0.0, 8.0, 8.5])
    assert [float(jump.at(time)[1][0]) for time in (0.5, 1.0, 2.0, 5.0)] == pytest.approx([0.0, 1.0, 0.0, 0.0])


def test_constants_become_one_and_only_operations_move() -> None:
    moved = Operation("translate", Samples(np.array([0.0, 2.0]), np.array([[0.0, 0, 0], [4.0, 0, 0]])))
    chain = Chain().then(2.0 * np.eye(4), np.eye(4), moved, np.eye(4), np.eye(4))
    assert len(chain.factors) == 3
    assert chain.moves
    assert not chain.turns
    assert chain.times().tolist() == [0.0, 2.0]
    assert not Chain((np.eye(4), Operation("scale", Samples.constant([1.0, 2.0, 3.0])))).moves
