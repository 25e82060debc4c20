"""Velocities equal differences of places at every keyframe: rigid, turning, skinned and shaped meshes, and targets."""

from pathlib import Path

import numpy as np
import pytest
from pxr import Usd, UsdGeom
from scipy.spatial.transform import Rotation
from usd_files import CUBE, CUBE_FACES, CUBE_POINTS, METRES_Z_UP, MOVING, SPLINE, ops, read, translated, write_usda

from datafactory.scenes.city.shapes import box
from datafactory.scenes.city.site import Keyframe, Placement
from datafactory.scenes.city.usd import write_usd
from datafactory.scenes.network.conversion import thinned
from datafactory.scenes.readers.open import open_scene
from datafactory.scenes.scene import PointTarget, Scene, SceneObject

STEP_S = 1e-6


SKINNED = """def SkelRoot "man" {
  double3 xformOp:translate = (0, 5, 0)
  uniform token[] xformOpOrder = ["xformOp:translate"]
  def Skeleton "bones" (prepend apiSchemas = ["SkelBindingAPI"]) {
    uniform token[] joints = ["hip", "hip/knee"]
    uniform matrix4d[] bindTransforms = [
      ( (1,0,0,0), (0,1,0,0), (0,0,1,0), (0,0,0,1) ), ( (1,0,0,0), (0,1,0,0), (0,0,1,0), (0,0,1,1) )]
    uniform matrix4d[] restTransforms = [
      ( (1,0,0,0), (0,1,0,0), (0,0,1,0), (0,0,0,1) ), ( (1,0,0,0), (0,1,0,0), (0,0,1,0), (0,0,1,1) )]
    rel skel:animationSource = </man/bones/walk>
    def SkelAnimation "walk" {
      uniform token[] joints = ["hip", "hip/knee"]
      float3[] translations.timeSamples = { 0: [(0,0,0), (0,0,1)], 12: [(1,0,0), (0,0,1)], 24: [(4,0,0), (0,0,1)] }
      quatf[] rotations.timeSamples = {
        0: [(1,0,0,0), (1,0,0,0)], 12: [(1,0,0,0), (0.7071068,0,0.7071068,0)], 24: [(1,0,0,0), (1,0,0,0)] }
      half3[] scales = [(1,1,1), (1,1,1)]
    }
  }
  def Mesh "leg" (prepend apiSchemas = ["SkelBindingAPI"]) {
    point3f[] points = [(0,0,0), (0,1,0), (0,0,1), (0,0,2)]
    int[] faceVertexCounts = [3, 3]
    int[] faceVertexIndices = [0, 1, 2, 1, 3, 2]
    uniform token subdivisionScheme = "none"
    rel skel:skeleton = </man/bones>
    int[] primvars:skel:jointIndices = [0, 0, 1, 1] ( elementSize = 1
      interpolation = "vertex" )
    float[] primvars:skel:jointWeights = [1, 1, 1, 1] ( elementSize = 1
      interpolation = "vertex" )
    matrix4d primvars:skel:geomBindTransform = ( (1,0,0,0), (0,1,0,0), (0,0,1,0), (0,0,0,1) )
  }
}"""


