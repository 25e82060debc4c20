"""What a radar would not notice: bounds before visibility, the limit, the sums in cells, groups; against slow sums."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from prepared_scenes import EFFECT_SCENES, STREET, TINY, prepared_scene
from sionna_scenes import MATERIALS, mesh, plate, slab_reflection, slab_transmission

from datafactory.effects.catalogue import ALL
from datafactory.frame.chain import ChainSettings, SceneSource
from datafactory.frame.deal import Deal
from datafactory.paths.candidates import (
    CHAIN,
    CORNER,
    EDGE,
    PANE,
    PASSED,
    TARGET_MIRRORED,
    TARGET_SEEN,
    TWICE,
    Candidates,
)
from datafactory.paths.cells import cell_numbers
from datafactory.paths.corners import corners_of
from datafactory.paths.merged_scene import merge_scene
from datafactory.paths.notice import Notice, first_echoes
from datafactory.paths.rays import RayFan
from datafactory.paths.scattered import chain_candidates
from datafactory.paths.slabs import Slabs
from datafactory.paths.solver import TraceSettings
from datafactory.paths.table import DIFFRACTED, DIFFUSE, REFRACTED, SPECULAR, PathTable, ScatteredPaths, SpecularPaths
from datafactory.paths.trace import trace
from datafactory.paths.view import View
from datafactory.scenes.poses import Pose, read_poses
from datafactory.scenes.scene import PointTarget, Scene, SceneObject
from shared.physics.units import SPEED_OF_LIGHT
from shared.radar import ImageGrid, Radar
from shared.radar.arrays import AntennaArray
from shared.signal.windows import angle_window, cell_noise_power, width_and_sidelobe

RADAR = Radar()
NOTICE = Notice(RADAR, -30.0)
BORESIGHT_GAIN = float(
    RADAR.front_end.transmit_power_w
    * RADAR.front_end.tx_pattern.power_gain(np.array([1.0, 0.0, 0.0]))
    * RADAR.front_end.rx_pattern.power_gain(np.array([1.0, 0.0, 0.0]))
)


def ahead(range_m: float, power_w: NDArray[np.float64], family: int = EDGE) -> Candidates:
    """Candidates in one cell on boresight, by their power as the radar receives it."""
    place = np.tile([range_m, 0.0, 0.0], (len(power_w), 1))
    return Candidates.of(family, place, power_w / BORESIGHT_GAIN)


def hits(*level_w: float, range_m: float = 20.0) -> PathTable:
    """First hits on boresight, by their power as the radar receives it, each in a cell of its own."""
    place = np.array([[range_m + 3.0 * n, 0.0, 0.0] for n in range(len(level_w))])
    amplitude = np.sqrt(np.array(level_w) / BORESIGHT_GAIN)
    paths = ScatteredPaths.of_points(place, np.zeros_like(place), amplitude)
    return PathTable(replace(paths, kinds=np.full(len(paths), DIFFUSE, dtype=np.uint8)))


def test_the_limit_is_the_smaller_of_budget_and_noise() -> None:
    noise = cell_noise_power(RADAR)
    strong, weak = hits(1e6 * noise, 10.0 * noise), hits(100.0 * noise, noise)
    assert NOTICE.limit_w(strong) == pytest.approx(noise, abs=0.0)
    assert NOTICE.limit_w(weak) == pytest.approx(0.1 * noise, rel=1e-6, abs=0.0)
    assert replace(NOTICE, below_noise=False).limit_w(strong) == pytest.approx(1e3 * noise, rel=1e-6, abs=0.0)
    assert NOTICE.limit_w(PathTable(ScatteredPaths.none())) == 0.0


def test_a_mirror_counts_as_far_as_the_image_is_in_focus_there() -> None:
    """Against the image of one on boresight, by the sum over the virtual sensor's elements focused on points."""
    y, wavelength = RADAR.virtual_sensor.rx[:, 1], RADAR.waveform.wavelength_m
    window = angle_window("taylor-30", len(y))
    power = 1e-3 * cell_noise_power(RADAR)
    for range_m in (0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 80.0):
        image = np.array([[2.0 * range_m, 0.0, 0.0]])
        amplitude = np.array([np.sqrt(power / BORESIGHT_GAIN)], dtype=complex)
        mirror = SpecularPaths.of(
            image, np.zeros((1, 3)), np.diag([-1.0, 1.0, 1.0])[None], amplitude, np.zeros(1, np.int32), SPECULAR
        )
        limit = NOTICE.limit_w(PathTable(ScatteredPaths.none(), mirror))
        u = np.linspace(0.0, 0.5, 4001)[:, None]
        focus = np.sqrt(range_m**2 - 2.0 * range_m * u * y + y**2) - np.hypot(2.0 * range_m, y)
        shown = np.abs((window * np.exp(2j * np.pi * focus / wavelength)).sum(axis=1)).max() / window.sum()
        counted_db = 10.0 * np.log10(limit / (1e-3 * power))
        assert counted_db - 20.0 * np.log10(shown) == pytest.approx(0.0, abs=1.1)


