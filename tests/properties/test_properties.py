"""Whatever the input is: random echoes through the IF signal, the whole method after tracing, and every trace."""

from dataclasses import replace

import numpy as np
import pytest
from hardcases.tools import MIRROR, frame_of, not_finite, not_finite_paths, small_radar, traced
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from path_tables import different_columns, random_table
from sionna_scenes import plate

from datafactory.paths.rays import RayFan
from datafactory.paths.table import PathTable, ScatteredPaths
from datafactory.scenes.poses import Pose
from datafactory.scenes.scene import SceneObject
from datafactory.synthesis.cube import cube_of_paths
from shared.radar import Radar
from shared.radar.arrays import AntennaArray
from shared.radar.waveform import Waveform

TOLERANCE = 1e-6
EXAMPLES = 20

coordinate = st.floats(-0.0625, 0.0625, width=32)
elements = st.lists(st.tuples(coordinate, coordinate, coordinate), min_size=1, max_size=3).map(tuple)
arrays = st.builds(lambda tx, rx: AntennaArray(tx_m=tx, rx_m=rx), elements, elements)


@st.composite
def radars(draw: st.DrawFn) -> Radar:
    """Any carrier, bandwidth, frame shape and multiplexing."""
    array = draw(arrays)
    samples, chirps = draw(st.integers(1, 48)), draw(st.integers(1, 6))
    duration = draw(st.floats(10e-6, 100e-6))
    waveform = Waveform(
        carrier_hz=draw(st.floats(24e9, 300e9)),
        bandwidth_hz=draw(st.floats(50e6, 4e9)),
        chirp_duration_s=duration,
        chirp_interval_s=duration * draw(st.floats(1.0, 2.0)) * len(array.tx_m),
        chirps=chirps,
        samples=samples,
        range_bins=samples,
        multiplexing=draw(st.sampled_from(["simultaneous", "tdm"])),
        residual_video_phase=draw(st.booleans()),
    )
    return Radar(waveform=waveform, array=array)


@st.composite
def echoes(draw: st.DrawFn, most: int = 12) -> ScatteredPaths:
    """Paths of one and of several bounces, moving, over five decades of amplitude."""
    generator = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    return random_table(generator, draw(st.integers(1, most)), 0, (0.5, 60.0), 100.0, 40.0).scattered


def cube_of(paths: ScatteredPaths, radar: Radar) -> NDArray:
    return cube_of_paths(PathTable(paths), radar, TOLERANCE)


@settings(max_examples=EXAMPLES)
@given(radars(), echoes(), st.integers(-60, 60))
def test_the_same_input_makes_the_same_bytes_and_scaling_changes_no_digit(
    radar: Radar, paths: ScatteredPaths, power: int
) -> None:
    once = cube_of(paths, radar)
    assert cube_of(paths, radar).tobytes() == once.tobytes()
    threads = cube_of_paths(PathTable(paths), radar, TOLERANCE, threads=2)
    assert threads.tobytes() == once.tobytes()
    scale = np.float32(2.0**power)
    scaled = cube_of(replace(paths, amplitude=paths.amplitude * float(scale)), radar)
    np.testing.assert_array_equal(scaled, once * scale)


RADAR = small_radar(samples=48, chirps=4)

tables = st.builds(
    lambda count, seed: _table(count, np.random.default_rng(seed)), st.integers(0, 6), st.integers(0, 2**32 - 1)
)


def _table(count: int, generator: np.random.Generator) -> PathTable:
    """Moving targets in front of the radar, over four decades of amplitude."""
    u, range_m = generator.uniform(-0.9, 0.9, count), generator.uniform(0.5, 6.5, count)
    place = range_m[:, None] * np.stack([np.sqrt(1.0 - u**2), u, generator.uniform(-0.1, 0.1, count)], axis=1)
    amplitude = 10.0 ** generator.uniform(-4.0, 0.0, count) * np.exp(2j * np.pi * generator.uniform(size=count))
    return PathTable(ScatteredPaths.of_points(place, generator.uniform(-5.0, 5.0, (count, 3)), amplitude))