def moving_scenes(folder: Path) -> dict[str, Scene]:
    """Scenes with every kind of motion that a file has, by name."""
    turning = f"""def Xform "a" {{
      {ops(rotateXYZ={0: (0, 0, 0), 7: (40, -20, 10), 24: (80, 0, 300)}, scale={0: (1, 1, 1), 24: (2, 1, 1)})}
      def Mesh "m" {{
      {CUBE}
      {translated(4, 0, 0)}
      }}
    }}"""
    lifted = CUBE_POINTS.removeprefix("point3f[] points = ").replace("-1,1)", "-1,3)")
    breathing = f"""def Mesh "m" {{
      point3f[] points.timeSamples = {{ 0: {CUBE_POINTS.removeprefix("point3f[] points = ")}, 12: {lifted} }}
      {CUBE_FACES}
      {ops(translate={0: (0, 0, 0), 24: (9, 0, 0)})}
    }}"""
    birds = f"""def PointInstancer "birds" {{
      point3f[] positions.timeSamples = {{ 0: [(0, 0, 0), (9, 0, 0)], 24: [(3, 0, 0), (9, 0, 4)] }}
      quath[] orientations.timeSamples = {{ 0: [(1, 0, 0, 0), (1, 0, 0, 0)], 24: [(0.5, 0.5, 0.5, 0.5), (0, 0, 0, 1)] }}
      int[] protoIndices = [0, 0]
      rel prototypes = </birds/bird>
      {translated(0, 50, 0)}
      def Mesh "bird" {{
      {CUBE}
      {ops(rotateZ={0: 0, 24: 90})}
      }}
    }}"""
    rolling = f"""def Xform "car" {{
      {ops(translate={0: (100, 0, 0), 15: (100, 12, 0), 24: (93, 12, 1)}, rotateZ={0: 0, 9: 20, 24: 90})}
      def Mesh "wheel" {{
      {CUBE}
        {ops(translate=(0, 2, 0), rotateX={0: 0, 24: 720})}
      }}
      def Xform "rider" {{
        custom token radar:target = "cyclist"
        {ops(translate=(1, 1, 0))}
      }}
    }}"""
    bodies = {
        "turning": turning, "breathing": breathing, "birds": birds, "along": MOVING, "rolling": rolling,
        "skinned": SKINNED, "spline": SPLINE,
    }  # fmt: skip
    scenes = {}
    for name, body in bodies.items():
        (folder / name).mkdir()
        scenes[name] = read(folder / name, body, f"{METRES_Z_UP}\n timeCodesPerSecond = 24")
    return scenes


def hold_velocities(item: SceneObject | PointTarget, time_s: float) -> None:
    """The velocity at a time is the difference to the place that follows; a spin is that of the axes."""
    if isinstance(item, SceneObject):
        now, later = item.at(time_s), item.at(time_s + STEP_S)
        difference = (later.vertices - now.vertices) / STEP_S
        np.testing.assert_allclose(now.velocities, difference, atol=1e-3, err_msg=f"{item.name} at {time_s} s")
        return
    here, there = item.at(time_s), item.at(time_s + STEP_S)
    moved = np.subtract(there.position, here.position) / STEP_S
    np.testing.assert_allclose(here.velocity, moved, atol=1e-3, err_msg=f"{item.name} at {time_s} s")
    turned = np.subtract(there.axes, here.axes) / STEP_S
    np.testing.assert_allclose(np.cross(here.spin, here.axes), turned, atol=1e-3, err_msg=f"{item.name} at {time_s} s")


def hold_every_key(scene: Scene) -> int:
    """At, between, before and after the keyframes of everything that moves; how many keyframes there were."""
    seen = 0
    every: tuple[SceneObject | PointTarget, ...] = (*scene.objects, *scene.targets)
    for item in every:
        if item.motion is None:
            continue
        keys = np.array(item.motion.times)
        for time_s in (keys[0] - 0.5, *keys, *(0.5 * (keys[1:] + keys[:-1])), keys[-1] + 0.5):
            hold_velocities(item, float(time_s))
        seen += len(keys)
    return seen


@pytest.mark.parametrize(
    ("name", "keys"),
    [("turning", 3), ("breathing", 3), ("birds", 4), ("along", 3), ("rolling", 8), ("skinned", 3), ("spline", 3)],
)
def test_velocities_are_differences_of_places_at_every_keyframe(tmp_path: Path, name: str, keys: int) -> None:
    assert hold_every_key(moving_scenes(tmp_path)[name]) >= keys