@pytest.mark.parametrize("below_noise", [True, False])
@pytest.mark.parametrize(("start", "stop"), [(-0.85, 0.85), (-0.3, 0.2), (0.0, 0.95), (-1.0, 1.0)])
def test_what_stands_beside_the_image_counts_as_far_as_its_main_lobe_reaches_in(
    start: float, stop: float, below_noise: bool
) -> None:
    """Against the image of a point, by the sum over the virtual sensor's elements, at each of the grid's bins."""
    radar = RADAR.model_copy(update={"grid": ImageGrid(u_start=start, u_stop=stop)})
    notice = Notice(radar, -30.0, below_noise, antenna_pattern=False)
    y, wavelength = radar.virtual_sensor.rx[:, 1], radar.waveform.wavelength_m
    window, bins = angle_window("taylor-30", len(y)), radar.grid.u
    power = 1e-3 * cell_noise_power(radar)
    edges = np.linspace(-0.02, 0.02, 41)
    reached = 0
    for u in np.clip(np.concatenate([start + edges, stop + edges, [-1.0, 0.1, 1.0]]), -1.0, 1.0):
        paths = hits(power)
        place = 60.0 * np.array([[np.sqrt(1.0 - u**2), u, 0.0]])
        limit = notice.limit_w(PathTable(replace(paths.scattered, tx_point=place, rx_point=place)))
        lines = np.exp(2j * np.pi * (u - bins[:, None]) * y / wavelength) @ window
        shown = float(np.abs(lines).max() / window.sum()) ** 2
        counted = limit / (1e-3 * power)
        if shown > 0.1:
            assert 10.0 * np.log10(counted / shown) == pytest.approx(0.0, abs=0.8), u
            reached += 1
        else:
            assert counted < 0.2, u
    assert reached > 40


def test_a_strong_mirror_beside_the_image_sets_no_limit() -> None:
    """Not that of the budget, and not that which the strongest paths alone let through either."""
    noise = cell_noise_power(RADAR)
    ahead, beside = hits(10.0 * noise), hits(1e9 * noise).scattered
    place = np.array([[0.0, 20.0, 0.0]])
    both = PathTable(ScatteredPaths.joined([ahead.scattered, replace(beside, tx_point=place, rx_point=place)]))
    for below_noise in (True, False):
        notice = replace(NOTICE, below_noise=below_noise, antenna_pattern=False)
        assert notice.limit_w(both) == pytest.approx(notice.limit_w(ahead), rel=1e-6, abs=0.0)


def test_the_peak_is_that_of_first_hits_and_single_mirrors() -> None:
    """An edge a hundred times as strong as all of them does not raise what may be left out."""
    table = hits(100.0, 1.0)
    edge = replace(table.scattered, kinds=np.full(2, DIFFRACTED, np.uint8), amplitude=10.0 * table.scattered.amplitude)
    both = PathTable(ScatteredPaths.joined([table.scattered, edge]), SpecularPaths.none())
    assert len(first_echoes(both)) == 2
    np.testing.assert_array_equal(first_echoes(both).scattered.amplitude, table.scattered.amplitude)


def test_a_group_is_followed_as_a_whole() -> None:
    limit = 1e-12
    weak, strong = ahead(30.0, np.array([0.1 * limit]), TWICE), ahead(60.0, np.array([2.0 * limit]), TWICE)
    assert not NOTICE.worth(weak, limit).any()
    assert NOTICE.worth(Candidates.joined([weak, strong]), limit).all()


def test_an_echo_of_a_milliwatt_hides_no_sum_of_faint_ones() -> None:
    """Those of the second cell are less than the limit each, and more together."""
    limit = 1e-19
    strong, faint = ahead(2.0, np.array([1e-3])), ahead(30.0, np.array([0.5, 0.6, 0.3]) * limit)
    assert NOTICE.worth(Candidates.joined([strong, faint]), limit).tolist() == [True, False, True, False]


