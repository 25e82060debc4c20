"""What large scenes cost before the first frame: processor seconds and peak memory, step by step.

``python tests/benchmarks/large_scenes.py KIND`` with KIND one of ``instances`` (a point instancer of 5000 with 162
triangles each), ``references`` (5000 native instances of the same) and ``faces`` (one mesh of 400 000 quadrilaterals).
"""

from __future__ import annotations

import resource
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from datafactory.paths.edges import edges_of
from datafactory.paths.facets import mirrors_of
from datafactory.paths.merged_scene import merge_scene
from datafactory.scenes.ground import free_ground
from datafactory.scenes.materials.table import load_materials
from datafactory.scenes.readers.open import open_scene

HEADER = """#usda 1.0
(
  metersPerUnit = 1
  upAxis = "Z"
)
def Mesh "ground" {
  point3f[] points = [(-50,-50,-1), (400,-50,-1), (400,400,-1), (-50,400,-1)]
  int[] faceVertexCounts = [4]
  int[] faceVertexIndices = [0, 1, 2, 3]
}
"""
COUNT = 5000


def wavy(name: str, side: int) -> str:
    """A sheet of side x side quadrilaterals on one square metre."""
    x, y = np.meshgrid(np.arange(side + 1) / side, np.arange(side + 1) / side, indexing="ij")
    points = np.stack([x, y, 0.05 * np.sin(7 * x) * np.cos(9 * y)], -1).reshape(-1, 3)
    corner = np.arange(side * side) // side * (side + 1) + np.arange(side * side) % side
    indices = np.stack([corner, corner + side + 1, corner + side + 2, corner + 1], -1).ravel()
    return f"""def Mesh "{name}" {{
      point3f[] points = [{", ".join(f"({a:.5f},{b:.5f},{c:.5f})" for a, b, c in points)}]
      int[] faceVertexCounts = [{", ".join(["4"] * (side * side))}]
      int[] faceVertexIndices = [{", ".join(map(str, indices))}]
      uniform token subdivisionScheme = "none"
    }}
    """


def place(index: int) -> str:
    return f"({index % 100 * 3}, {index // 100 * 3}, 0)"


def stage(kind: str) -> str:
    """The text of a USD stage of this kind."""
    if kind == "faces":
        return HEADER + wavy("sheet", 632)
    if kind == "instances":
        return f"""{HEADER}def PointInstancer "many" {{
          rel prototypes = </many/one>
          int[] protoIndices = [{", ".join(["0"] * COUNT)}]
          point3f[] positions = [{", ".join(map(place, range(COUNT)))}]
          {wavy("one", 9)}}}"""
    instances = [
        f"""def "i{index}" (instanceable = true
        references = </one>) {{
          double3 xformOp:translate = {place(index)}
          uniform token[] xformOpOrder = ["xformOp:translate"]
        }}"""
        for index in range(COUNT)
    ]
    return "\n".join([HEADER, *instances, f'class Xform "one" {{\n{wavy("sheet", 9)}}}'])


def measured(what: str, step: Callable[[], Any]) -> Any:
    """The step's value; prints what it took."""
    started = time.process_time()
    value = step()
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    print(f"{what:10s} {time.process_time() - started:6.2f} s {peak:6.2f} GB", flush=True)
    return value


def main(kind: str) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "large.usda"
        path.write_text(stage(kind), encoding="utf-8")
        scene = measured("open", lambda: open_scene(str(path)))
    materials = load_materials().map_materials([item.material for item in scene.objects])
    merged = measured("merge", lambda: merge_scene(scene, materials))
    measured("ground", lambda: free_ground(scene))
    measured("mirrors", lambda: mirrors_of(merged))
    measured("edges", lambda: edges_of(merged))


if __name__ == "__main__":
    main(sys.argv[1])
