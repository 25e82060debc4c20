"""Motion of USD prims: animations, instances, attributes; chains of transforms against USD's own evaluation."""

from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Usd, UsdGeom
from usd_files import CUBE, METRES_Z_UP, MOVING, SPLINE, cube, ops, read, write_usda

from datafactory.scenes.chain import Chain, Operation, Samples
from datafactory.scenes.motion import Moving
from datafactory.scenes.readers.common import Notes
from datafactory.scenes.readers.usd import read_usd
from datafactory.scenes.readers.usd_motion import Frame, Transforms, columns
from datafactory.scenes.readers.usd_samples import Clock


def test_velocity_is_the_first_interval_in_world_metres_per_second(tmp_path: Path) -> None:
    # 600 cm in 12 frames at 24 a second along the stage's z, which is -y with y up turned to z up.
    metadata = 'metersPerUnit = 0.01\n upAxis = "Y"\n timeCodesPerSecond = 24\n startTimeCode = 0\n endTimeCode = 24'
    car, house = read(tmp_path, MOVING, metadata).objects
    assert car.velocity == pytest.approx((0, -12.0, 0), abs=1e-9)
    assert not house.moves
    np.testing.assert_allclose(car.vertices.mean(axis=0), 0, atol=1e-12)


def test_a_start_within_the_animation_takes_its_interval_and_place(tmp_path: Path) -> None:
    metadata = f"{METRES_Z_UP}\n timeCodesPerSecond = 24\n startTimeCode = 18\n endTimeCode = 24"
    car = read(tmp_path, MOVING, metadata).objects[0]
    assert car.velocity == pytest.approx((0, 0, -1200.0))
    np.testing.assert_allclose(car.vertices.mean(axis=0), [0, 0, 300], atol=1e-9)


def test_a_start_without_an_end_is_the_start(tmp_path: Path) -> None:
    """Before the first sample, at code 12, a prim rests; 0.5 s later it has come to 300 m in another half second."""
    body = MOVING.replace("{ 0: (0, 0, 0), 12", "{ 12: (0, 0, 0), 24").replace("24: (0, 0, 0)", "36: (0, 0, 0)")
    car = read(tmp_path, body, f"{METRES_Z_UP}\n timeCodesPerSecond = 24\n startTimeCode = 0").objects[0]
    for time_s, height in ((0.0, 0.0), (0.5, 0.0), (0.75, 300.0)):
        np.testing.assert_allclose(car.at(time_s).vertices.mean(axis=0), [0, 0, height], atol=1e-9)


@pytest.mark.parametrize("offset", [100, -100])
def test_without_a_start_the_first_sample_is_that_of_the_composed_stage(tmp_path: Path, offset: int) -> None:
    """A reference shifts the samples of its layer: the asset moves from time 0 on, as by itself."""
    write_usda(tmp_path, MOVING, f'{METRES_Z_UP}\n defaultPrim = "car"', "asset.usda")
    (car,) = read(tmp_path, f'def Xform "R" ( references = @./asset.usda@ (offset = {offset}) ) {{}}').objects
    np.testing.assert_allclose(car.at(0.25).vertices.mean(axis=0), [0, 0, 300], atol=1e-9)


@pytest.mark.parametrize("specifier", ["def", "over", "class"])
def test_without_a_start_the_first_sample_may_be_that_of_a_prototype(tmp_path: Path, specifier: str) -> None:
    body = f"""def PointInstancer "wheels" {{
      point3f[] positions = [(9, 0, 0)]
      int[] protoIndices = [0]
      rel prototypes = </wheels/wheel>
      {specifier} Sphere "wheel" {{
        {ops(translate={100: (0, 0, 0), 124: (0, 0, 6)})}
      }}
    }}"""
    (wheel,) = read(tmp_path, body).objects
    assert wheel.velocity == pytest.approx((0, 0, 6))


def test_objects_of_one_track_are_one_motion(tmp_path: Path) -> None:
    objects = read(tmp_path, MOVING.replace('def Mesh "house"', 'def Sphere "far" {}\n def Mesh "house"')).objects
    both = read(tmp_path, MOVING + "\n" + MOVING.replace('"car"', '"other"').replace('"house"', '"barn"')).objects
    assert objects[0].motion is not None
    assert objects[1].motion is None
    assert both[0].motion == both[2].motion


