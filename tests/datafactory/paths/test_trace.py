"""One trace: names, hidden mirrors, chains, motion; powers against mirror images, the radar integral, and Sionna's."""

import numpy as np
import pytest
from numpy.typing import NDArray
from path_tables import different_columns
from sionna_scenes import AT_ORIGIN, FREQUENCY_HZ, WAVELENGTH_M, mapping, material, plate, scene_of, slabs
from sionna_scenes import traced as trace_of

from datafactory.paths import solver as solver_module
from datafactory.paths.geometry import placed
from datafactory.paths.rays import RayFan
from datafactory.paths.solver import LEAST_SOLVER_RAYS, TraceSettings
from datafactory.paths.table import REFRACTED, PathTable
from datafactory.scenes.scene import SceneObject
from datafactory.synthesis.cube import cube_of_paths
from shared.physics.units import power_to_db
from shared.radar import Radar
from shared.radar.arrays import AntennaArray
from shared.radar.waveform import Waveform

SCATTERING = 0.6
MATERIALS = mapping(
    material("mirror", 1.0, 1e7, 0.1),
    material("rough", 1.0, 1e7, 0.1, SCATTERING),
    material("concrete", 5.24, 1.38, 0.1),
)


def wall(
    of: str, distance_m: float = 10.0, half_m: float = 300.0, velocity=(0.0, 0.0, 0.0), name="wall"
) -> SceneObject:
    return plate(name, (distance_m, 0.0, 0.0), (0.0, half_m, 0.0), (0.0, 0.0, half_m), of, velocity)


def side_wall(of: str, name="side") -> SceneObject:
    return plate(name, (10.0, 6.0, 0.0), (10.0, 0.0, 0.0), (0.0, 0.0, 10.0), of)


def traced(*objects: SceneObject, **settings) -> PathTable:
    whole = {"rays": 20_000, "depth": 1, "paths_a_cell": 0, "solver_share": 1, "twice_share": 1}
    return trace_of(scene_of(*objects, materials=MATERIALS), **{**whole, **settings})


def solved(*objects: SceneObject, fan: RayFan, rays: int, **settings):
    """The solver's own Paths of the same trace."""
    merged, chosen = scene_of(*objects, materials=MATERIALS), TraceSettings(rays=rays, **settings)
    scene = solver_module.radio_scene(placed(merged, AT_ORIGIN), slabs(merged), chosen)
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


pytestmark = pytest.mark.usefixtures("variant")


def test_chains_run_both_ways():
    """A large mirror and a small one where a chain meets it: few rays find either way, and seldom both."""
    tilt, turn = np.radians([10.0, 15.0])
    large = plate("large", (10.0, 0.0, 0.0), (-8.0 * np.sin(tilt), 8.0 * np.cos(tilt), 0.0), (0.0, 0.0, 8.0), "mirror")
    small = plate("small", (6.44, 4.39, 0.0), (0.3 * np.cos(turn), 0.3 * np.sin(turn), 0.0), (0.0, 0.0, 0.3), "mirror")
    seen = []
    for number in range(12):
        fan = RayFan(200, offset=(number / 12.0, (0.618 * number) % 1.0))
        chains = traced(large, small, fan=fan, rays=200, depth=2, diffuse=False).specular
        chains = chains.take(chains.depth == 2)
        ends = chains.departure(), chains.image
        departure, arrival = (end / np.linalg.norm(end, axis=1)[:, None] for end in ends)
        apart = np.abs(departure[:, None] - arrival).max(axis=2) + np.abs(arrival[:, None] - departure).max(axis=2)
        for one, other in enumerate(apart.argmin(axis=1) if len(chains) else ()):
            assert apart[one, other] < 1e-5
            assert chains.amplitude[one] == pytest.approx(chains.amplitude[other], rel=1e-3)
        seen.append(len(chains))
    assert set(seen) == {0, 2}  # the chain and its way back, once each, or neither


