"""Things and their boxes: places, headings, sizes and velocities against numbers computed by hand, class by class."""

from pathlib import Path

import numpy as np
import pytest
from usd_files import CUBE, METRES_Z_UP, ops, read

from datafactory.scenes.boxes import BoxedThing, boxed_things, seen_things
from datafactory.scenes.poses import Pose
from datafactory.scenes.scene import PointTarget, Scene
from datafactory.scenes.targets.models import target_model

# A car of 4 x 2 x 1.5 m: a cube of edge 2 scaled, its middle 0.75 m up, its axes turned by the Xform above it.
BODY = f"""def Mesh "Body" {{
    {CUBE}
    {ops(translate=(0, 0, 0.75), scale=(2, 1, 0.75))}
}}"""


def car(attributes: str, name: str = "Car", body: str = BODY) -> str:
    return f'def Xform "{name}" {{\n {attributes}\n {body}\n}}'


def placed(x: float, y: float, yaw_deg: float) -> str:
    return f"""double3 xformOp:translate = ({x}, {y}, 0)
 double xformOp:rotateZ = {yaw_deg}
 uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateZ"]
"""


def only(scene: Scene) -> BoxedThing:
    (thing,) = boxed_things(scene)
    return thing


def assert_velocity_is_the_centres_rate(thing: BoxedThing, time_s: float, relative: float = 1e-5) -> None:
    step = 1e-6
    rate = (thing.at(time_s + step).center - thing.at(time_s).center) / step
    np.testing.assert_allclose(thing.at(time_s).velocity, rate, rtol=relative, atol=1e-5)


def test_a_straight_car_seen_from_two_poses_at_two_times(tmp_path: Path) -> None:
    """At 30 deg, 10 m/s along its x: by hand, the radar turned by 90 deg to the left and driving at 2 m/s."""
    heading = np.array([np.cos(np.pi / 6), np.sin(np.pi / 6), 0.0])
    moves = f"custom double3 radar:velocity = ({10 * heading[0]}, {10 * heading[1]}, 0)"
    scene = read(tmp_path, car(f'custom string radar:class = "car"\n {moves}\n {placed(12, 5, 30)}'))
    for time_s in (0.0, 0.7):
        for pose in (
            Pose((0.0, 0.0, 0.5), time_s=time_s),
            Pose((12.0, -20.0, 0.5), yaw_deg=90.0, velocity=(0.0, 2.0, 0.0), time_s=time_s),
        ):
            (seen,) = seen_things(boxed_things(scene), pose)
            world = np.array([12.0, 5.0, 0.75]) + 10.0 * time_s * heading - np.array(pose.position)
            turn = np.radians(pose.yaw_deg)
            forward, left = np.array([np.cos(turn), np.sin(turn), 0]), np.array([-np.sin(turn), np.cos(turn), 0])
            np.testing.assert_allclose(seen.center, [world @ forward, world @ left, world[2]], atol=1e-12)
            np.testing.assert_allclose(seen.size, [4.0, 2.0, 1.5], atol=1e-12)
            assert np.arctan2(seen.forward[1], seen.forward[0]) == pytest.approx(np.radians(30.0) - turn)
            rate = 10.0 * heading - np.array(pose.velocity)
            np.testing.assert_allclose(seen.velocity, [rate @ forward, rate @ left, 0.0], atol=1e-12)
            assert (seen.name, seen.class_name) == ("/Car", "car")


