"""One trace against electromagnetics: mirror images, the radar integral, reciprocity, motion; and Sionna's own channel.

Walls are of metal (|reflection coefficient| = 1 at every angle), so that powers have closed forms.
"""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest
from numpy.typing import NDArray
from oracles import mirror_path, mirrored

from datafactory.paths import solver as solver_module
from datafactory.paths.merged_scene import merge_scene
from datafactory.paths.rays import RayFan
from datafactory.paths.solver import TraceSettings
from datafactory.paths.table import PathTable
from datafactory.paths.trace import trace
from datafactory.scenes.materials.table import Material, MaterialMapping
from datafactory.scenes.poses import Pose
from datafactory.scenes.scene import Scene, SceneObject
from datafactory.synthesis.cube import cube_of_paths
from shared.radar import FrontEnd, Radar
from shared.radar.antenna import IsotropicPattern
from shared.radar.arrays import AntennaArray
from shared.radar.waveform import Waveform
from shared.signal.spectrum import range_doppler

pytestmark = pytest.mark.usefixtures("variant")

FREQUENCY_HZ = 77.5e9
WAVELENGTH_M = 299_792_458.0 / FREQUENCY_HZ
RADAR_AT_ORIGIN = Pose((0.0, 0.0, 0.0))
SCATTERING = 0.6


def material(name: str, **changes: object) -> Material:
    properties: dict[str, object] = {
        "relative_permittivity": 1.0,
        "conductivity_s_per_m": 1e7,
        "thickness_m": 0.1,
        "scattering_coefficient": 0.0,
        "pattern": "lambertian",
        "source": "test",
        "valid_ghz": (77.0, 78.0),
        "assumptions": (),
    }
    return Material(name=name, **{**properties, **changes})  # type: ignore[arg-type]


MATERIALS = MaterialMapping(
    entries={
        "mirror": (material("mirror"), "test"),
        "rough": (material("rough", scattering_coefficient=SCATTERING), "test"),
        "concrete": (material("concrete", relative_permittivity=5.24, conductivity_s_per_m=1.38), "test"),
    },
    unknown=(),
)


def rectangle(
    name: str, centre: tuple[float, float, float], across: tuple, up: tuple, of: str, velocity=(0.0, 0.0, 0.0)
) -> SceneObject:
    """A flat rectangle, centre +- across +- up [m]."""
    middle, a, b = np.array(centre), np.array(across, dtype=float), np.array(up, dtype=float)
    vertices = np.array([middle - a - b, middle + a - b, middle + a + b, middle - a + b])
    return SceneObject(name, vertices, np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32), of, velocity)


def wall(
    of: str, distance_m: float = 10.0, half_m: float = 300.0, velocity=(0.0, 0.0, 0.0), name="wall"
) -> SceneObject:
    return rectangle(name, (distance_m, 0.0, 0.0), (0.0, half_m, 0.0), (0.0, 0.0, half_m), of, velocity)


def side_wall(of: str, name="side") -> SceneObject:
    return rectangle(name, (10.0, 6.0, 0.0), (10.0, 0.0, 0.0), (0.0, 0.0, 10.0), of)


def traced(
    *objects: SceneObject,
    pose: Pose = RADAR_AT_ORIGIN,
    fan: RayFan | None = None,
    rays: int = 20_000,
    seed: int = 1,
    **settings,
) -> PathTable:
    merged = merge_scene(Scene("test", objects), MATERIALS)
    chosen = TraceSettings(rays=rays, **{"depth": 1, "paths_a_cell": 0, "solver_share": 1, **settings})
    return trace(merged, MATERIALS, pose, FREQUENCY_HZ, chosen, fan or RayFan(rays), seed)


def solved(*objects: SceneObject, fan: RayFan, rays: int, **settings):
    """The solver's own Paths of the same trace."""
    merged = merge_scene(Scene("test", objects), MATERIALS)
    chosen = TraceSettings(rays=rays, **settings)
    scene = solver_module.radio_scene(merged, MATERIALS, RADAR_AT_ORIGIN, FREQUENCY_HZ, chosen)
    return solver_module.solver_paths(scene, chosen, fan, 1)


