"""Powers of one trace against closed forms: mirror images, the radar integral; and Sionna's own channel."""

from __future__ import annotations

import numpy as np
import pytest
from oracles import mirror_path, mirrored
from traced_walls import (
    FREQUENCY_HZ,
    SCATTERING,
    WAVELENGTH_M,
    WholeSphere,
    decibels,
    power,
    rectangle,
    side_wall,
    solved,
    traced,
    wall,
)

from datafactory.paths.rays import RayFan
from datafactory.synthesis.cube import cube_of_paths
from shared.radar import Radar
from shared.radar.arrays import AntennaArray
from shared.radar.waveform import Waveform

pytestmark = pytest.mark.usefixtures("variant")


def test_a_wall_returns_the_image_source_amplitude():
    table = traced(wall("mirror"))
    assert (len(table.specular), len(table.scattered)) == (1, 0)
    # The image of the TX stands 2 R away: lambda / (4 pi 2 R).
    assert np.abs(table.specular.amplitude[0]) == pytest.approx(WAVELENGTH_M / (4.0 * np.pi * 20.0), rel=1e-3)
    np.testing.assert_allclose(table.specular.image[0], [20.0, 0.0, 0.0], atol=1e-4)
    np.testing.assert_allclose(table.specular.axes[0], np.diag([-1.0, 1.0, 1.0]), atol=1e-6)
    assert table.objects[table.specular.object_index[0]] == "wall"


def test_a_dielectric_wall_returns_its_reflection_coefficient():
    table = traced(wall("concrete"))
    epsilon = 5.24 - 1j * 1.38 / (2.0 * np.pi * FREQUENCY_HZ * 8.8541878128e-12)
    gamma = abs((1.0 - np.sqrt(epsilon)) / (1.0 + np.sqrt(epsilon)))  # 0.1 m of concrete swallow what enters
    assert np.abs(table.specular.amplitude[0]) == pytest.approx(gamma * WAVELENGTH_M / (4.0 * np.pi * 20.0), rel=1e-3)


def test_what_scatters_is_missing_from_the_mirror():
    smooth, rough = traced(wall("mirror")), traced(wall("rough"))
    assert power(rough.specular) / power(smooth.specular) == pytest.approx(1.0 - SCATTERING**2, rel=1e-3)


def lambertian_plane(distance_m: float) -> float:
    """Power from an infinite Lambertian plane of metal, isotropic antennas, unit transmit power.

    sigma0 = 4 S^2 cos(theta)^2; lambda^2 / (4 pi)^3 times its integral over dA / R^4 is lambda^2 S^2 / (32 pi^2 h^2).
    """
    return WAVELENGTH_M**2 * SCATTERING**2 / (32.0 * np.pi**2 * distance_m**2)


@pytest.mark.parametrize(("rays", "offset"), [(5_000, (0.37, 0.81)), (80_000, (0.0, 0.0))])
def test_a_rough_wall_returns_the_radar_integral(rays, offset):
    table = traced(wall("rough"), rays=rays, fan=RayFan(rays, offset))
    assert decibels(power(table.scattered) / lambertian_plane(10.0)) == pytest.approx(0.0, abs=0.15)


def test_the_fan_leaves_sionna_as_it_was():
    from sionna.rt.path_solvers import sb_candidate_generator, sb_deterministic
    from sionna.rt.utils import fibonacci_lattice

    traced(wall("rough"), rays=1000)
    assert sb_candidate_generator.fibonacci_lattice is fibonacci_lattice
    assert sb_deterministic.fibonacci_lattice is fibonacci_lattice


@pytest.mark.parametrize(
    "settings",
    [
        {"depth": 1, "specular": False},
        {"depth": 2, "specular": True, "diffuse": False},
    ],
)
def test_the_channel_agrees_with_sionnas_impulse_response(settings):
    # Without paths that we drop, add or draw. One TX/RX pair, one chirp; at mid-sweep s[N/2] is the sum of conj(a_b).
    rays = 3_000
    scene = (wall("rough", half_m=8.0), side_wall("rough"))
    fan = WholeSphere(rays)
    settings = {**settings, "finite_mirrors": False, "surface_phase": False}
    a, _ = solved(*scene, fan=fan, rays=rays, **settings).cir(normalize_delays=False, out_type="numpy")
    table = traced(*scene, fan=fan, rays=rays, **settings)
    assert len(table) == np.count_nonzero(a) > 0
    radar = Radar(
        waveform=Waveform(chirps=1, samples=64, range_bins=64),
        array=AntennaArray(tx_m=((0.0, 0.0, 0.0),), rx_m=((0.0, 0.0, 0.0),)),
    )
    ours = cube_of_paths(table, radar)[0, 32, 0]
    # tau is a float32: at 30 m round trip 4e-15 s, 2e-3 rad a path.
    assert abs(ours - np.conj(a.sum())) < 5e-3 * np.sqrt(np.sum(np.abs(a) ** 2))