@settings(max_examples=12)
@given(tables, st.booleans())
def test_a_frame_is_finite_normalised_and_repeatable(paths: PathTable, noise: bool) -> None:
    frame = frame_of(paths, RADAR, noise)
    assert not_finite(frame) == 0
    assert frame.image.min() >= 0.0
    assert frame.image.max() == (1.0 if len(paths) else 0.0)
    again = frame_of(paths, RADAR, noise)
    assert again.image.tobytes() == frame.image.tobytes()
    assert again.range_channel.tobytes() == frame.range_channel.tobytes()
    assert again.targets == frame.targets


pytestmark = pytest.mark.usefixtures("variant")
FEW = settings(max_examples=5)


class UnaimedFan(RayFan):
    """The same rays whatever the scene."""

    aimable = False


@st.composite
def rooms(draw: st.DrawFn) -> tuple[SceneObject, ...]:
    """A wall ahead, a wall to the left and the ground, each rough or a mirror, none closer than a metre."""
    ahead, left, below = draw(st.floats(4.0, 30.0)), draw(st.floats(2.0, 10.0)), draw(st.floats(1.0, 3.0))
    materials = [draw(st.sampled_from([MIRROR, "rough"])) for _ in range(3)]
    return (
        plate("ahead", (ahead, 0, 0), (0, 20, 0), (0, 0, 10), materials[0]),
        plate("left", (10, left, 0), (15, 0, 0), (0, 0, 10), materials[1]),
        plate("ground", (10, 0, -below), (20, 0, 0), (0, 20, 0), materials[2]),
    )


def power(paths: PathTable) -> float:
    """Sum of all paths' powers, as if they met by chance."""
    return float((np.abs(paths.scattered.amplitude) ** 2).sum() + (np.abs(paths.specular.amplitude) ** 2).sum())


def lengths(paths: PathTable) -> np.ndarray:
    return np.sort(2.0 * paths.specular.range_m())


@FEW
@given(st.integers(0, 2**32 - 1), st.integers(1, 60), st.floats(1e-3, 100.0))
def test_triangles_of_any_shape_give_finite_paths_and_the_same_twice(seed: int, count: int, size: float) -> None:
    """Soups around the radar, triangles through it among them."""
    generator = np.random.default_rng(seed)
    corners = generator.normal(size=(count, 1, 3)) * size + generator.normal(size=(count, 3, 3)) * size
    triangles = np.arange(3 * count, dtype=np.int32).reshape(-1, 3)
    soup = SceneObject("soup", corners.reshape(-1, 3), triangles, str(generator.choice([MIRROR, "rough"])))
    once, again = (traced([soup], rays=3000, depth=2) for _ in range(2))
    assert not_finite_paths(once) == 0
    assert different_columns(once, again) == []


@FEW
@given(rooms(), st.tuples(*[st.floats(-5e5, 5e5)] * 3), st.floats(-180.0, 180.0))
def test_scene_and_radar_moved_together_see_the_same(
    room: tuple[SceneObject, ...], offset: tuple[float, float, float], yaw_deg: float
) -> None:
    here = traced(room, rays=4000, depth=2)
    turn = Pose((0.0, 0.0, 0.0), yaw_deg).rotation()
    moved = [replace(item, vertices=item.vertices @ turn.T + np.array(offset)) for item in room]
    there = traced(moved, Pose(offset, yaw_deg), rays=4000, depth=2)
    np.testing.assert_allclose(lengths(there), lengths(here), atol=1e-4)
    assert abs(10.0 * np.log10(power(there) / power(here))) < 0.1


@FEW
@given(rooms(), st.sampled_from([0.5, 2.0, 4.0]))
def test_a_scene_of_another_size(room: tuple[SceneObject, ...], factor: float) -> None:
    """Lengths grow with the size; the power of plane walls, smooth or rough, falls with its square."""
    # Rays are aimed by the size of range cells, which do not grow with the scene: here the same ones are sent.
    fan = UnaimedFan(4000)
    plain = traced(room, rays=4000, fan=fan)
    scaled = traced([replace(item, vertices=item.vertices * factor) for item in room], rays=4000, fan=fan)
    np.testing.assert_allclose(lengths(scaled), factor * lengths(plain), rtol=1e-5)
    assert abs(10.0 * np.log10(power(scaled) / power(plain) * factor**2)) < 0.05