def test_a_sensor_that_tells_no_angle_has_one_cell_a_range_bin() -> None:
    alone = AntennaArray(tx_m=((0.0, 0.0, 0.0),), rx_m=((0.0, 0.0, 0.0),))
    radar = RADAR.model_copy(update={"virtual_sensor": alone})
    sides = np.array([[0.0, -20.0, 0.0], [20.0, 0.0, 0.0], [0.0, 20.0, 0.0]])
    _, column, columns = cell_numbers(np.full(3, 20.0), sides, radar, "taylor-30")
    assert (column.tolist(), columns) == ([0, 0, 0], 1)


def test_what_is_beyond_the_range_is_not_looked_for() -> None:
    beyond = RADAR.waveform.unambiguous_range_m + 1.0
    assert not NOTICE.worth(ahead(beyond, np.array([1.0])), 0.0).any()
    assert NOTICE.worth(ahead(beyond - 2.0, np.array([1.0])), 0.0).all()


def test_sums_in_cells_are_those_of_a_slow_search(generator: np.random.Generator) -> None:
    """Cell by cell in Python: from the weakest on, as long as the sum stays below the limit."""
    count, limit = 3999, 1e-12
    azimuth, elevation = generator.uniform(-0.3, 0.3, count), generator.normal(0.0, 0.1, count)
    range_m = generator.uniform(2.0, 5.0, count)  # some in each cell
    place = np.stack([np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)], 1)
    place, power = range_m[:, None] * place, 10.0 ** generator.uniform(-16.0, -11.0, count)
    families = (EDGE, CORNER, TARGET_SEEN)  # they share a cell's limit
    candidates = Candidates.joined([Candidates.of(each, place[n::3], power[n::3]) for n, each in enumerate(families)])
    worth = NOTICE.worth(candidates, limit)
    assert 0.1 < worth.mean() < 0.9

    elements, wavelength = RADAR.virtual_sensor.channels, RADAR.waveform.wavelength_m
    spacing = float(np.ptp(RADAR.virtual_sensor.rx[:, 1])) / (elements - 1) / wavelength
    width, _ = width_and_sidelobe(angle_window("taylor-30", elements), spacing)
    front_end, cells = RADAR.front_end, dict[tuple[int, int], list[tuple[float, int]]]()
    for n in range(count):
        where = candidates.arrival[n].astype(float)
        gain = front_end.tx_pattern.power_gain(where) * front_end.rx_pattern.power_gain(where)
        echo = float(candidates.power[n] * gain * front_end.transmit_power_w)
        cell = (round(float(candidates.range_m[n]) / RADAR.waveform.range_step_m),
                int((where[1] / np.linalg.norm(where) + 1.0) / width))  # fmt: skip
        cells.setdefault(cell, []).append((echo, n))
    for members in cells.values():
        total = 0.0
        for echo, n in sorted(members):
            total += echo
            assert worth[n] == (total > limit) or total == pytest.approx(limit, rel=1e-9, abs=0.0)


EVERYTHING = ALL.settings(ChainSettings(trace=TraceSettings(rays=20_000)))
ALONG = tuple(Pose((x, y, 0.6), yaw) for x, y, yaw in ((-30.0, -2.0, 0.0), (0.0, 2.0, 160.0), (15.0, -2.0, 75.0)))


def traced(path, *poses: Pose) -> list[PathTable]:
    scene, deal = prepared_scene(path), Deal(scenes=1, poses=poses)
    return [SceneSource(deal.frame(n), scene, EVERYTHING).traced(Radar()).table for n in range(len(deal))]


def scenes() -> list[tuple[str, list[PathTable]]]:
    found = [("street", traced(STREET, *ALONG)), ("tiny", traced(TINY, *ALONG[:1]))]
    for name in ("square_corner", "three_faces", "corner", "target_behind_pane", "reflector_behind_pane", "plate"):
        found.append(
            (name, traced(EFFECT_SCENES / f"{name}.usda", read_poses(EFFECT_SCENES / f"{name}.poses.json")[0]))
        )
    return found