def by_kind(paths) -> dict[tuple[int, ...], float]:
    """Power of the solver's valid paths by their sequence of bounces."""
    valid = paths.valid.numpy().reshape(-1)
    bounces = np.moveaxis(paths.interactions.numpy()[:, 0, 0], 0, 1)[valid]
    real, imaginary = (part.numpy().reshape(-1)[valid] for part in paths.a)
    result: dict[tuple[int, ...], float] = {}
    for bounce, value in zip(bounces, real**2 + imaginary**2, strict=True):
        kind = tuple(int(b) for b in bounce if b)
        result[kind] = result.get(kind, 0.0) + float(value)
    return result


def test_diffuse_then_specular_is_wrong_in_sionna_and_mended_here():
    scene = (wall("rough", half_m=8.0), side_wall("mirror"))
    specular_diffuse, diffuse_specular = (1, 2), (2, 1)
    few, many = (by_kind(solved(*scene, fan=WholeSphere(n), rays=n, depth=2)) for n in (20_000, 320_000))
    # Mirror first: the same power with 16 times the rays. Mirror last: by reciprocity as much, but it falls as 1/N.
    assert decibels(many[specular_diffuse] / few[specular_diffuse]) == pytest.approx(0.0, abs=0.3)
    assert decibels(many[diffuse_specular] / few[diffuse_specular]) < -6.0
    table = traced(*scene, fan=WholeSphere(320_000), rays=320_000, depth=2)
    paths = table.scattered.take(table.scattered.depth == 2)
    first = paths.take(np.arange(len(paths)) < len(paths) // 2)
    second = paths.take(np.arange(len(paths)) >= len(paths) // 2)
    # Both directions of every path, one after the other, and together twice the power that the mirror-first ones have.
    np.testing.assert_array_equal(first.tx_point, second.rx_point)
    np.testing.assert_array_equal(first.rx_point, second.tx_point)
    np.testing.assert_array_equal(first.amplitude, second.amplitude)
    assert power(paths) == pytest.approx(2.0 * many[specular_diffuse], rel=1e-4)
    # The TX sees the point behind the side wall at y = 6, the RX sees it where it is.
    np.testing.assert_allclose(first.tx_point, first.rx_point * [1, -1, 1] + [0, 12, 0], atol=1e-3)


def test_two_mirrors_show_their_images():
    # 70 deg between the walls (a right angle sends the radar's own echo through the very edge); both orders of bounces.
    slope = np.array([-np.sin(np.radians(70.0)), -np.cos(np.radians(70.0)), 0.0])
    corner = np.array([10.0, 6.0, 0.0])
    ahead = rectangle("ahead", (10.0, -4.0, 0.0), (0.0, 10.0, 0.0), (0.0, 0.0, 10.0), "mirror")
    side = rectangle("side", tuple(corner + 10.0 * slope), tuple(10.0 * slope), (0.0, 0.0, 10.0), "mirror")
    planes = [(corner, np.array([1.0, 0.0, 0.0])), (corner, np.cross(slope, [0.0, 0.0, 1.0]))]
    origin = np.zeros(3)
    images = [mirrored(mirrored(origin, one), other) for one, other in (planes, planes[::-1])]
    table = traced(ahead, side, depth=2, diffuse=False)
    double = table.specular.take(table.specular.depth == 2)
    assert len(double) == 2
    order = np.argsort(double.image[:, 1])
    np.testing.assert_allclose(double.image[order], sorted(images, key=lambda image: image[1]), atol=1e-3)
    length = mirror_path(origin, origin, planes)[0]
    np.testing.assert_allclose(np.abs(double.amplitude), WAVELENGTH_M / (4.0 * np.pi * length), rtol=2e-3)
    # The pair is reciprocal: the image that one order shows departs where the other's arrives.
    np.testing.assert_allclose(double.departure(), double.image[::-1], atol=1e-3)