def test_what_turns_by_itself_is_a_body_by_itself(tmp_path: Path) -> None:
    body = f"""def Xform "car" {{
      {ops(translate={0: (100, 0, 0), 24: (100, 12, 0)}, rotateZ={0: 0, 24: 30})}
      def Mesh "wheel" {{
        {CUBE}
        {ops(translate=(0, 2, 0), rotateX={0: 0, 24: 720})}
      }}
      {cube("body")}
    }}"""
    motions = [item.motion for item in read(tmp_path, body).objects]
    assert [motion.body for motion in motions if isinstance(motion, Moving)] == ["/car/wheel", "/car"]


def test_what_is_odd_about_an_animation_is_said(tmp_path: Path) -> None:
    body = f"""def Mesh "m" {{
      {CUBE}
      token visibility.timeSamples = {{ 0: "inherited", 5: "invisible" }}
      double3 xformOp:translate.timeSamples = {{ -24: (0, 0, 0), 0: (1, 0, 0), 24: None,
        48: (9, 0, 0), 72: (10, 0, 0) }}
      uniform token[] xformOpOrder = ["xformOp:translate"]
    }}
    def Mesh "late" {{
      {CUBE}
      token visibility.timeSamples = {{ 0: "invisible", 5: "inherited" }}
    }}
    def Sphere "s" {{
      double radius.timeSamples = {{ 0: 1, 24: 2 }}
    }}
    def Mesh "driven" {{
      {CUBE}
      custom double3 radar:velocity = (1, 0, 0)
      {ops(rotateZ={0: 0, 24: 90})}
    }}
    def Xform "post" {{
      custom float radar:rcs_dbsm.timeSamples = {{ 0: 3, 24: 9 }}
      custom double3 radar:velocity.timeSamples = {{ 0: (1, 0, 0), 24: (5, 0, 0) }}
    }}"""
    metadata = f"{METRES_Z_UP}\n timeCodesPerSecond = 24\n startTimeCode = 24\n endTimeCode = 0"
    scene = read(tmp_path, body, metadata)
    assert set(scene.warnings) == {
        "startTimeCode 24 lies after endTimeCode 0: time 0 is that of 0",
        "1 animations have samples before startTimeCode or after endTimeCode, which count too",
        "1 gaps in animations (samples without a value) hold the value before them",
        "2 prims appear or vanish: taken as at the start",
        "1 invisible prims skipped, with everything below them",
        "1 solids change their size: taken as they are at the start",
        "1 objects have radar:velocity and time samples: the attribute says how they move",
        "1 attributes radar:rcs_dbsm have time samples: taken as at the start",
        "1 attributes radar:velocity have time samples: taken as at the start",
    }
    assert (scene.targets[0].rcs_dbsm, scene.targets[0].velocity) == (3.0, (1.0, 0.0, 0.0))
    item = scene.objects[0]
    places = [float(item.at(time).vertices[:, 0].mean()) for time in (-2.0, -1.0, 0.0, 0.5, 1.0, 1.9, 2.0, 2.5, 3.0)]
    assert places == pytest.approx([0.0, 0.0, 1.0, 1.0, 1.0, 1.0, 9.0, 9.5, 10.0])
    assert float(item.at(2.5).velocities[0, 0]) == pytest.approx(1.0)
    driven = scene.objects[2].at(2.0)
    np.testing.assert_allclose(driven.vertices.mean(axis=0), [2, 0, 0], atol=1e-9)


def test_rates_that_are_not_used_are_said(tmp_path: Path) -> None:
    body = f"""def Mesh "cloth" {{
      {CUBE}
      vector3f[] velocities = [{", ".join(8 * ["(1, 0, 0)"])}]
    }}
    def PointInstancer "wheels" {{
      point3f[] positions = [(9, 0, 0)]
      vector3f[] velocities = [(1, 0, 0)]
      vector3f[] angularVelocities = [(0, 0, 90)]
      int[] protoIndices = [0]
      rel prototypes = </wheels/wheel>
      def Sphere "wheel" {{
      }}
    }}"""
    scene = read(tmp_path, body)
    assert not any(item.moves for item in scene.objects)
    assert scene.warnings == (
        "1 meshes have 'velocities', which are not used (points' samples are)",
        "1 point instancers have 'velocities', which are not used (positions' samples are)",
        "1 point instancers have 'angularVelocities', which are not used (orientations' samples are)",
    )


