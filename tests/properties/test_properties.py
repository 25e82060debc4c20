"""Whatever the input is: random echoes through the IF signal, the whole method after tracing, and every trace."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hardcases.tools import MATERIALS, MIRROR, frame_of, not_finite, not_finite_paths, rectangle, small_radar, traced
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from oracles import if_cube
from path_tables import random_table

from datafactory.paths.rays import RayFan
from datafactory.paths.table import PathTable, ScatteredPaths
from datafactory.scenes.poses import Pose
from datafactory.scenes.scene import SceneObject
from datafactory.synthesis.cube import cube_of_paths
from shared.radar import Radar
from shared.radar.arrays import AntennaArray, line
from shared.radar.waveform import Waveform
from shared.signal.imaging import delay_and_sum

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


def same(one: NDArray, other: NDArray, paths: ScatteredPaths) -> bool:
    """Whether two cubes agree to the tolerance, of what the paths would be without cancellation."""
    scale = np.linalg.norm(paths.amplitude) * np.sqrt(one.size)
    return bool(np.isfinite(one).all() and np.linalg.norm(one - other) <= TOLERANCE * scale)


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


@settings(max_examples=4 * EXAMPLES)
@given(radars(), echoes())
def test_the_cube_is_the_sum_over_its_paths(radar: Radar, paths: ScatteredPaths) -> None:
    """Whatever holds of that sum holds of the cube to twice the tolerance: reversed and mirrored paths, a later start,
    parts, another order, a common phase."""
    assert same(cube_of(paths, radar), if_cube(PathTable(paths), radar), paths)


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


@settings(max_examples=12)
@given(tables, st.integers(-40, 40))
def test_a_stronger_frame_is_the_same_frame(paths: PathTable, power: int) -> None:
    scale = 2.0**power
    louder = replace(paths, scattered=replace(paths.scattered, amplitude=paths.scattered.amplitude * scale))
    frame, other = frame_of(paths, RADAR, noise=False), frame_of(louder, RADAR, noise=False)
    np.testing.assert_array_equal(other.image, frame.image)
    np.testing.assert_array_equal(other.velocity, frame.velocity)
    np.testing.assert_array_equal(other.range_channel, frame.range_channel * np.float32(scale))
    assert other.image_peak == frame.image_peak * scale


@settings(max_examples=30)
@given(
    st.lists(st.floats(-0.5, 0.5, width=32), min_size=1, max_size=8, unique=True),
    st.integers(0, RADAR.grid.bins - 1),
    st.floats(-np.pi, np.pi),
)
def test_delay_and_sum_reads_the_amplitude_where_the_wave_comes_from(
    positions: list[float], column: int, phase: float
) -> None:
    """A plane wave from a direction on the grid: its own value there, and nowhere more."""
    array = AntennaArray(tx_m=line(np.zeros(1)), rx_m=line(np.array(positions)))
    radar = Radar(waveform=RADAR.waveform, array=array, grid=RADAR.grid)
    wavenumber = 2.0 * np.pi / radar.waveform.wavelength_m
    wave = np.exp(1j * (phase - wavenumber * radar.grid.u[column] * array.virtual[:, 1]))
    image = delay_and_sum(wave.astype(np.complex64)[None], radar)[0]
    assert abs(image[column] - np.exp(1j * phase)) < 1e-5
    assert np.abs(image).max() < 1.0 + 1e-5


pytestmark = pytest.mark.usefixtures("variant")

WAVELENGTH_M = 299_792_458.0 / 77.5e9
FEW = settings(max_examples=5)


class UnaimedFan(RayFan):
    """The same rays whatever the scene."""

    aimable = False


offsets = st.tuples(*[st.floats(-5e5, 5e5)] * 3)
angles = st.floats(-180.0, 180.0)


@st.composite
def rooms(draw: st.DrawFn) -> tuple[SceneObject, ...]:
    """A wall ahead, a wall to the left and the ground, each rough or a mirror, none closer than a metre."""
    ahead, left, below = draw(st.floats(4.0, 30.0)), draw(st.floats(2.0, 10.0)), draw(st.floats(1.0, 3.0))
    materials = [draw(st.sampled_from([MIRROR, "rough"])) for _ in range(3)]
    return (
        rectangle("ahead", (ahead, 0, 0), (0, 20, 0), (0, 0, 10), materials[0]),
        rectangle("left", (10, left, 0), (15, 0, 0), (0, 0, 10), materials[1]),
        rectangle("ground", (10, 0, -below), (20, 0, 0), (0, 20, 0), materials[2]),
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
    for kind in ("scattered", "specular"):
        for name in getattr(once, kind).__dataclass_fields__:
            assert getattr(getattr(once, kind), name).tobytes() == getattr(getattr(again, kind), name).tobytes()


@FEW
@given(rooms(), offsets, angles)
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


@FEW
@given(rooms())
def test_no_more_comes_back_than_a_lambertian_surface_can_return(room: tuple[SceneObject, ...]) -> None:
    """sigma0 <= 4 S^2 cos^2, so that from R_min on, over the front half space,

    P <= lambda^2 4 S^2 / (4 pi)^3 int cos(theta) / R^2 dOmega <= lambda^2 4 S^2 2 pi / ((4 pi)^3 R_min^2);

    a mirror at distance R returns at most lambda^2 / (4 pi 2 R)^2.
    """
    paths = traced(room, rays=4000)
    nearest = min(float(np.abs(item.vertices).max(axis=0).min()) for item in room)
    nearest = min(nearest, float(paths.scattered.range_m().min(initial=np.inf)))
    bound = 8.0 * np.pi * MATERIALS["rough"].scattering_coefficient ** 2 * WAVELENGTH_M**2 / (4.0 * np.pi) ** 3
    assert (np.abs(paths.scattered.amplitude) ** 2).sum() <= bound / nearest**2
    mirrors = WAVELENGTH_M / (4.0 * np.pi * 2.0 * paths.specular.range_m())
    assert (np.abs(paths.specular.amplitude) <= mirrors * (1.0 + 1e-5)).all()
