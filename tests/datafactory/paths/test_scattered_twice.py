"""Echoes scattered twice: their power against Sionna's own, drawn in parts, and left alone by panes elsewhere."""

from __future__ import annotations

from dataclasses import fields, replace
from itertools import pairwise

import numpy as np
import pytest
from rough_plates import CORNER, FREQUENCY_HZ, HERE, decibels_of, merged_of, plate
from sionna_scenes import slabs, view_of

from datafactory.paths import solver as solver_module
from datafactory.paths.arrivals import Arrivals, Echoes
from datafactory.paths.geometry import placed
from datafactory.paths.rays import RayFan
from datafactory.paths.scattered import scattered_twice
from datafactory.paths.solver import Bundle, TraceSettings
from datafactory.paths.table import DIFFUSE, REFRACTED, SPECULAR, PathTable
from datafactory.paths.trace import trace
from datafactory.scenes.scene import SceneObject

pytestmark = pytest.mark.usefixtures("variant")

CANYON = (
    plate("left", (20.0, 6.0, 3.0), (25.0, 0.0, 0.0), (0.0, 0.0, 6.0), "concrete"),
    plate("right", (20.0, -6.0, 3.0), (25.0, 0.0, 0.0), (0.0, 0.0, 6.0), "concrete"),
    plate("road", (20.0, 0.0, -1.5), (25.0, 0.0, 0.0), (0.0, 6.0, 0.0), "concrete"),
)
HALL = (
    plate("left", (10.0, 6.0, 0.0), (12.0, 0.0, 0.0), (0.0, 0.0, 4.0), "lobed"),
    plate("right", (10.0, -6.0, 0.0), (12.0, 0.0, 0.0), (0.0, 0.0, 4.0), "concrete"),
    plate("ceiling", (10.0, 0.0, 4.0), (12.0, 0.0, 0.0), (0.0, 6.0, 0.0), "lobed"),
    plate("end", (20.0, 0.0, 0.0), (0.0, 6.0, 0.0), (0.0, 0.0, 4.0), "metal"),
)
SHOP = (
    *CORNER,
    plate("pane", (6.0, -2.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), "glass"),
    plate("behind", (8.0, -2.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), "metal"),
)
EVERY = TraceSettings(solver_share=1, twice_share=1, paths_a_cell=0, depth=2)


def first_hits(objects: tuple[SceneObject, ...], settings: TraceSettings, fan: RayFan) -> Arrivals:
    merged = merged_of(*objects)
    return Arrivals.first(view_of(merged, HERE, settings), fan)


def of_kinds(bundle: Bundle, *kinds: int) -> Bundle:
    part = bundle.of_bounces(len(kinds))
    return part.take((part.interactions == np.array(kinds)).all(axis=1))


def powers(bundle: Bundle, fan: RayFan) -> float:
    return float(np.sum(np.abs(bundle.amplitude) ** 2 * fan.solid_angle_ratio(bundle.vertices[:, 0])))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("objects", "polarization"),
    [(CORNER, ("V", "V")), (CORNER, ("H", "H")), (CANYON, ("V", "V")), (HALL, ("V", "V"))],
    ids=["corner", "corner, level", "canyon", "hall"],
)
def test_power_is_sionnas_own(objects, polarization):
    rays, merged = 2_000_000, merged_of(*objects)
    settings = replace(EVERY, rays=rays, polarization=polarization)
    geometry = placed(merged, HERE)
    scene = solver_module.radio_scene(geometry, slabs(merged), settings)
    ours, theirs = 0.0, 0.0
    for seed in (1, 2):
        fan = RayFan(rays, (0.37 * seed, 0.11 * seed))
        (twice,) = scattered_twice(first_hits(objects, settings, fan), seed)
        ours += float(twice.power.sum())
        solved = solver_module.solve(scene, merged, HERE, settings, fan, seed).bundle
        theirs += powers(of_kinds(solved, DIFFUSE, DIFFUSE), fan)
    assert decibels_of(ours / theirs) == pytest.approx(0.0, abs=0.2)


