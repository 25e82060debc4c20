"""Levels of targets over mirrors against the two-ray model in closed form, and the sum over a small face.

The closed form is written here from Fresnel's equations and lengths alone. It shares with what it judges
the scene's classes alone.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from mirrored_scenes import (
    ASPHALT,
    METAL,
    WAVELENGTH_M,
    echoes,
    fresnel,
    ground,
    level_db,
    point,
)
from numpy.typing import NDArray

from datafactory.frame.measurement import object_targets
from datafactory.paths.table import SPECULAR, TARGET, ScatteredPaths
from datafactory.scenes.materials.table import Material
from datafactory.scenes.poses import Pose
from datafactory.scenes.scene import SceneObject
from shared.radar import Radar

pytestmark = pytest.mark.usefixtures("variant")


def two_rays_db(material: Material, range_m: NDArray, radar_m: float, target_m: float, polarization: str) -> NDArray:
    """Level of a target of 0 dBsm over a smooth or rough plane by the two-ray model, one-way fields squared [dB]."""
    direct = np.hypot(range_m, target_m - radar_m)
    bounced = np.hypot(range_m, target_m + radar_m)
    gamma = fresnel(material, (target_m + radar_m) / bounced, polarization)
    gamma = gamma * np.sqrt(1.0 - material.scattering_coefficient**2)
    wavenumber = 2.0 * np.pi / WAVELENGTH_M
    field = np.exp(-1j * wavenumber * direct) / direct + gamma * np.exp(-1j * wavenumber * bounced) / bounced
    return 20.0 * np.log10(WAVELENGTH_M / (4.0 * np.pi) ** 1.5 * np.abs(field) ** 2)


def swept(of: str, range_m: NDArray, radar_m: float, target_m: float, polarization: str) -> NDArray:
    """Level over range of what is traced [dB]; all targets stand in one scene, told by their number."""
    targets = [replace(point((x, 0.0, target_m)), name=f"{k}") for k, x in enumerate(range_m)]
    pair = (polarization, polarization)
    paths, table = echoes([ground(of)], targets, Pose((0.0, 0.0, radar_m)), polarization=pair)
    first = len(table.objects) - len(targets)
    return np.array([level_db(paths.take(paths.object_index == first + k)) for k in range(len(targets))])


@pytest.mark.parametrize("polarization", ["V", "H"])
@pytest.mark.parametrize("of", ["mirror", "asphalt"])
def test_the_lobes_over_range_are_those_of_the_two_ray_model(of: str, polarization: str) -> None:
    # 24 places for each lobe at 15 m, where they are closest.
    range_m = np.linspace(15.0, 60.0, 1000)
    spread_db = 40.0 * np.log10(range_m)
    found = swept(of, range_m, 0.5, 0.8, polarization) + spread_db
    expected = two_rays_db(METAL if of == "mirror" else ASPHALT, range_m, 0.5, 0.8, polarization) + spread_db
    # In a null the level is the difference of two nearly equal numbers: down to 40 dB below a peak it is compared.
    compared = expected > expected.max() - 40.0
    assert compared.mean() > 0.9
    np.testing.assert_allclose(found[compared], expected[compared], atol=0.1 if of == "mirror" else 0.5)

    def turns(levels: NDArray, sign: float) -> NDArray:
        inner = sign * levels[1:-1]
        return 1 + np.flatnonzero((inner > sign * levels[:-2]) & (inner > sign * levels[2:]))

    for sign in (1.0, -1.0):  # peaks, nulls
        ours, theirs = turns(found, sign), turns(expected, sign)
        assert len(theirs) >= 8
        assert len(ours) == len(theirs)
        assert np.abs(ours - theirs).max() <= 1


def test_nulls_and_peaks_stand_where_skolnik_has_them() -> None:
    """Path difference 2 h_1 h_2 / R a whole number of wavelengths: peaks over metal in vertical polarisation."""
    radar_m, target_m = 0.5, 0.8
    for order in (6, 7, 8, 9):
        peak_m, null_m = (2.0 * radar_m * target_m / (n * WAVELENGTH_M) for n in (order, order + 0.5))
        free_db, peak_db, null_db = (
            40.0 * np.log10(r) + level for r, level in (
                (1.0, 20.0 * np.log10(WAVELENGTH_M / (4.0 * np.pi) ** 1.5)),
                (peak_m, swept("mirror", np.array([peak_m]), radar_m, target_m, "V")[0]),
                (null_m, swept("mirror", np.array([null_m]), radar_m, target_m, "V")[0]),
            )
        )  # fmt: skip
        # F^4 = 16 less what metal of 1e7 S/m takes near its Brewster angle, 0.01 deg.
        gamma = abs(fresnel(METAL, np.array(1.3 / peak_m), "V"))
        assert peak_db - free_db == pytest.approx(40.0 * np.log10(1.0 + gamma), abs=0.05)
        assert peak_db - free_db > 11.7
        assert null_db - free_db < -20.0


def test_four_paths_each_with_its_own_length_and_bounces() -> None:
    paths, table = echoes([ground()], [point((12.0, 3.0, 0.7))], Pose((0.0, 0.0, 0.5)))
    assert sorted(paths.depth.tolist()) == [1, 2, 2, 3]
    assert all(kinds == (TARGET if depth == 1 else TARGET | SPECULAR)
               for depth, kinds in zip(paths.depth, paths.kinds, strict=True))  # fmt: skip
    direct, bounced = np.sqrt(144.0 + 9.0 + 0.04), np.sqrt(144.0 + 9.0 + 1.44)
    expected = {1: direct, 2: 0.5 * (direct + bounced), 3: bounced}
    for depth, length in zip(paths.depth, paths.range_m(), strict=True):
        assert length == pytest.approx(expected[int(depth)], abs=1e-12)
    assert [name for name in np.array(table.objects)[paths.object_index]] == ["post"] * 4
    assert (table.counts["target_mirrors"], table.counts["target_mirrors_too_wide"]) == (1, 0)
    # The list of targets names each once, where it really stands.
    assert len(object_targets(table, len(table.objects) - 1, Radar())) == 1


@pytest.mark.parametrize(
    ("settings", "bounced"),
    [({"depth": 1}, 0), ({"specular": False}, 0), ({"depth": 3}, 3), ({"point_targets": False}, -1)],
)
def test_the_bounce_needs_second_bounces_mirrors_and_targets(settings: dict[str, object], bounced: int) -> None:
    paths, _ = echoes([ground()], [point((12.0, 3.0, 0.7))], Pose((0.0, 0.0, 0.5)), **settings)
    assert len(paths) == 1 + bounced


def test_no_mirror_below_changes_nothing() -> None:
    """The same bytes with a ground that ends before the point of reflection, and with second bounces off."""
    targets, pose = [point((20.0, 0.0, 0.5))], Pose((0.0, 0.0, 0.5))
    short = ground(x=(-5.0, 9.99))  # the wave is reflected at 10 m
    with_bounces, table = echoes([short], targets, pose)
    without, _ = echoes([short], targets, pose, depth=1)
    assert table.counts["target_mirrors"] == 0
    for name in ScatteredPaths.__dataclass_fields__:
        assert getattr(with_bounces, name).tobytes() == getattr(without, name).tobytes()


@pytest.mark.parametrize(("end_m", "share"), [(10.0, 0.5), (400.0, 1.0)])
def test_a_face_reflects_with_the_share_of_its_size(end_m: float, share: float) -> None:
    paths, _ = echoes([ground(x=(-400.0, end_m))], [point((20.0, 0.0, 0.5))], Pose((0.0, 0.0, 0.5)))
    gamma = abs(fresnel(METAL, np.array(1.0 / np.sqrt(401.0)), "V"))
    whole = WAVELENGTH_M / (4.0 * np.pi) ** 1.5 / 401.0 * gamma**2
    twice = abs(paths.amplitude[paths.depth == 3][0])
    assert twice == pytest.approx(share**2 * whole, rel=0.03)


@pytest.mark.parametrize(
    ("along", "across"), [((-0.5, 0.5), (-0.06, 0.06)), ((-2.0, 0.3), (-0.2, 0.05)), ((-0.3, 0.2), (-0.02, 0.05))]
)
def test_a_small_face_reflects_what_the_sum_over_its_surface_does(
    along: tuple[float, float], across: tuple[float, float]
) -> None:
    """The slow reference: Kirchhoff's integral over the face, cell by cell, one way and both."""
    radar, place, centre = np.array([0.0, 0.0, 2.0]), np.array([24.0, 0.0, 4.0]), np.array([8.0, 0.0, 0.0])
    patch = ground(x=(8.0 + along[0], 8.0 + along[1]), y=across)
    paths, _ = echoes([patch], [point(tuple(place))], Pose(tuple(radar)))
    direct = abs(paths.amplitude[paths.depth == 1][0])
    twice = paths.amplitude[paths.depth == 3][0]
    x = centre[0] + np.linspace(*along, 3001)[:, None]
    y = np.linspace(*across, 601)[None, :]
    before, after = (np.sqrt((x - end[0]) ** 2 + y**2 + end[2] ** 2) for end in (radar, place))
    straight = np.hypot(24.0, 6.0)
    # (cos / lambda) int exp(-jk (r1 + r2)) / (r1 r2) dA over exp(-jk R) / R; an infinite plane has -j.
    cosine = 6.0 / straight
    waves = np.exp(-2j * np.pi * (before + after - straight) / WAVELENGTH_M) / (before * after)
    field = 1j * cosine / WAVELENGTH_M * straight * np.trapezoid(np.trapezoid(waves, y[0], axis=1), x[:, 0])
    gamma = fresnel(METAL, np.array(cosine), "V")
    free = direct * (24.0**2 + 4.0) / straight**2
    expected = np.conj((gamma * field) ** 2) * free
    # F fades edges over four Fresnel radii and takes lengths to second order: 2 % one way.
    assert abs(twice / expected - 1.0) < 0.05