def test_a_turning_car_keeps_its_size_and_its_velocity_is_its_centres(tmp_path: Path) -> None:
    """A quarter turn in 2 s on a circle of 10 m: 10 pi / 4 m/s along its heading; the wheel on it turns by itself."""
    circle = """double xformOp:rotateZ.timeSamples = { 0: 0, 2: 90 }
 double3 xformOp:translate = (0, -10, 0)
 uniform token[] xformOpOrder = ["xformOp:rotateZ", "xformOp:translate"]
"""
    wheel = f"""def Mesh "Wheel" {{ {CUBE}
    {ops(translate=(0, 0, 0.75), rotateY={0: 0, 2: 3600}, scale=(0.2, 0.2, 0.2))}
}}"""
    metadata = f"{METRES_Z_UP}\n timeCodesPerSecond = 1\n startTimeCode = 0\n endTimeCode = 2"
    thing = only(read(tmp_path, car(circle, body=f"{BODY}\n{wheel}"), metadata))
    assert (thing.name, thing.class_name) == ("/Car", "other")
    for time_s in (0.0, 0.5, 1.3):
        box, angle = thing.at(time_s), np.pi / 4 * time_s
        np.testing.assert_allclose(box.center, [10 * np.sin(angle), -10 * np.cos(angle), 0.75], atol=1e-9)
        np.testing.assert_allclose(box.size, [4.0, 2.0, 1.5], atol=1e-9)
        np.testing.assert_allclose(box.axes[0], [np.cos(angle), np.sin(angle), 0.0], atol=1e-12)
        np.testing.assert_allclose(box.velocity, 2.5 * np.pi * box.axes[0], atol=1e-9)
        assert_velocity_is_the_centres_rate(thing, time_s)


def test_a_track_of_two_pieces_has_the_velocity_of_the_piece(tmp_path: Path) -> None:
    track = """double3 xformOp:translate.timeSamples = { 0: (0, 0, 0), 1: (4, 0, 0), 3: (4, 2, 0) }
 uniform token[] xformOpOrder = ["xformOp:translate"]
"""
    metadata = f"{METRES_Z_UP}\n timeCodesPerSecond = 1\n startTimeCode = 0\n endTimeCode = 3"
    thing = only(read(tmp_path, car(track), metadata))
    assert not thing.turns  # its box is shifted, and not computed anew
    np.testing.assert_allclose(thing.at(0.5).center, [2.0, 0.0, 0.75])
    np.testing.assert_allclose(thing.at(2.0).velocity, [0.0, 1.0, 0.0])
    for time_s in (0.25, 1.0, 1.5):
        assert_velocity_is_the_centres_rate(thing, time_s)


def test_an_asset_with_y_up_stands_upright_in_a_scene_with_z_up(tmp_path: Path) -> None:
    """Its y points up after a turn by 90 deg about x: height lies along it, the yaw is that of its x."""
    asset = """custom token radar:class = "van"
 double xformOp:rotateZ = 40
 double xformOp:rotateX = 90
 double3 xformOp:scale = (3, 1, 0.5)
 uniform token[] xformOpOrder = ["xformOp:rotateZ", "xformOp:rotateX", "xformOp:scale"]
"""
    box = only(read(tmp_path, car(asset, body=f'def Mesh "Body" {{ {CUBE} }}'))).at(0.0)
    np.testing.assert_allclose(box.size, [6.0, 1.0, 2.0], atol=1e-12)
    np.testing.assert_allclose(box.axes[0], [np.cos(np.radians(40)), np.sin(np.radians(40)), 0], atol=1e-12)
    np.testing.assert_allclose(box.axes[2], [0, 0, 1], atol=1e-12)


def test_a_class_on_a_scope_is_that_of_each_thing_in_it(tmp_path: Path) -> None:
    """Parked cars in a Scope, one of them a lorry of its own class with two meshes; a house without a class."""
    two = f"{BODY}\n{BODY.replace('Body', 'Trailer').replace('(0, 0, 0.75)', '(5, 0, 0.75)')}"
    parked = "\n".join(
        (
            car(placed(10, 0, 0), "First"),
            car(placed(20, 0, 0), "Second"),
            car(f'custom string radar:class = "truck"\n{placed(30, 0, 0)}', "Lorry", two),
        )
    )
    scope = f'def Scope "Parked" {{ custom string radar:class = "car"\n {parked}\n}}'
    things = boxed_things(read(tmp_path, f"{scope}\n{car(placed(50, 0, 0), 'House')}"))
    assert [(thing.name, thing.class_name) for thing in things] == [
        ("/Parked/First", "car"), ("/Parked/Second", "car"), ("/Parked/Lorry", "truck")
    ]  # fmt: skip
    np.testing.assert_allclose(things[2].at(3.0).size, [9.0, 2.0, 1.5])
    np.testing.assert_allclose(things[2].at(3.0).center, [32.5, 0.0, 0.75])
    assert not things[2].at(3.0).velocity.any()