@pytest.mark.usefixtures("variant")
def test_no_echo_exceeds_the_bound_of_its_candidate() -> None:
    """Edges, corners and targets by their own; what passed panes by the strongest pane."""
    met = dict.fromkeys((EDGE, CORNER, TARGET_SEEN, TARGET_MIRRORED), 0)
    beyond = 0
    for name, tables in scenes():
        for table in tables:
            candidates = table.candidates
            rows = table.scattered, table.specular
            candidate, kinds = (np.concatenate([getattr(part, of) for part in rows]) for of in ("candidate", "kinds"))
            power = np.concatenate([np.abs(part.amplitude) ** 2 for part in rows])
            passed = kinds & REFRACTED > 0
            own = (candidate >= 0) & ~passed
            total = np.bincount(candidate[own], power[own], len(candidates))
            for family in met:
                members = np.flatnonzero((candidates.family == family) & (total > 0.0))
                assert (total[members] <= candidates.power[members] * (1.0 + 1e-5)).all(), (name, family)
                met[family] += len(members)
            if passed.any():
                assert power[passed].max() <= candidates.power[candidates.family == PANE].max()
                beyond += int(passed.sum())
    assert all(met.values()), met
    assert beyond > 0


@pytest.mark.usefixtures("variant")
def test_a_target_beside_the_beam_is_heard_over_a_wall_in_it() -> None:
    """The bound of its way over mirrors is that of boresight: the target itself stands high above the beam."""
    wall = plate("wall", (24.5, 0.0, 0.0), (0.0, 20.0, 0.0), (0.0, 0.0, 20.0), "metal")
    post = PointTarget("post", (8.66, 0.5, 5.0), -10.0)
    merged = merge_scene(Scene("post and wall", (wall,), (post,)), MATERIALS)
    settings = TraceSettings(rays=20_000, depth=2, diffraction=False)
    every, heard = (
        trace(merged, Pose((0.0, 0.0, 0.0)), RADAR.waveform.mid_sweep_hz, settings, RayFan(20_000), 1, notice=notice)
        for notice in (None, NOTICE)
    )
    lit = every.within(RADAR).illuminated(RADAR.front_end).scattered
    # There and back over the wall are three bounces, which nothing else here has.
    assert np.abs(lit.amplitude[lit.depth == 3]).max() ** 2 > NOTICE.limit_w(every)
    assert 3 in heard.scattered.depth


def two_walls(first: tuple[np.ndarray, np.ndarray], second: tuple[np.ndarray, np.ndarray]) -> Candidates:
    """The chains over two large triangles, each (a point of it, its normal)."""
    walls = []
    for name, (point, n) in zip("ab", (first, second), strict=True):
        one = np.cross(n, [0.0, 0.0, 1.0])
        corners = point + 20.0 * np.array([one, -0.5 * one + [0, 0, 1.0], -0.5 * one - [0, 0, 1.0]])
        walls.append(mesh(name, corners, [[0, 1, 2]], "metal"))
    of = merge_scene(Scene("two walls", tuple(walls)), MATERIALS)
    bare = replace(corners_of(merge_scene(Scene("none", ()), MATERIALS)), face_of_triangle=np.full(2, -1))
    slabs = Slabs(of.slabs, SPEED_OF_LIGHT / 0.004)
    view = View(None, of, slabs, Pose((0.0, 0.0, 0.0)), TraceSettings())
    return chain_candidates(CHAIN, [np.array([[0, 1], [0, 1]])], view, bare)


X, Y = np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])


def test_a_chain_between_parallel_walls_is_as_long_as_its_legs() -> None:
    """10 m ahead, 15 m back to the wall behind, 5 m home: once, however often the sequence was met."""
    found = two_walls((10.0 * X, -X), (-5.0 * X, X))
    assert len(found) == 1
    assert found.family[0] == CHAIN
    assert found.range_m[0] == pytest.approx(15.0)
    assert found.power[0] == pytest.approx((0.004 / (4.0 * np.pi * 30.0)) ** 2, rel=1e-5)
    np.testing.assert_allclose(found.departure[0], 10.0 * X, atol=1e-5)
    np.testing.assert_allclose(found.arrival[0] / np.linalg.norm(found.arrival[0]), -X, atol=1e-5)


def test_walls_over_which_no_way_closes_have_no_chain() -> None:
    """A wall ahead and one beside it, behind the sensor's back: their images close only far outside both."""
    beside = np.array([200.0, 3.0, 0.0])
    assert len(two_walls((10.0 * X, -X), (beside, -Y))) == 0