@pytest.mark.parametrize("polarization", ["V", "H"])
def test_a_wall_beside_is_a_ground_in_the_other_polarisation(polarization: str) -> None:
    """For a wall the field along z is across the plane of incidence: V has the lobes that H has above ground."""
    wall = SceneObject(
        "wall", np.array([(-400.0, -0.5, -400.0), (400.0, -0.5, -400.0), (400.0, -0.5, 400.0), (-400.0, -0.5, 400.0)]),
        np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32), "asphalt",
    )  # fmt: skip
    other = {"V": "H", "H": "V"}[polarization]
    for range_m in (15.0, 15.3, 15.6, 40.0):
        target = [point((range_m, 0.3, 0.0))]
        paths, _ = echoes([wall], target, Pose((0.0, 0.0, 0.0)), polarization=(polarization, polarization))
        expected = two_rays_db(ASPHALT, np.array([range_m]), 0.5, 0.8, other)[0]
        assert level_db(paths) == pytest.approx(expected, abs=0.05)


def test_a_target_on_the_ground_is_doubled() -> None:
    for height_m in (0.0, 1e-9, 1e-5):
        paths, _ = echoes([ground()], [point((15.0, 0.0, height_m))], Pose((0.0, 0.0, 0.5)))
        assert sorted(paths.depth.tolist()) == [1, 2, 2, 3]
        free = 20.0 * np.log10(WAVELENGTH_M / (4.0 * np.pi) ** 1.5 / (225.25))
        gamma = abs(fresnel(METAL, np.array(0.5 / np.sqrt(225.25)), "V"))
        assert level_db(paths) - free == pytest.approx(40.0 * np.log10(1.0 + gamma), abs=0.02)


@pytest.mark.parametrize("height_m", [-0.4, -0.004])
def test_a_sensor_below_the_ground_sees_no_bounce(height_m: float) -> None:
    paths, table = echoes([ground()], [point((15.0, 0.0, 0.7))], Pose((0.0, 0.0, height_m)))
    assert len(paths) == 0
    assert table.counts["point_targets_hidden"] == 1


def test_a_sensor_in_a_hollow_sees_over_the_edge_without_a_bounce() -> None:
    """The ground begins 3 m ahead, above the sensor: its lower side reflects, its upper side cannot."""
    paths, _ = echoes([ground(x=(3.0, 50.0))], [point((15.0, 0.0, 1.5))], Pose((0.0, 0.0, -0.1)), diffraction=False)
    assert set(paths.depth.tolist()) <= {1}