def test_each_instance_of_a_point_instancer_is_a_thing(tmp_path: Path) -> None:
    crowd = f"""def PointInstancer "Crowd" {{
 custom string radar:class = "pedestrian"
 point3f[] positions = [(5, 0, 0), (7, 1, 0)]
 int[] protoIndices = [0, 0]
 rel prototypes = </Crowd/Body>
 {BODY}
}}"""
    things = boxed_things(read(tmp_path, crowd))
    assert [thing.class_name for thing in things] == ["pedestrian"] * 2
    np.testing.assert_allclose([thing.start.center for thing in things], [[5, 0, 0.75], [7, 1, 0.75]])


def test_targets_have_the_boxes_of_their_models_or_of_what_they_stand_for(tmp_path: Path) -> None:
    models = """def Xform "Walker" { custom token radar:target = "pedestrian"
 custom double radar:stature_m = 1.6
 custom double3 radar:velocity = (0, 1, 0)
 double3 xformOp:translate = (8, 0, 0)
 uniform token[] xformOpOrder = ["xformOp:translate"]
}
def Xform "Reflector" { custom token radar:target = "trihedral"
 custom double radar:edge_m = 0.2
}
"""
    stands = f"custom double radar:rcs_dbsm = 10\n custom double3 radar:velocity = (1, 0, 0)\n {placed(20, 0, 90)}"
    things = boxed_things(read(tmp_path, f"{models}\n{car(stands)}"))
    assert [(thing.name, thing.class_name) for thing in things] == [("/Walker", "pedestrian"), ("/Car", "other")]
    walker, car_box = (thing.at(2.0) for thing in things)
    np.testing.assert_allclose(walker.center, [8.0, 2.0, 0.8])
    np.testing.assert_allclose(walker.size, [0.5, 0.5, 1.6])
    np.testing.assert_allclose(car_box.center, [22.0, 0.0, 0.75], atol=1e-12)
    np.testing.assert_allclose(car_box.size, [4.0, 2.0, 1.5], atol=1e-9)
    np.testing.assert_allclose(car_box.axes[0], [0.0, 1.0, 0.0], atol=1e-12)


def test_samples_that_do_not_differ_make_no_thing(tmp_path: Path) -> None:
    """Exporters write them for the root of a scene: everything below it were one box of the size of the scene."""
    world = f"""def Xform "World" {{
 {ops(translate={0: (0, 0, 0), 48: (0, 0, 0)})}
 {car(ops(translate={0: (0, 0, 0), 24: (5, 0, 0)}))}
 {car(placed(20, 10, 0), "House")}
}}"""
    thing = only(read(tmp_path, world, f"{METRES_Z_UP}\n startTimeCode = 0\n endTimeCode = 48"))
    assert thing.name == "/World/Car"
    np.testing.assert_allclose(thing.at(0.5).velocity, [5.0, 0.0, 0.0], atol=1e-9)