def test_ways_back_that_are_there_are_not_added():
    """Of a chain, its way back, one that is its own way back, and one whose way back is missing."""
    vertices = np.array([
        [[9.0, 1.0, 0.0], [5.0, 4.0, 0.0], [0.0, 0.0, 0.0]], [[9.0, 3.0, 0.0], [5.0, 6.0, 0.0], [0.0, 0.0, 0.0]],
    ])[:, :2]  # fmt: skip
    there = np.concatenate([vertices, vertices[:1, ::-1] + 1e-3, [[[7.0, 7.0, 0.0]] * 2]])
    kinds = np.ones((4, 2), dtype=np.int64)
    triangles, amplitude = kinds * np.array([3, 4]), np.array([1.0j, 2.0j, 3.0j, 4.0j])
    bundle = solver_module.Bundle(there, kinds, triangles, kinds[:, 0], amplitude)
    both = bundle.with_reverses()
    assert len(both.vertices) == 5
    np.testing.assert_array_equal(both.vertices[4], vertices[1, ::-1])
    assert both.triangles[4].tolist() == [4, 3]
    assert both.amplitude[4] == bundle.amplitude[1]
    assert len(solver_module.Bundle.none(2).with_reverses().vertices) == 0


def test_the_order_in_which_the_solver_returns_paths_does_not_matter(monkeypatch):
    # On a busy machine its threads finish in another order once in a while.
    scene = (wall("rough", half_m=20.0), side_wall("rough"))
    expected = traced(*scene, depth=2, rays=5_000)
    bundle_of = solver_module._bundle_of

    def shuffled(*arguments):
        bundle = bundle_of(*arguments)
        return bundle.take(np.random.default_rng(1).permutation(len(bundle.amplitude)))

    monkeypatch.setattr(solver_module, "_bundle_of", shuffled)
    found = traced(*scene, depth=2, rays=5_000)
    assert different_columns(found, expected) == []
    assert (found.objects, found.counts) == (expected.objects, expected.counts)


def test_merged_objects_keep_their_names():
    left = plate("left", (8.0, 2.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), "rough")
    right = plate("right", (8.0, -2.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), "rough")
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
    small = plate("plate", (50.0, 0.0, 0.0), (0.0, 0.01, 0.0), (0.0, 0.0, 0.01), "mirror")
    table = traced(small, rays=10)
    assert len(table.specular) == 1
    # A plate much smaller than the Fresnel zone: sigma = 4 pi A^2 / lambda^2, so that |a| = A / (4 pi R^2).
    assert abs(table.specular.amplitude[0]) == pytest.approx(0.02**2 / (4.0 * np.pi * 50.0**2), rel=2e-3)


def test_a_hidden_mirror_is_counted_and_not_heard():
    blind = plate("blind", (5.0, 0.0, 0.0), (0.3, 1.0, 0.0), (0.0, 0.0, 1.0), "concrete")
    table = traced(wall("mirror"), blind)
    assert len(table.specular) == 0
    assert table.counts["mirrors_hidden"] == 1


AHEAD_M, BEHIND_M = 10.0, 6.0
THERE_AND_BACK_M = 2.0 * AHEAD_M + 2.0 * (AHEAD_M + BEHIND_M)
"""From the radar to the wall ahead, to that behind, ahead again, and home."""
WALLS = (wall("mirror", AHEAD_M), wall("mirror", -BEHIND_M, name="behind"))


@pytest.mark.parametrize(
    ("depth", "settings"), [(2, {}), (2, {"diffuse": False}), (3, {"refraction": True}), (3, {"solver_share": 1})]
)
def test_three_mirrors_are_followed_from_two_bounces_on(depth, settings):
    found = traced(*WALLS, depth=depth, **settings).specular
    third = found.take(found.depth == 3)
    assert len(third) == 1
    assert np.linalg.norm(third.image[0]) == pytest.approx(THERE_AND_BACK_M, rel=1e-6)
    assert abs(third.amplitude[0]) == pytest.approx(WAVELENGTH_M / (4.0 * np.pi * THERE_AND_BACK_M), rel=1e-2)
    assert found.depth.max() == 3


def test_what_is_scattered_keeps_to_the_bounces_asked_for():
    rough = (wall("rough", AHEAD_M), plate("side", (5.0, 6.0, 0.0), (5.0, 0.0, 0.0), (0.0, 0.0, 9.0), "rough"))
    one, two, three = (traced(*rough, WALLS[1], depth=depth, rays=4_000) for depth in (1, 2, 3))
    assert one.scattered.depth.max() == one.specular.depth.max() == 1
    assert two.scattered.depth.max() == 2
    assert three.scattered.depth.max() == 3
    # The same chains of mirrors, whatever else is followed.
    np.testing.assert_array_equal(two.specular.amplitude, three.specular.amplitude)
    assert (two.specular.depth == 3).any()


