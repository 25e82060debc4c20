"""USD as it is found: materials that were not passed on, missing geometry, variants, X up."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from usd_files import CUBE, METRES_Z_UP, TWINS, Twin, cube, ops, read, translated, write_usda

from datafactory.scenes.readers.common import Reading, parse_variants
from datafactory.scenes.readers.open import open_scene
from datafactory.scenes.scene import Scene
from shared.physics.errors import InputError

BOX = f"""def Mesh "box" (prepend apiSchemas = ["MaterialBindingAPI"]) {{
  {CUBE}
  rel material:binding = </mtl/wood>
}}
"""


@pytest.mark.parametrize(
    "lost",
    [
        'def Scope "mtl" (references = @gone.mtlx@</MaterialX/Materials>) {}',  # USD's wheel does not read MaterialX
        'def "mtl" {\n def Material "wood" (references = @gone.usd@) {}\n}',
        'def "mtl" {\n def "wood" (payload = @gone.usd@) {}\n}',  # known by the binding alone
        'def Scope "Looks" {\n def "steel" (references = @gone.usd@</Looks/steel>) {}\n}',
        'def Material "m" {\n def "s" (references = @shaders/gone.usda@) {}\n}',
        'def Material "m" (references = </nowhere>) {}',
    ],
)
def test_a_lost_material_leaves_the_default_and_a_warning(tmp_path: Path, lost: str) -> None:
    scene = read(tmp_path, BOX + lost)
    assert [item.name for item in scene.objects] == ["/box"]
    (warning,) = [text for text in scene.warnings if "cannot be opened" in text]
    assert warning.startswith("1 references to materials, shaders or textures cannot be opened, the first ")
    assert scene.objects[0].material in ("", "wood")


LOST_GEOMETRY = BOX + "\n".join(f'def "{name}" (references = @{name}.usd@) {{}}' for name in ("b", "a", "c"))


def test_lost_geometry_is_always_the_same_error(tmp_path: Path) -> None:
    messages = set()
    for _ in range(3):
        with pytest.raises(InputError) as caught:
            read(tmp_path, LOST_GEOMETRY)
        messages.add(str(caught.value))
    (message,) = messages
    assert "@a.usd@" in message
    assert "(and 2 more)" in message
    assert "--allow-missing" in message
    assert "\n" not in message


def test_allow_missing_goes_on_and_says_what_is_left_out(tmp_path: Path) -> None:
    scene = open_scene(str(write_usda(tmp_path, LOST_GEOMETRY)), Reading(allow_missing=True))
    assert [item.name for item in scene.objects] == ["/box"]
    assert any("3 references to geometry cannot be opened and are left out" in text for text in scene.warnings)


def test_a_lost_reference_of_what_is_named_like_materials_but_has_geometry_is_an_error(tmp_path: Path) -> None:
    body = f'def Xform "materials" (references = @gone.usd@) {{\n def Mesh "m" {{\n{CUBE}\n}}\n}}'
    with pytest.raises(InputError, match=r"gone\.usd"):
        read(tmp_path, body)


CAR = f"""def Xform "car" (
  variants = {{
    string body = "van"
    string wheels = "none"
  }}
  prepend variantSets = ["body", "wheels"]
) {{
  variantSet "body" = {{
    "van" {{
      {cube("van")}
    }}
    "sedan" (
      prepend variantSets = "roof"
    ) {{
      {cube("sedan")}
      variantSet "roof" = {{
        "open" {{
        }}
        "closed" {{
          {cube("roof")}
        }}
      }}
    }}
  }}
  variantSet "wheels" = {{
    "none" {{
    }}
    "four" {{
      {cube("wheel")}
    }}
  }}
}}"""


def names(folder: Path, body: str, *variants: str) -> list[str]:
    path = write_usda(folder, body)
    return [item.name for item in open_scene(str(path), Reading(parse_variants(variants))).objects]


def test_variants_are_selected_over_the_files_own_and_within_one_another(tmp_path: Path) -> None:
    assert names(tmp_path, CAR) == ["/car/van"]
    assert names(tmp_path, CAR, "wheels=four") == ["/car/wheel", "/car/van"]
    assert names(tmp_path, CAR, "roof=closed", "body=sedan") == ["/car/roof", "/car/sedan"]


def test_variants_within_instances_are_selected(tmp_path: Path) -> None:
    write_usda(tmp_path, CAR, METRES_Z_UP, "car.usda")
    write_usda(tmp_path, 'def Xform "lot" {\n def "one" (references = @car.usda@</car>) {\n}\n}', name="lot.usda")
    lots = [
        f'def "l{n}" (instanceable = true\n references = @lot.usda@</lot>) {{\n{translated(9 * n, 0, 0)}}}'
        for n in range(2)
    ]
    assert names(tmp_path, "\n".join(lots)) == ["/l0/one/van", "/l1/one/van"]
    assert names(tmp_path, "\n".join(lots), "body=sedan") == ["/l0/one/sedan", "/l1/one/sedan"]


@pytest.mark.parametrize(
    ("variants", "message"),
    [
        (["paint=red"], "--variant: no prim has a variant set 'paint'; expected body, wheels"),
        (["body=truck"], "--variant: body has no variant 'truck'; expected sedan, van"),
        (["body"], "--variant: 'body'; expected set=name"),
        (["body=van", "body=sedan"], "--variant: 'body' is given as 'van' and as 'sedan'"),
    ],
)
def test_a_variant_that_there_is_not_is_named_with_those_that_there_are(
    tmp_path: Path, variants: list[str], message: str
) -> None:
    with pytest.raises(InputError) as caught:
        names(tmp_path, CAR, *variants)
    assert message in str(caught.value)


def test_other_formats_have_no_variants(tmp_path: Path) -> None:
    path = tmp_path / "m.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    with pytest.raises(InputError, match="has no variants; expected a USD file"):
        open_scene(str(path), Reading((("a", "b"),)))


CORNERS = np.array([(0.5, 0.25, 0.0), (2.0, 0.25, 0.0), (2.0, 1.5, 0.75), (0.5, 1.5, 0.75)])


def twin_scene(folder: Path, twin: Twin) -> Scene:
    """A sheet that drives and turns about the vertical, a cross section that goes straight on, and a walker."""
    turning = {f"rotate{twin.up}": {0: 0, 24: 90}}
    body = f"""def Mesh "sheet" {{
      point3f[] points = {twin.places(CORNERS)}
      int[] faceVertexCounts = [4]
      int[] faceVertexIndices = [0, 1, 2, 3]
      {ops(translate={0: twin.place((3, 4, 5)), 24: twin.place((3, 4, 14))}, **turning)}
    }}
    def Xform "post" {{
      custom float radar:rcs_dbsm = 3
      custom double3 radar:velocity = {twin.turned((-1.0, 2.0, 0.5))}
      {ops(translate=twin.place((18.0, 6.0, 1.0)))}
    }}
    def Xform "walker" {{
      custom token radar:target = "pedestrian"
      {ops(translate={0: twin.place((10.0, -1.0, 0.0)), 24: twin.place((10.0, 0.5, 0.0))})}
    }}"""
    return read(folder, body, f"{twin.metadata}\n timeCodesPerSecond = 24")


@pytest.mark.parametrize("twin", TWINS, ids=str)
def test_twins_in_other_axes_and_units_are_the_same_scene(tmp_path: Path, twin: Twin) -> None:
    """Whatever is up, and in metres or centimetres: places, velocities and headings at a time, computed by hand."""
    scene = twin_scene(tmp_path, twin)
    sheet, (post, walker) = scene.objects[0].at(0.5), (target.at(0.5) for target in scene.targets)
    half = np.sqrt(0.5) * np.array([(1.0, -1.0, 0.0), (1.0, 1.0, 0.0), (0.0, 0.0, np.sqrt(2.0))])
    turned = CORNERS @ half.T
    np.testing.assert_allclose(sheet.vertices, turned + np.array([3.0, 4.0, 9.5]), atol=1e-6)
    velocity = 0.5 * np.pi * np.cross([0.0, 0.0, 1.0], turned) + np.array([0.0, 0.0, 9.0])
    np.testing.assert_allclose(sheet.velocities, velocity, atol=1e-6)
    np.testing.assert_allclose([post.position, post.velocity], [(17.5, 7.0, 1.25), (-1.0, 2.0, 0.5)], atol=1e-9)
    np.testing.assert_allclose([walker.position, walker.velocity], [(10.0, -0.25, 0.0), (0.0, 1.5, 0.0)], atol=1e-9)
    np.testing.assert_allclose(walker.axes, np.eye(3), atol=1e-9)
