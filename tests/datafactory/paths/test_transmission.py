"""Slabs against a transfer matrix of 40 digits and against Sionna; panes on the way to a point."""

import mpmath
import numpy as np
import pytest
from sionna_scenes import (
    FREQUENCY_HZ,
    WAVELENGTH_M,
    channel,
    plate,
    scene_of,
    sionna_scene,
    slab_reflection,
    slab_transmission,
    view_of,
)
from town_scenes import box

from datafactory.paths.geometry import clear_between
from datafactory.paths.slabs import Slabs
from datafactory.paths.view import panes_between, polarization_axis
from datafactory.scenes.materials.table import load_materials

pytestmark = pytest.mark.usefixtures("variant")

VACUUM = 8.854_187_8128e-12
COSINES = np.array([1.0, 0.9, 0.6, 0.3, 0.05])


def transfer_matrix(permittivity: float, conductivity: float, thickness: float, cosine: float, polarization: str):
    """Transmission and reflection of the tangential electric field: Born and Wolf 1.6.2, in 40 digits."""
    with mpmath.workdps(40):
        eta = mpmath.mpc(permittivity, -conductivity / (2 * mpmath.pi * FREQUENCY_HZ * VACUUM))
        wavenumber = 2 * mpmath.pi * FREQUENCY_HZ / 299_792_458
        cosine = mpmath.mpf(cosine)
        within = mpmath.sqrt(eta - 1 + cosine**2)
        outside, inside = (cosine, within) if polarization == "te" else (1 / cosine, eta / within)
        phase = wavenumber * thickness * within
        matrix = mpmath.matrix(
            [
                [mpmath.cos(phase), 1j * mpmath.sin(phase) / inside],
                [1j * inside * mpmath.sin(phase), mpmath.cos(phase)],
            ]
        )
        front = (matrix[0, 0] + matrix[0, 1] * outside) * outside
        back = matrix[1, 0] + matrix[1, 1] * outside
        return complex(2 * outside / (front + back)), complex((front - back) / (front + back))


@pytest.mark.parametrize(
    ("permittivity", "conductivity", "thickness"),
    [(6.31, 1.211, 0.006), (2.19, 0.032, 0.003), (5.24, 1.381, 0.02), (1.0, 1e7, 1e-7), (0.5, 0.0, 0.004)],
    ids=["glass", "bumper", "concrete", "metal film", "plasma"],
)
def test_a_slab_is_its_transfer_matrix(permittivity, conductivity, thickness):
    transmitted = slab_transmission(permittivity, conductivity, thickness, FREQUENCY_HZ, COSINES)
    reflected = slab_reflection(permittivity, conductivity, thickness, FREQUENCY_HZ, COSINES)
    for index, polarization in enumerate(("te", "tm")):
        exact = [transfer_matrix(permittivity, conductivity, thickness, cosine, polarization) for cosine in COSINES]
        sign = 1.0 if polarization == "te" else -1.0  # of the magnetic field, which TM counts
        np.testing.assert_allclose(transmitted[index], [t for t, _ in exact], rtol=1e-8, atol=1e-15)
        np.testing.assert_allclose(reflected[index], [sign * r for _, r in exact], rtol=1e-8, atol=1e-12)


def test_thick_lossy_walls_swallow_everything_and_nothing_overflows():
    for material in load_materials().materials.values():
        values = slab_transmission(
            material.relative_permittivity, material.conductivity_s_per_m, 50.0, FREQUENCY_HZ, np.array([1.0, 1e-6])
        )
        assert np.all(np.isfinite(values))
        if material.conductivity_s_per_m > 0.1:
            assert np.all(np.abs(values) < 1e-30)


def far_pane(of: str, name: str = "pane", x: float = 5.0):
    """A sheet 40 m wide across the x axis, turned by 30 deg about z."""
    return plate(name, (x, 0.0, 0.0), (-10.0, 17.32, 0.0), (0.0, 0.0, 20.0), of)


def crossed(objects, points, polarization="V", **options):
    return panes_between(view_of(scene_of(*objects)), np.array(points, dtype=float), polarization, **options)