class WholeSphere(RayFan):
    """Sionna's own lattice, each ray standing for 4 pi / N."""

    aimable = False

    def unit_square(self) -> NDArray[np.float64]:
        from sionna.rt.utils import fibonacci_lattice

        return fibonacci_lattice(self.count).numpy().T.astype(np.float64)

    def solid_angle_ratio(self, directions: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.ones(len(directions))


def power(paths) -> float:
    return float(np.sum(np.abs(paths.amplitude) ** 2))


def decibels(ratio: float) -> float:
    return float(10.0 * np.log10(ratio))


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


def test_specular_paths_are_followed_only_when_asked():
    assert len(traced(wall("mirror"), specular=False)) == 0
    assert len(traced(wall("rough"), specular=False).specular) == 0
    assert len(traced(wall("rough"), diffuse=False).scattered) == 0


def test_what_scatters_is_missing_from_the_mirror():
    smooth, rough = traced(wall("mirror")), traced(wall("rough"))
    assert power(rough.specular) / power(smooth.specular) == pytest.approx(1.0 - SCATTERING**2, rel=1e-3)


def lambertian_plane(distance_m: float) -> float:
    """Power from an infinite Lambertian plane of metal, isotropic antennas, unit transmit power.

    sigma0 = 4 S^2 cos(theta)^2; lambda^2 / (4 pi)^3 times its integral over dA / R^4 is lambda^2 S^2 / (32 pi^2 h^2).
    """
    return WAVELENGTH_M**2 * SCATTERING**2 / (32.0 * np.pi**2 * distance_m**2)


@pytest.mark.parametrize("rays", [5_000, 20_000, 80_000])
@pytest.mark.parametrize("offset", [(0.0, 0.0), (0.37, 0.81)])
def test_a_rough_wall_returns_the_radar_integral(rays, offset):
    table = traced(wall("rough"), rays=rays, fan=RayFan(rays, offset))
    assert decibels(power(table.scattered) / lambertian_plane(10.0)) == pytest.approx(0.0, abs=0.15)


@pytest.mark.parametrize("rays", [20_000, 80_000])
def test_a_rough_road_returns_half_of_it(rays):
    # The fan looks ahead only: half of the plane 2 m below.
    road = rectangle("road", (0.0, 0.0, -2.0), (300.0, 0.0, 0.0), (0.0, 300.0, 0.0), "rough")
    table = traced(road, rays=rays)
    assert decibels(power(table.scattered) / (0.5 * lambertian_plane(2.0))) == pytest.approx(0.0, abs=0.1)


def radar_integral(panel: SceneObject, points: int = 400) -> float:
    """Power of a Lambertian parallelogram of metal by the midpoint rule: lambda^2 / (4 pi)^3 int sigma0 dA / R^4."""
    corner, first, second = (
        panel.vertices[0],
        panel.vertices[1] - panel.vertices[0],
        panel.vertices[3] - panel.vertices[0],
    )
    step = (np.arange(points) + 0.5) / points
    position = corner + step[:, None, None] * first + step[None, :, None] * second
    area = np.cross(first, second)
    range_m = np.linalg.norm(position, axis=2)
    cosine = np.abs(position @ area) / np.linalg.norm(area) / range_m
    sigma0 = 4.0 * SCATTERING**2 * cosine**2
    return float(WAVELENGTH_M**2 / (4.0 * np.pi) ** 3 * np.mean(sigma0 / range_m**4) * np.linalg.norm(area))


PANEL = rectangle("panel", (8.0, 1.0, 0.5), (1.0, 3.0, 0.0), (0.0, 0.0, 2.0), "rough")


def test_sionnas_own_lattice_returns_the_radar_integral():
    table = traced(PANEL, rays=400_000, fan=WholeSphere(400_000))
    assert decibels(power(table.scattered) / radar_integral(PANEL)) == pytest.approx(0.0, abs=0.1)


def test_the_fan_is_unbiased():
    # 1200 hits a frame leave 0.11 dB in each (measured); over 8 frames with their own offsets 0.04 dB.
    offsets = [(k / 8.0, (0.618 * k) % 1.0) for k in range(8)]
    powers = [power(traced(PANEL, rays=20_000, fan=RayFan(20_000, offset)).scattered) for offset in offsets]
    assert decibels(float(np.mean(powers)) / radar_integral(PANEL)) == pytest.approx(0.0, abs=0.1)


def test_the_fan_leaves_sionna_as_it_was():
    from sionna.rt.path_solvers import sb_candidate_generator, sb_deterministic
    from sionna.rt.utils import fibonacci_lattice

    traced(wall("rough"), rays=1000)
    assert sb_candidate_generator.fibonacci_lattice is fibonacci_lattice
    assert sb_deterministic.fibonacci_lattice is fibonacci_lattice


def table_bytes(table: PathTable) -> bytes:
    return (
        b"".join(
            np.ascontiguousarray(getattr(kind, item.name)).tobytes()
            for kind in (table.scattered, table.specular)
            for item in fields(kind)
        )
        + repr((table.objects, table.counts)).encode()
    )


def test_same_arguments_same_bytes():
    scene = (wall("rough", half_m=20.0), side_wall("rough"))
    first, again = (traced(*scene, depth=2, rays=5_000) for _ in range(2))
    assert len(first.scattered) > 1000
    assert table_bytes(first) == table_bytes(again)
    assert table_bytes(first) != table_bytes(traced(*scene, depth=2, rays=5_000, fan=RayFan(5_000, (0.1, 0.2))))


def test_the_order_in_which_the_solver_returns_paths_does_not_matter(monkeypatch):
    # On a busy machine its threads finish in another order once in a while.
    scene = (wall("rough", half_m=20.0), side_wall("rough"))
    expected = table_bytes(traced(*scene, depth=2, rays=5_000))
    bundle_of = solver_module._bundle_of

    def shuffled(*arguments):
        bundle = bundle_of(*arguments)
        return bundle.take(np.random.default_rng(1).permutation(len(bundle.amplitude)))

    monkeypatch.setattr(solver_module, "_bundle_of", shuffled)
    assert table_bytes(traced(*scene, depth=2, rays=5_000)) == expected


def test_a_scene_far_from_its_origin_loses_nothing():
    shift = np.array([5e5, -5e5, 100.0])
    scene = (wall("rough", half_m=20.0), side_wall("mirror"))
    there = tuple(SceneObject(o.name, o.vertices + shift, o.triangles, o.material) for o in scene)
    pose = Pose((1.0, 0.5, 0.2), yaw_deg=20.0)
    far = Pose((5e5 + 1.0, -5e5 + 0.5, 100.2), yaw_deg=20.0)
    one, other = (traced(*s, pose=p, depth=2, rays=5_000) for s, p in ((scene, pose), (there, far)))
    assert len(one.scattered) == len(other.scattered) > 1000
    assert len(one.specular) == len(other.specular) > 0
    np.testing.assert_allclose(one.scattered.rx_point, other.scattered.rx_point, atol=1e-4)
    np.testing.assert_allclose(one.scattered.tx_point, other.scattered.tx_point, atol=1e-4)
    np.testing.assert_allclose(one.specular.image, other.specular.image, atol=1e-4)
    np.testing.assert_allclose(np.abs(one.scattered.amplitude), np.abs(other.scattered.amplitude), rtol=1e-3)


@pytest.mark.parametrize(
    "settings",
    [
        {"depth": 1, "specular": False},
        {"depth": 2, "specular": True, "diffuse": False},
        {"depth": 3, "specular": False, "diffuse": True},
    ],
)
def test_the_channel_agrees_with_sionnas_impulse_response(settings):
    # Without paths that we drop or add. One TX/RX pair, one chirp; at mid-sweep s[N/2] is the sum of conj(a_b).
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
    assert table.counts["diffuse_then_specular_dropped"] > 0
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


def peak_velocity(table: PathTable) -> float:
    """Velocity [m/s] of the strongest range-Doppler cell."""
    waveform = Waveform(samples=128, range_bins=128, chirps=64)
    front_end = FrontEnd(tx_pattern=IsotropicPattern(), rx_pattern=IsotropicPattern())
    radar = Radar(waveform=waveform, front_end=front_end)
    spectra = range_doppler(cube_of_paths(table.illuminated(front_end), radar).astype(np.complex64), radar)
    return float(waveform.velocities_mps[(np.abs(spectra) ** 2).sum(axis=(0, 2)).argmax()])


@pytest.mark.parametrize("kind", ["mirror", "rough"])
@pytest.mark.parametrize("speed", [-6.0, 3.0])
def test_a_moving_objects_velocity_appears_in_the_doppler(kind, speed):
    table = traced(wall(kind, half_m=0.5, velocity=(speed, 0.0, 0.0)), rays=5_000)
    assert len(table) > 0
    assert peak_velocity(table) == pytest.approx(speed, abs=0.2)  # half a cell


@pytest.mark.parametrize("kind", ["mirror", "rough"])
@pytest.mark.parametrize("yaw_deg", [0.0, 90.0])
def test_driving_ahead_brings_the_wall_nearer(kind, yaw_deg):
    pose = Pose((0.0, 0.0, 0.0), yaw_deg=yaw_deg, velocity=(5.0, 0.0, 0.0) if yaw_deg == 0.0 else (0.0, 5.0, 0.0))
    ahead = wall(kind, half_m=0.5)
    if yaw_deg:
        ahead = rectangle("wall", (0.0, 10.0, 0.0), (0.5, 0.0, 0.0), (0.0, 0.0, 0.5), kind)
    table = traced(ahead, pose=pose, rays=5_000)
    assert peak_velocity(table) == pytest.approx(-5.0, abs=0.2)


def test_objects_stand_where_they_are_at_the_poses_time():
    moving = wall("mirror", velocity=(-4.0, 0.0, 0.0))
    table = traced(moving, pose=Pose((0.0, 0.0, 0.0), time_s=0.5))
    assert table.specular.range_m()[0] == pytest.approx(8.0, abs=1e-4)
    np.testing.assert_allclose(table.specular.image_velocity[0], [-8.0, 0.0, 0.0], atol=1e-4)


def test_merged_objects_keep_their_names():
    left = rectangle("left", (8.0, 2.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), "rough")
    right = rectangle("right", (8.0, -2.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), "rough")
    table = traced(right, left, rays=5_000)
    names = np.array(table.objects)[table.scattered.object_index]
    side = table.scattered.rx_point[:, 1]
    assert set(names) == {"left", "right"}
    assert (names[side > 0.0] == "left").all()
    assert (names[side < 0.0] == "right").all()


def test_an_empty_view_is_an_empty_table():
    behind = wall("rough", distance_m=-10.0)
    table = traced(behind)
    assert len(table) == 0
    assert table.counts["traced"] == table.counts["truncated"] == 0


def test_a_small_mirror_is_found_without_a_ray_on_it():
    plate = rectangle("plate", (50.0, 0.0, 0.0), (0.0, 0.01, 0.0), (0.0, 0.0, 0.01), "mirror")
    table = traced(plate, rays=10)
    assert len(table.specular) == 1
    # A plate much smaller than the Fresnel zone: sigma = 4 pi A^2 / lambda^2, so that |a| = A / (4 pi R^2).
    assert abs(table.specular.amplitude[0]) == pytest.approx(0.02**2 / (4.0 * np.pi * 50.0**2), rel=2e-3)


def test_a_foot_on_the_diagonal_of_a_quad_counts_once():
    assert len(traced(wall("mirror")).specular) == 1


def test_a_hidden_mirror_is_counted_and_not_heard():
    blind = rectangle("blind", (5.0, 0.0, 0.0), (0.3, 1.0, 0.0), (0.0, 0.0, 1.0), "concrete")
    table = traced(wall("mirror"), blind)
    assert len(table.specular) == 0
    assert table.counts["mirrors_hidden"] == 1


def test_a_moving_mirror_moves_its_image_twice_as_fast():
    table = traced(wall("mirror", velocity=(-3.0, 5.0, 0.0)), pose=Pose((0.0, 0.0, 0.0), time_s=0.5))
    np.testing.assert_allclose(table.specular.image[0], [2.0 * 8.5, 0.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(table.specular.image_velocity[0], [-6.0, 0.0, 0.0], atol=1e-9)


def test_neighbouring_poses_share_a_rough_surfaces_phases():
    # The same lattice seen 1 mm and 10 cm further: phases of the surface stay, or are drawn anew; powers stay.
    def phases(step_m: float) -> dict[tuple[float, ...], complex]:
        wide = wall("rough")  # wider than the beam, so that the same rays hit it from all three places
        pose = Pose((0.0, step_m, 0.0))
        rough, smooth = (traced(wide, pose=pose, rays=5_000, surface_phase=given) for given in (True, False))
        assert power(rough.scattered) == pytest.approx(power(smooth.scattered), rel=1e-9)
        turn = rough.scattered.amplitude / smooth.scattered.amplitude
        near = np.linalg.norm(rough.scattered.rx_point, axis=1) < 30.0  # where float32 hits agree to a millimetre
        return dict(zip(map(tuple, np.round(rough.scattered.rx_point[near], 2)), turn[near], strict=True))

    here, near, far = phases(0.0), phases(1e-3), phases(0.1)

    def kept(there: dict[tuple[float, ...], complex]) -> float:
        both = here.keys() & there.keys()
        assert len(both) > 500
        return float(np.mean([abs(here[place] - there[place]) < 1e-9 for place in both]))

    assert kept(near) > 0.9
    assert kept(far) < 0.1