@pytest.mark.parametrize(
    ("group", "own", "names"),
    [
        ("custom double3 radar:velocity = (5, 0, 0)", "", ["/G", "/G/A", "/G/B"]),
        ("custom double3 radar:velocity = (0, 0, 0)", "custom double3 radar:velocity = (5, 0, 0)", ["/G/A", "/G/B"]),
        (ops(translate={0: (0, 0, 0), 24: (5, 0, 0)}), "", ["/G", "/G/A", "/G/B"]),
        ('custom string radar:class = "convoy"\n custom double3 radar:velocity = (5, 0, 0)', "", ["/G"]),
    ],
)
def test_road_users_of_a_moving_group_are_things_of_their_own(
    tmp_path: Path, group: str, own: str, names: list[str]
) -> None:
    """But for a class that the group states; what else moves with it is one thing, and what rests is none."""
    users = "".join(
        f'def Xform "{name}" {{ custom token radar:target = "{kind}"\n {own}\n {ops(translate=(x, 0, 0))} }}\n'
        for name, kind, x in (("A", "car", 12), ("B", "pedestrian", 40))
    )
    things = boxed_things(read(tmp_path, f'def Xform "G" {{\n {group}\n {users} {BODY}\n}}'))
    moving = [thing for thing in things if np.any(thing.at(0.1).velocity)]
    assert sorted(thing.name for thing in moving) == names
    classes = {thing.name: thing.class_name for thing in moving}
    assert classes.get("/G/B", "pedestrian") == "pedestrian"
    for thing in moving:
        np.testing.assert_allclose(thing.at(0.1).velocity, [5.0, 0.0, 0.0], atol=1e-9)


def test_a_target_stands_for_geometry_of_the_purpose_render(tmp_path: Path) -> None:
    stands = f'custom double radar:rcs_dbsm = 10\n custom string radar:class = "car"\n {placed(20, 0, 90)}'
    shown = BODY.replace("{", '{\n uniform token purpose = "render"', 1)
    np.testing.assert_allclose(only(read(tmp_path, car(stands, body=shown))).at(0.0).size, [4.0, 2.0, 1.5], atol=1e-9)


def test_what_moves_without_a_label_is_a_thing_by_itself() -> None:
    """As scenes that a program makes have it: a point where no size is known."""
    target = PointTarget("post", (4.0, 0.0, 1.0), 0.0, velocity=(0.0, 2.0, 0.0))
    sphere = PointTarget("ball", (9.0, 0.0, 1.0), 0.0, (1.0, 0.0, 0.0), target_model("sphere", {"radius_m": 0.5}))
    post, ball = (thing.at(0.5) for thing in boxed_things(Scene("made", (), (target, sphere))))
    np.testing.assert_allclose(post.center, [4.0, 1.0, 1.0])
    assert not post.size.any()
    np.testing.assert_allclose(ball.size, [1.0, 1.0, 1.0])
    np.testing.assert_allclose(ball.velocity, [1.0, 0.0, 0.0])


@pytest.mark.parametrize("fine", [1, 12])
def test_a_boxs_velocity_is_its_middles_however_finely_its_parts_are_cut(tmp_path: Path, fine: int) -> None:
    """A standing body with a door that turns about its edge, of 4 vertices or of 156."""
    y = np.linspace(0.0, 1.2, fine + 1)
    points = ",".join(f"(0,{place:.6f},{height})" for place in y for height in np.linspace(0.0, 1.2, fine + 1))
    faces = ",".join(
        f"{i * (fine + 1) + j},{(i + 1) * (fine + 1) + j},{(i + 1) * (fine + 1) + j + 1},{i * (fine + 1) + j + 1}"
        for i in range(fine)
        for j in range(fine)
    )
    door = f"""def Mesh "Door" {{
 point3f[] points = [{points}]
 int[] faceVertexCounts = [{",".join(["4"] * fine**2)}]
 int[] faceVertexIndices = [{faces}]
 uniform token subdivisionScheme = "none"
 {ops(translate=(0, 1, 0.2), rotateZ={0: 20, 24: 60})}
}}"""
    thing = only(
        read(tmp_path, car(f'custom string radar:class = "car"\n {placed(12, 5, 30)}', body=f"{BODY}\n{door}"))
    )
    for time_s in (0.0, 0.5):
        assert_velocity_is_the_centres_rate(thing, time_s)
        assert np.linalg.norm(thing.at(time_s).velocity) > 0.05


def test_the_class_is_part_of_a_scenes_content(tmp_path: Path) -> None:
    """A run that is resumed with other labels would mix two datasets."""
    hashes = {read(tmp_path, car(f'custom string radar:class = "{name}"')).content_hash() for name in ("car", "van")}
    assert len({*hashes, read(tmp_path, car("")).content_hash()}) == 3