@pytest.mark.parametrize("polarization", ["V", "H"])
def test_one_pane_is_sionnas_refraction(polarization):
    """Amplitude and phase to 1e-3: Sionna works in float32, and has the pane on top of the air, not in its place."""
    point = (11.0, 3.0, 4.0)
    (through, kinds), (free, none) = (
        channel(
            sionna_scene(scene_of(far_pane("glass", x=x))), (0.0, 0.0, 0.0), point, polarization, los=True, **refract
        )
        for x, refract in ((5.0, {"refraction": True}), (-50.0, {}))
    )
    assert (len(through), len(free)) == (1, 1)
    assert (kinds == 4).any()
    assert not none.any()
    theirs = through[0] / free[0]
    ours = crossed([far_pane("glass")], [point], polarization)
    cosine = abs(np.dot(point, [np.cos(np.pi / 6.0), 0.5, 0.0])) / np.linalg.norm(point)
    replaced = np.exp(2j * np.pi / WAVELENGTH_M * 0.006 * cosine)
    assert np.conj(ours[0]) / replaced == pytest.approx(theirs, abs=1e-3)


def test_crossings_multiply_and_points_before_a_pane_see_none():
    panes = [far_pane("glass"), far_pane("glass", "second", 8.0)]
    points = [(4.0, 0.0, 0.0), (6.5, 0.0, 0.0), (20.0, 0.0, 0.0), (-7.0, 1.0, 0.5)]
    result = crossed(panes, points)
    np.testing.assert_allclose(result[[0, 3]], 1.0, rtol=1e-14)
    assert result[2] == pytest.approx(result[1] ** 2, rel=1e-6)
    assert abs(result[1]) < 0.9


@pytest.mark.parametrize(("name", "heard"), [("glass", True), ("wood", True), ("marble", False), ("concrete", False)])
def test_surfaces_are_heard_through_what_takes_less_than_60_db_out_and_back(name, heard):
    slab = load_materials().materials[name]
    one_way, _ = transfer_matrix(slab.relative_permittivity, slab.conductivity_s_per_m, slab.thickness_m, 1.0, "te")
    assert (40.0 * np.log10(abs(one_way)) > -60.0) == heard
    assert Slabs([slab], FREQUENCY_HZ).lets_through[0] == heard


def test_a_box_is_two_panes_and_one_diagonal_is_not_crossed_twice():
    """The ray along x meets the diagonal that the two triangles of each side share."""
    points = [(9.0, 0.0, 0.0), (90.0, 0.3, 0.2)]
    result = crossed([box("case", (5.0, -2.0, -2.0), (5.006, 2.0, 2.0), "glass")], points)
    square = ((0.0, 2.0, 0.0), (0.0, 0.0, 2.0), "glass")
    one = crossed([plate("pane", (5.0, 0.0, 0.0), *square)], points)
    np.testing.assert_allclose(result, one**2, rtol=1e-6)


def test_panes_close_together_far_away_are_crossed_once_each():
    """The ray caster's error at 23 m is a fortieth of the gaps."""
    sides, points = ((0.0, 2.0, 0.0), (0.0, 0.0, 2.0), "glass"), [(30.0, 0.1, 0.2)]
    panes = [plate(f"pane-{n}", (23.0 + 0.02 * n, 0.0, 0.0), *sides) for n in range(4)]
    np.testing.assert_allclose(crossed(panes, points), crossed(panes[:1], points) ** 4, rtol=1e-5)


def test_what_lies_behind_too_many_panes_is_given_up():
    panes = [far_pane("air", f"pane-{index}", 3.0 + index) for index in range(5)]
    result = crossed(panes, [(20.0, 0.0, 0.0), (4.5, 0.0, 0.0)], maximum_crossings=4)
    assert result[0] == 0.0
    assert result[1] == pytest.approx(1.0, abs=1e-9)


def test_sight_is_blocked_by_what_stands_between_and_by_nothing_else():
    scene = sionna_scene(scene_of(plate("wall", (5.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), "metal"))).mi_scene
    start = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 3.0, 0.0], [5.0, 0.5, 0.5]])
    end = np.array([[9.0, 0.0, 0.0], [5.0, 0.0, 0.0], [4.0, 0.0, 0.0], [9.0, 3.0, 0.0], [9.0, 0.5, 0.5]])
    np.testing.assert_array_equal(clear_between(scene, start, end), [False, True, True, True, True])


def test_the_polarisation_axes_are_the_spherical_unit_vectors():
    direction = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.6, 0.0, 0.8], [0.0, 0.0, 1.0]])
    vertical, horizontal = polarization_axis(direction, "V"), polarization_axis(direction, "H")
    np.testing.assert_allclose(vertical[:2], [[0.0, 0.0, -1.0], [0.0, 0.0, -1.0]])
    np.testing.assert_allclose(horizontal[:2], [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    np.testing.assert_allclose(np.cross(vertical, horizontal), direction, atol=1e-15)