def facing(name: str, half_m: float, before: NDArray, at: NDArray, after: NDArray, of: str) -> SceneObject:
    """A square mirror at a point that sends what comes from one point to another."""
    normal = sum((end - at) / np.linalg.norm(end - at) for end in (before, after))
    across = np.cross(normal, [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across)
    up = np.cross(normal, across) / np.linalg.norm(normal)
    return plate(name, at, half_m * across, half_m * up, of)


@pytest.mark.parametrize("half_m", [0.5, 0.1])
def test_a_pane_in_a_chain_of_mirrors_reflects_the_same_whether_it_lets_waves_through(half_m, generator):
    """At random places 6 to 20 m away, by the fewest rays that the solver follows."""
    radar, fan, found = np.zeros(3), RayFan(LEAST_SOLVER_RAYS), 0
    for _ in range(6):
        pane, mirror = (generator.uniform((6.0, y, -0.5), (20.0, y + 5.0, 0.5)) for y in (-6.0, 1.0))
        scene = scene_of(facing("pane", half_m, radar, pane, mirror, "glass"),
                         facing("mirror", half_m, pane, mirror, radar, "metal"))  # fmt: skip
        chains = []
        for refraction in (False, True):
            paths = trace_of(scene, rays=fan.count, depth=2, diffuse=False, refraction=refraction).specular
            chains.append(paths.take((paths.depth > 1) & (paths.kinds & REFRACTED == 0)))
        without, through = chains
        np.testing.assert_allclose(through.image, without.image, atol=1e-9)
        np.testing.assert_allclose(through.amplitude, without.amplitude, rtol=1e-4)
        found += len(without)
    assert found >= 6


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


def test_an_oblique_rough_panel_returns_the_radar_integral():
    """lambda^2 / (4 pi)^3 int sigma0 dA / R^4 by the midpoint rule; fans of 8 offsets, whose mean errs by 0.04 dB."""
    panel = plate("panel", (8.0, 1.0, 0.5), (0.5, 1.5, 0.0), (0.0, 0.0, 1.0), "rough")
    step = (np.arange(400) + 0.5) / 200 - 1.0
    position = np.array([8.0, 1.0, 0.5]) + step[:, None, None] * [0.5, 1.5, 0.0] + step[None, :, None] * [0.0, 0.0, 1.0]
    area, square = 4.0 * np.array([1.5, -0.5, 0.0]), np.sum(position**2, axis=2)
    sigma0 = 4.0 * SCATTERING**2 * (position @ area) ** 2 / (area @ area) / square
    expected = WAVELENGTH_M**2 / (4.0 * np.pi) ** 3 * np.mean(sigma0 / square**2) * np.linalg.norm(area)
    fans = [RayFan(20_000, (k / 8.0, (0.618 * k) % 1.0)) for k in range(8)]
    found = np.mean([power(traced(panel, fan=fan).scattered) for fan in fans])
    assert power_to_db(found / expected) == pytest.approx(0.0, abs=0.1)
    lattice = traced(panel, rays=400_000, fan=WholeSphere(400_000))
    assert power_to_db(power(lattice.scattered) / expected) == pytest.approx(0.0, abs=0.1)


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
    assert power_to_db(many[specular_diffuse] / few[specular_diffuse]) == pytest.approx(0.0, abs=0.3)
    assert power_to_db(many[diffuse_specular] / few[diffuse_specular]) < -6.0
    table = traced(*scene, fan=WholeSphere(320_000), rays=320_000, depth=2)
    paths = table.scattered.take(table.scattered.depth == 2)
    first = paths.take(np.arange(len(paths)) < len(paths) // 2)
    second = paths.take(np.arange(len(paths)) >= len(paths) // 2)
    # Both directions of every path, one after the other, and together twice the power that the mirror-first ones have.
    np.testing.assert_array_equal(first.tx_point, second.rx_point)
    np.testing.assert_array_equal(first.rx_point, second.tx_point)
    np.testing.assert_array_equal(first.amplitude, second.amplitude)
    assert power(paths) == pytest.approx(2.0 * many[specular_diffuse], rel=0.01, abs=0.0)
    # The TX sees the point behind the side wall at y = 6, the RX sees it where it is.
    np.testing.assert_allclose(first.tx_point, first.rx_point * [1, -1, 1] + [0, 12, 0], atol=1e-3)