def test_so_they_are_of_the_vehicles_that_a_city_on_a_network_has(tmp_path: Path) -> None:
    """A car that stands, sets out and turns: where every keyframe has it, though only those between pieces are kept."""
    every = [
        Keyframe(0.5 * n, (0.25 * max(n - 4, 0) ** 2, 0.1 * max(n - 9, 0), 0.2), 4.0 * max(n - 9, 0)) for n in range(13)
    ]
    kept = thinned(every)
    assert len(kept) == len(every) - 3  # it stands until 2 s
    body = box((-2.0, -0.9, 0.3), (2.0, 0.9, 1.4), "metal")
    car = Placement("Cars/Car_0", body, every[0].position, keyframes=tuple(kept))
    write_usd(tmp_path / "car.usda", [car], "A car.")
    scene = open_scene(str(tmp_path / "car.usda"))
    assert hold_every_key(scene) == len(kept)
    (item,) = scene.objects
    for key in every:
        there = body.moved(key.position, Rotation.from_euler("z", key.yaw_deg, degrees=True).as_matrix()).vertices
        np.testing.assert_allclose(item.at(key.time_s).vertices, there, atol=2e-3)


def test_instances_that_move_stand_where_usd_has_them(tmp_path: Path) -> None:
    scene = moving_scenes(tmp_path)["birds"]
    stage = Usd.Stage.Open(str(tmp_path / "birds" / "stage.usda"))
    instancer = UsdGeom.PointInstancer.Get(stage, "/birds")
    for code in (0.0, 5.0, 24.0):
        theirs = np.array(instancer.ComputeInstanceTransformsAtTime(Usd.TimeCode(code), Usd.TimeCode(code)))
        for index, item in enumerate(scene.objects):
            corner = np.array([1.0, 1.0, 1.0, 1.0]) @ theirs[index]  # vertex 7 of the cube
            np.testing.assert_allclose(item.at(code / 24.0).vertices[7], corner[:3] + np.array([0, 50, 0]), atol=2e-3)


def test_a_skinned_mesh_is_posed_at_its_time(tmp_path: Path) -> None:
    """The knee bends by 90 deg about y while the hip goes forward: the foot, 1 m above it here, ends beside it."""
    scene = read(tmp_path, SKINNED, f"{METRES_Z_UP}\n timeCodesPerSecond = 24")
    (item,) = scene.objects
    assert not any("rest pose" in warning for warning in scene.warnings)
    np.testing.assert_allclose(item.vertices[3], [0, 5, 2], atol=1e-6)
    for time, foot in ((0.0, [0, 5, 2]), (0.5, [2, 5, 1]), (1.0, [4, 5, 2]), (3.0, [4, 5, 2])):
        np.testing.assert_allclose(item.at(time).vertices[3], foot, atol=1e-6)
    np.testing.assert_allclose(item.at(0.25).velocities[0], [2, 0, 0], atol=1e-6)
    np.testing.assert_allclose(item.at(0.5).velocities[3], [4, 0, 2], atol=1e-5)


def test_instances_of_a_skinned_mesh_are_posed_too(tmp_path: Path) -> None:
    write_usda(tmp_path, SKINNED, f'{METRES_Z_UP}\n defaultPrim = "man"\n timeCodesPerSecond = 24', "man.usda")
    walkers = [
        f"""def "walker{n}" (instanceable = true
    references = @man.usda@) {{
    double3 xformOp:translate = (0, {n}, 0)
    }}"""
        for n in (7, 9)
    ]
    crowd = 'def Xform "crowd" {\n def "one" (instanceable = true\n references = @man.usda@) {\n }\n}'
    write_usda(tmp_path, crowd, f'{METRES_Z_UP}\n defaultPrim = "crowd"', "crowd.usda")
    group = 'def "group" (instanceable = true\n references = @crowd.usda@) {\n}'
    scene = read(tmp_path, "\n".join([*walkers, group]), f"{METRES_Z_UP}\n timeCodesPerSecond = 24")
    assert not any("rest pose" in warning for warning in scene.warnings)
    feet = [item.at(0.5).vertices[3] for item in scene.objects]
    np.testing.assert_allclose(feet, [[2, 7, 1], [2, 9, 1], [2, 5, 1]], atol=1e-6)