@pytest.mark.parametrize(
    ("samples", "later", "same"),
    [
        ("int[] protoIndices.timeSamples = { 0: [0], 24: LATER }", "[1]", "[0]"),
        ("int[] protoIndices = [0]\nint64[] ids.timeSamples = { 0: [7], 24: LATER }", "[8]", "[7]"),
        ("int[] protoIndices = [0]\nint64[] invisibleIds.timeSamples = { 0: [], 24: LATER }", "[0]", "[]"),
    ],
)
def test_instances_that_come_and_go_are_said(tmp_path: Path, samples: str, later: str, same: str) -> None:
    body = f"""def PointInstancer "cars" {{
      point3f[] positions = [(9, 0, 0)]
      {samples}
      rel prototypes = [</cars/car>, </cars/van>]
      def Sphere "car" {{
      }}
      def Cube "van" {{
      }}
    }}"""
    scene = read(tmp_path, body.replace("LATER", later))
    assert [item.name for item in scene.objects] == ["/cars[0]/car"]
    assert scene.warnings == ("1 point instancers change which instances they have: taken as at the start",)
    assert read(tmp_path, body.replace("LATER", same)).warnings == ()


def test_a_turning_target_points_where_its_prim_does(tmp_path: Path) -> None:
    body = """def Xform "t" {
      custom token radar:target = "car"
      double3 xformOp:translate.timeSamples = { 0: (10, 0, 0), 24: (10, 6, 0) }
      double xformOp:rotateZ.timeSamples = { 0: 0, 24: 90 }
      uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateZ"]
    }"""
    (target,) = read(tmp_path, body, f"{METRES_Z_UP}\n timeCodesPerSecond = 24").targets
    now = target.at(0.5)
    assert now.position == pytest.approx((10, 3, 0))
    assert now.velocity == pytest.approx((0, 6, 0))
    np.testing.assert_allclose(now.axes[0], [np.sqrt(0.5), np.sqrt(0.5), 0], atol=1e-12)
    assert now.spin == pytest.approx((0, 0, np.pi / 2))
    assert target.velocity == pytest.approx((0, 6, 0))


def test_a_spline_is_followed(tmp_path: Path) -> None:
    item = read(tmp_path, SPLINE, f"{METRES_Z_UP}\n timeCodesPerSecond = 24").objects[0]
    places = [float(item.at(time).vertices[:, 0].mean()) for time in (0.0, 0.5, 1.0, 1.9, 2.0, 3.0)]
    assert places == pytest.approx([0, 3, 6, 6, 10, 10])
    assert float(item.at(0.5).velocities[0, 0]) == pytest.approx(6.0)
    assert float(item.at(1.5).velocities[0, 0]) == 0.0


def test_the_velocity_attribute_goes_to_all_below_and_turns_with_the_axes(tmp_path: Path) -> None:
    body = f"""def Xform "car" {{
      custom float3 radar:velocity = (1, 2, 3)
      {cube("m")}
    }}"""
    item = read(tmp_path, body, 'metersPerUnit = 0.01\n upAxis = "Y"').objects[0]
    assert item.velocity == pytest.approx((1, -3, 2))  # metres per second whatever the stage's unit


def test_the_same_file_gives_the_same_scene(tmp_path: Path) -> None:
    path = write_usda(
        tmp_path, MOVING + '\ndef Xform "l" (references = </l>) {\n}'
    )  # a cycle: USD names layers by address
    first, second = read_usd(path), read_usd(path)
    assert first.content_hash() == second.content_hash()
    assert first.warnings == second.warnings
    assert any("composition errors" in warning and "anon:" not in warning for warning in first.warnings)


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
    assert not Chain((np.eye(4), Operation("scale", Samples(np.zeros(1), np.array([[1.0, 2.0, 3.0]]))))).moves
