"""A USD stage as a whole: units, axes, layers that are missing or in other units."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from usd_files import CUBE, read, signed_volume, translated, write_usda

from shared.physics.errors import InputError


@pytest.mark.parametrize(("metres", "volume"), [(1.0, 8.0), (0.01, 8e-6), (0.0254, 8 * 0.0254**3)])
def test_units_are_brought_to_metres(tmp_path: Path, metres: float, volume: float) -> None:
    scene = read(tmp_path, f'def Mesh "m" {{\n{CUBE}\n}}', f'metersPerUnit = {metres}\n upAxis = "Z"')
    assert signed_volume(scene.objects[0]) == pytest.approx(volume, rel=1e-12)


def test_missing_units_and_axis_are_usd_defaults_and_said(tmp_path: Path) -> None:
    scene = read(tmp_path, f'def Mesh "m" {{\n{CUBE}\n}}', 'doc = "bare"')
    assert np.ptp(scene.objects[0].vertices) == pytest.approx(0.02)
    assert any("no metersPerUnit" in warning for warning in scene.warnings)
    assert any("no upAxis" in warning for warning in scene.warnings)


def test_y_up_is_turned_to_z_up_without_a_mirror(tmp_path: Path) -> None:
    body = f'def Mesh "m" {{\n{CUBE}\n{translated(10, 20, 30)}}}'
    item = read(tmp_path, body, 'metersPerUnit = 1\n upAxis = "Y"').objects[0]
    np.testing.assert_allclose(item.vertices.mean(axis=0), [10, -30, 20])
    assert signed_volume(item) == pytest.approx(8.0)


@pytest.mark.parametrize(
    "body",
    [
        'def Xform "a" (references = @gone.usda@</X>) {\n}',
        'def Xform "a" (payload = @gone.usda@) {\n}',
        'def Xform "a" (instanceable = true\n references = @inner.usda@</A>) {\n}',
    ],
)
def test_a_missing_layer_is_one_line_with_its_name(
    tmp_path: Path, body: str, capfd: pytest.CaptureFixture[str]
) -> None:
    write_usda(tmp_path, 'def Xform "A" {\ndef Mesh "m" (references = @gone.usda@</X>) {\n}\n}', name="inner.usda")
    with pytest.raises(InputError, match=r"stage\.usda: .*gone\.usda.*</[aA]") as caught:
        read(tmp_path, f'{body}\ndef Cube "c" {{\n}}')
    assert "\n" not in str(caught.value)
    assert capfd.readouterr().err == ""


def test_layers_in_other_units_are_told_with_the_size_they_give(tmp_path: Path) -> None:
    write_usda(tmp_path, f'def Mesh "m" {{\n{CUBE}\n}}', 'metersPerUnit = 0.01\n upAxis = "Y"', name="inner.usda")
    scene = read(tmp_path, 'def "a" (references = @inner.usda@</m>) {\n}')
    assert any("1 layers are in units of 0.01 m within a stage of 1 m" in warning for warning in scene.warnings)
    assert any("1 layers have Y up within a stage with Z up" in warning for warning in scene.warnings)
    assert any("the scene measures 2 x 2 x 2 m" in warning for warning in scene.warnings)