def test_three_bounces_are_followed_in_all_their_orders():
    settings = replace(EVERY, rays=20_000, depth=3)
    fan = RayFan(20_000)
    found = {group.kinds: group.thinned(1) for group in scattered_twice(first_hits(CORNER, settings, fan), 1)}
    two, three = (DIFFUSE, DIFFUSE), {(DIFFUSE, DIFFUSE, DIFFUSE), (DIFFUSE, SPECULAR, DIFFUSE), (1, 2, 2)}
    assert set(found) == {two, *three}
    assert min(len(part.amplitude) for part in found.values()) > 1_000
    # Each bounce more costs as much as a surface keeps to itself.
    assert all(powers(found[kinds], fan) < powers(found[two], fan) for kinds in three)
    mirrors_off = first_hits(CORNER, replace(settings, specular=False), fan)
    assert {group.kinds for group in scattered_twice(mirrors_off, 1)} == {two, (2, 2, 2)}


@pytest.mark.parametrize("depth", [2, 3])
def test_parts_are_the_whole(depth):
    settings = replace(EVERY, rays=20_000, depth=depth, twice_share=4)
    first = first_hits(CORNER, settings, RayFan(20_000))
    thin, rest = first.share(64)
    assert 0 < len(thin.ray) < len(rest.ray) / 32
    parts = zip(scattered_twice(thin, 1), scattered_twice(rest, 1), strict=True)
    for whole, (some, others) in zip(scattered_twice(first, 1), parts, strict=True):
        joined = Echoes.joined([others, some])
        for item in ("amplitude", "power", "cell"):
            np.testing.assert_array_equal(getattr(joined, item), getattr(whole, item))
        one, other = joined.thinned(1), whole.thinned(1)
        for field in fields(Bundle):
            np.testing.assert_array_equal(getattr(one, field.name), getattr(other, field.name))


def test_a_share_of_the_rays_says_what_all_would():
    first = first_hits(CANYON, replace(EVERY, rays=400_000), RayFan(400_000))
    (whole,) = scattered_twice(first, 1)
    (some,) = scattered_twice(first.share(16)[0], 1)
    assert decibels_of(16.0 * some.power.sum() / whole.power.sum()) == pytest.approx(0.0, abs=0.5)
    few, many = (
        scattered_twice(first_hits(CANYON, replace(EVERY, rays=400_000, twice_share=n), RayFan(400_000)), 1)[0]
        for n in (16, 1)
    )
    assert decibels_of(few.power.sum() / many.power.sum()) == pytest.approx(0.0, abs=0.5)
    assert len(few.power) == pytest.approx(len(many.power) / 16.0, rel=0.1)


def uncrossed(table: PathTable) -> tuple[PathTable, int]:
    """The table without the paths through panes, and how many those are."""
    scattered = table.scattered.take(np.flatnonzero((table.scattered.kinds & REFRACTED) == 0))
    specular = table.specular.take(np.flatnonzero((table.specular.kinds & REFRACTED) == 0))
    return replace(table, scattered=scattered, specular=specular), len(table) - len(scattered) - len(specular)


@pytest.mark.parametrize("depth", [1, 2, 3])
def test_panes_change_no_path_that_does_not_cross_them(depth):
    settings = TraceSettings(rays=20_000, depth=depth, diffraction=True, corners=True)
    without, through = (
        trace(merged_of(*SHOP), HERE, FREQUENCY_HZ, replace(settings, refraction=on), RayFan(20_000), 1)
        for on in (False, True)
    )
    kept, crossing = uncrossed(through)
    assert crossing > 20
    assert uncrossed(without)[1] == 0
    for kind in ("scattered", "specular"):
        ours, theirs = getattr(kept, kind), getattr(without, kind)
        for field in fields(ours):
            if field.name == "candidate":  # a number in a list that is longer with panes
                continue
            np.testing.assert_array_equal(getattr(ours, field.name), getattr(theirs, field.name))


def test_each_number_of_bounces_is_left_alone_by_more_of_them():
    tables = [
        trace(merged_of(*CORNER), HERE, FREQUENCY_HZ, TraceSettings(rays=20_000, depth=d), RayFan(20_000), 1)
        for d in (1, 2, 3)
    ]
    for fewer, more in pairwise(tables):
        most = int(fewer.scattered.depth.max())
        kept = more.scattered.take(np.flatnonzero(more.scattered.depth <= most))
        np.testing.assert_array_equal(kept.amplitude, fewer.scattered.amplitude)
        np.testing.assert_array_equal(kept.rx_point, fewer.scattered.rx_point)
