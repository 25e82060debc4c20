"""Small USD stages as text, for the tests of the USD reader."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from datafactory.scenes.readers.open import open_scene
from datafactory.scenes.scene import Scene, SceneObject

METRES_Z_UP = 'metersPerUnit = 1\n upAxis = "Z"'
# A cube of edge 2 about the origin, corners numbered x + 2 y + 4 z, counter-clockwise seen from outside.
CUBE_POINTS = "point3f[] points = [(-1,-1,-1),(1,-1,-1),(-1,1,-1),(1,1,-1),(-1,-1,1),(1,-1,1),(-1,1,1),(1,1,1)]"
CUBE_FACES = """int[] faceVertexCounts = [4, 4, 4, 4, 4, 4]
    int[] faceVertexIndices = [0,2,3,1, 4,5,7,6, 0,1,5,4, 2,6,7,3, 0,4,6,2, 1,3,7,5]
    uniform token subdivisionScheme = "none"
"""
CUBE = f"{CUBE_POINTS}\n    {CUBE_FACES}"

MOVING = """def Xform "car" {
      double3 xformOp:translate.timeSamples = { 0: (0, 0, 0), 12: (0, 0, 600), 24: (0, 0, 0) }
      uniform token[] xformOpOrder = ["xformOp:translate"]
      def Mesh "m" {
      CUBE
      }
    }
    def Mesh "house" {
    CUBE
    }""".replace("CUBE", CUBE)
"""A cube that drives to and fro along the stage's z, and one that stands."""
SPLINE = """def Mesh "m" {
      CUBE
      double xformOp:translateX.spline = {
        0: 0; post linear,
        24: 6; post held,
        48: 10; post linear,
      }
      uniform token[] xformOpOrder = ["xformOp:translateX"]
    }""".replace("CUBE", CUBE)
"""From 0 to 6 m in a second, held there for one, then at 10 m."""


def write_usda(folder: Path, body: str, metadata: str = METRES_Z_UP, name: str = "stage.usda") -> Path:
    path = folder / name
    path.write_text(stage(body, metadata), encoding="utf-8")
    return path


def stage(body: str, metadata: str = METRES_Z_UP) -> str:
    return f"#usda 1.0\n(\n {metadata}\n)\n{body}\n"


def read(folder: Path, body: str, metadata: str = METRES_Z_UP) -> Scene:
    return open_scene(str(write_usda(folder, body, metadata)))


def signed_volume(item: SceneObject) -> float:
    """sum a . (b x c) / 6 [m^3]: positive for a closed surface whose normals point outwards."""
    a, b, c = (item.vertices[item.triangles[:, corner]] for corner in range(3))
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6)


def area(item: SceneObject) -> float:
    a, b, c = (item.vertices[item.triangles[:, corner]] for corner in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


def translated(x: float, y: float, z: float) -> str:
    return ops(translate=(x, y, z))


def ops(**operations: object) -> str:
    """Operations of a transform, outermost first; a dict has a value at each of its time codes."""
    lines = []
    for name, value in operations.items():
        kind = "double" if name in ("rotateX", "rotateY", "rotateZ") else "double3"
        samples = (
            f"{{ {', '.join(f'{code}: {each}' for code, each in value.items())} }}" if isinstance(value, dict) else ""
        )
        lines.append(f"{kind} xformOp:{name}{'.timeSamples' if samples else ''} = {samples or value}")
    order = ", ".join(f'"xformOp:{name}"' for name in operations)
    return "\n".join([*lines, f"uniform token[] xformOpOrder = [{order}]\n"])


def cube(name: str) -> str:
    """A mesh of edge 2 about the origin."""
    return f'def Mesh "{name}" {{\n{CUBE}\n}}'


def mesh(name: str, places: ArrayLike, faces: Sequence[Sequence[int]], material: str = "", more: str = "") -> str:
    """A mesh of these places [V, 3], in the stage's unit, and faces, with other lines of its own."""
    corners = ", ".join(f"({x!r}, {y!r}, {z!r})" for x, y, z in np.asarray(places, dtype=float).tolist())
    return f"""def Mesh "{name}" {{
  point3f[] points = [{corners}]
  int[] faceVertexCounts = {[len(face) for face in faces]}
  int[] faceVertexIndices = {[int(index) for face in faces for index in face]}
  uniform token subdivisionScheme = "none"
  {f'custom token radar:material = "{material}"' if material else ""}
  {more}
}}
"""


UPWARD = {"Z": (0, 1, 2), "Y": (0, 2, 1), "X": (2, 0, 1)}
"""Which of the world's axes a stage's x, y and z are; with Y up, z runs against the world's y."""


@dataclass(frozen=True)
class Twin:
    """How one scene is written with another axis up and in another unit.

    :param up: "X", "Y" or "Z"; :param metres: in one unit
    """

    up: str
    metres: float

    @property
    def metadata(self) -> str:
        return f'metersPerUnit = {self.metres}\n upAxis = "{self.up}"'

    def turned(self, vector: ArrayLike) -> str:
        """A world direction or velocity as the stage has it, whatever its unit."""
        parts = np.asarray(vector, dtype=float)[list(UPWARD[self.up])] * (1.0, 1.0, -1.0 if self.up == "Y" else 1.0)
        return f"({', '.join(repr(float(part) + 0.0) for part in parts)})"

    def place(self, world_m: ArrayLike) -> str:
        """A world place [m] as the stage has it."""
        return self.turned(np.asarray(world_m, dtype=float) / self.metres)

    def places(self, world_m: Iterable[ArrayLike]) -> str:
        return f"[{', '.join(map(self.place, world_m))}]"


TWINS = tuple(Twin(up, metres) for up in UPWARD for metres in (1.0, 0.01))