@pytest.mark.parametrize("chained", [True, False])
def test_chains_through_panes_are_a_group_by_itself(chained: bool) -> None:
    """A wall behind a pane, and one behind the sensor's back, over which the way closes, or none.

    The pane is turned: over its own back no way closes. A near mirror is the strongest cell, which no chain reaches.
    """
    wide = (0.0, 20.0, 0.0), (0.0, 0.0, 20.0)
    walls = plate("ahead", (10.0, 0.0, 0.0), *wide, "metal"), plate("behind", (-5.0, 0.0, 0.0), *wide, "metal")
    pane = plate("pane", (3.0, 0.0, 0.0), (0.1, 0.6, 0.0), (0.0, 0.0, 0.6), "glass")
    near = plate("near", (1.6, 1.2, 0.0), (-0.3, 0.4, 0.0), (0.0, 0.0, 0.5), "metal")
    merged = merge_scene(Scene("walls", (pane, near, *walls[: 1 + chained])), MATERIALS)
    settings, fan = TraceSettings(rays=20_000, refraction=True), RayFan(20_000)

    def traced(notice: Notice | None) -> tuple[PathTable, NDArray[np.bool_]]:
        table = trace(merged, Pose((0.0, 0.0, 0.0)), 77.5e9, settings, fan, 1, notice=notice)
        mirrors = table.specular
        return table, (mirrors.depth == 2) & (mirrors.kinds & REFRACTED > 0)

    table, through = traced(None)
    members = table.candidates.take(table.candidates.family == PASSED)
    assert (len(members) > 1) == chained  # the first stands for the group
    assert through.any() == chained
    assert (table.candidates.family[table.specular.candidate[through]] == PASSED).all()
    assert chained == (np.abs(members.range_m[1:] - 15.0) < 1e-4).any()
    strict, through = traced(replace(NOTICE, budget_db=-100.0, below_noise=False))
    assert through.any() == chained
    assert (strict.candidates.family == PASSED).sum() == len(members)
    assert not traced(replace(NOTICE, budget_db=0.0, below_noise=False))[1].any()


def test_a_wall_sends_its_echo_back_to_the_pane_before_it() -> None:
    """Wall, back of the pane, wall: three mirrors, as many as chains without panes have, and two crossings."""
    wide = (0.0, 20.0, 0.0), (0.0, 0.0, 20.0)
    pane, wall = plate("pane", (5.0, 0.0, 0.0), *wide, "glass"), plate("wall", (9.0, 0.0, 0.0), *wide, "metal")
    merged = merge_scene(Scene("window", (pane, wall)), MATERIALS)
    settings = TraceSettings(rays=20_000, refraction=True)
    table = trace(merged, Pose((0.0, 0.0, 0.0)), 77.5e9, settings, RayFan(20_000), 1)
    echo = table.specular.take(table.specular.depth == 3)
    np.testing.assert_allclose(echo.range_m(), [13.0], rtol=1e-6)
    glass = 6.31, 1.211, 0.006, 77.5e9, 1.0
    passed, reflected = (abs(of(*glass)[0]) for of in (slab_transmission, slab_reflection))
    free = SPEED_OF_LIGHT / 77.5e9 / (8.0 * np.pi * 13.0)
    assert abs(echo.amplitude[0]) == pytest.approx(free * passed**2 * reflected, rel=5e-3)
    assert (table.candidates.family[echo.candidate] == PASSED).all()


def test_a_corner_behind_a_pane_is_a_chain_of_the_solver() -> None:
    """Two walls at 88 deg behind a pane: in the open they are a corner, or a chain where corners are left out."""
    along = [
        np.array([np.cos(turn), np.sin(turn), 0.0]) for turn in (np.pi - np.radians(44.0), np.pi + np.radians(44.0))
    ]
    up, edge = np.array([0.0, 0.0, 1.0]), np.array([10.0, 0.0, 0.0])
    sides = [np.array([edge - up, edge + 2.0 * way - up, edge + 2.0 * way + up, edge + up]) for way in along]
    corner = mesh("corner", np.concatenate(sides), [[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]], "metal")
    pane = plate("pane", (5.0, 0.0, 0.0), (0.0, 3.0, 0.0), (0.0, 0.0, 3.0), "glass")
    fan = RayFan(20_000)

    def families(*objects: SceneObject, corners: bool = True) -> set[int]:
        merged = merge_scene(Scene("corner", objects), MATERIALS)
        settings = TraceSettings(20_000, refraction=True, corners=corners)
        found = trace(merged, Pose((0.0, 0.3, 0.0)), 77.5e9, settings, fan, 1).candidates
        return set(found.family[found.power > 0.0].tolist())

    assert families(corner) & {CORNER, CHAIN, PASSED} == {CORNER}
    assert families(corner, corners=False) & {CORNER, CHAIN, PASSED} == {CHAIN}
    assert PASSED in families(corner, pane)
