"""The fast cube against the float64 sum of eq. (1)-(2), and motion within the chirp against every delay."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from oracles import doppler_filtered, if_cube, relative_error, scattered_delays
from path_tables import random_table

from datafactory.paths.table import PathTable, ScatteredPaths
from datafactory.synthesis.cube import cube_of_paths
from datafactory.synthesis.sorting import FLOAT32_TOLERANCE
from datafactory.synthesis.truth import truth_moments
from shared.physics.units import SPEED_OF_LIGHT
from shared.radar import Radar
from shared.radar.arrays import AntennaArray, line
from shared.radar.waveform import Waveform
from shared.signal.imaging import near_field_images, sweep_moments
from shared.signal.spectrum import range_doppler

# The tolerance is a promise; a second or two of hypothesis examples is enough to break a false one.
PROPERTY = settings(max_examples=50)


PLANE = ((0.0, -0.04, 0.01), (0.0, 0.03, -0.02), (0.01, 0.0, 0.0))
SMALL_ARRAYS = (
    AntennaArray(tx_m=((0.0, 0.0, 0.0),), rx_m=((0.0, 0.0, 0.0),)),
    AntennaArray(tx_m=line(np.array([-0.05, -0.048])), rx_m=line(np.array([-0.045, 0.003, 0.045]))),
    AntennaArray(tx_m=PLANE, rx_m=PLANE[::-1]),
    AntennaArray(tx_m=((0.0, 0.0, 0.0),), rx_m=line(np.linspace(-0.25, 0.25, 5))),
)


@PROPERTY
@given(
    seed=st.integers(0, 2**32 - 1),
    samples=st.sampled_from([1, 2, 3, 31, 64, 65]),
    chirps=st.sampled_from([1, 2, 3]),
    array=st.sampled_from(SMALL_ARRAYS),
    counts=st.tuples(st.integers(0, 5), st.integers(0, 3)).filter(any),
    limits_m=st.sampled_from([(0.3, 1.0), (0.3, 150.0), (9.0, 10.0), (100.0, 150.0)]),
    span_db=st.sampled_from([0.0, 120.0]),
    speed=st.sampled_from([0.0, 3.0, 40.0]),
    multiplexing=st.sampled_from(["simultaneous", "tdm"]),
    video_phase=st.booleans(),
    tolerance=st.sampled_from([1e-3, 1e-6, 1e-9]),
    carrier_hz=st.sampled_from([24e9, 77e9, 300e9]),
    bandwidth_hz=st.sampled_from([50e6, 1e9, 4e9]),
)
def test_cube_keeps_its_tolerance(
    seed, samples, chirps, array, counts, limits_m, span_db, speed, multiplexing, video_phase, tolerance, **sweep
):
    # With 64 samples the unambiguous range is 9.6 m: most of these echoes are folded, as eq. (1) has them.
    waveform = Waveform(
        samples=samples, chirps=chirps, range_bins=samples, multiplexing=multiplexing, residual_video_phase=video_phase,
        **sweep,
    )  # fmt: skip
    radar = Radar.model_construct(waveform=waveform, array=array)  # not validated: turns may overlap
    table = random_table(np.random.default_rng(seed), counts[0], counts[1], limits_m, span_db, speed)
    reference = if_cube(table, radar)
    cube = cube_of_paths(table, radar, tolerance)
    assert cube.shape == reference.shape
    # Paths of equal strength may cancel in one sample; the promise is relative to what the paths could add up to.
    amplitudes = table.every("amplitude")
    energy = np.sqrt(reference.size) * np.linalg.norm(amplitudes)
    assert np.linalg.norm(cube - reference) <= tolerance * max(np.linalg.norm(reference), energy)


@pytest.mark.parametrize(("tolerance", "video_phase"), [(1e-3, False), (1e-6, True), (1e-9, False)])
def test_default_radar_and_virtual_sensor_keep_their_tolerance(tolerance, video_phase):
    radar = Radar(waveform=Waveform(chirps=3, residual_video_phase=video_phase))
    table = random_table(np.random.default_rng(5), 40, 10, (0.3, 150.0), 120.0, 15.0)
    assert relative_error(cube_of_paths(table, radar, tolerance), if_cube(table, radar)) <= tolerance
    # 0.5 m wide: the RX are worked on in blocks.
    radar = Radar(waveform=Waveform(samples=128, range_bins=128, chirps=2, residual_video_phase=video_phase))
    table = random_table(np.random.default_rng(6), 12, 4, (0.3, 150.0), 60.0, 15.0)
    cube = cube_of_paths(table, radar, tolerance, array=radar.virtual_sensor)
    assert relative_error(cube, if_cube(table, radar, radar.virtual_sensor)) <= tolerance


@example(speed=0.0)
@given(speed=st.sampled_from([1e-300, 1e-30]))
@settings(max_examples=3)
def test_static_equals_moving_with_no_velocity(speed):
    # A velocity that moves nothing takes the moving way through every chirp; the static way repeats one.
    radar = Radar(waveform=Waveform(samples=64, range_bins=64, chirps=4))
    table = random_table(np.random.default_rng(2), 6, 2, (1.0, 9.0), 20.0, 0.0)
    static = cube_of_paths(table, radar)
    moving = random_table(np.random.default_rng(2), 6, 2, (1.0, 9.0), 20.0, speed)
    assert moving.moves() == (speed > 0.0)
    assert static.tobytes() == cube_of_paths(moving, radar).tobytes()


def test_precision_follows_the_tolerance_and_what_is_beyond_float64_is_refused(small_radar):
    radar = small_radar(chirps=1)
    table = random_table(np.random.default_rng(4), 2, 0, (1.0, 9.0), 0.0, 0.0)
    assert cube_of_paths(table, radar, FLOAT32_TOLERANCE).dtype == np.complex64
    assert cube_of_paths(table, radar, 0.9 * FLOAT32_TOLERANCE).dtype == np.complex128
    for tolerance in (1e-12, 0.0, float("nan")):
        with pytest.raises(ValueError, match="expected at least 1e-11"):
            cube_of_paths(table, radar, tolerance)


@pytest.mark.parametrize(
    ("direction", "tolerance"),
    [*(((0.0, 1.0, 0.0), each) for each in (1e-3, 5e-7, 1e-9)), ((1.0, 0.0, 0.0), 5e-7), ((0.6, -0.8, 0.0), 5e-7)],
)
def test_the_worst_places_for_a_single_path(direction, tolerance):
    # Seen end on, the outer elements' delays are as far from the block's centre as they can be; half a cell comes on
    # top. The weights have little to spare: 0.78e-6 of 1e-6 for a whole block of the virtual sensor.
    radar = Radar(waveform=Waveform(chirps=1))
    step = radar.waveform.range_step_m
    for cell in 80.0, 80.125, 80.249, 80.251, 80.375:
        place = PathTable(ScatteredPaths.of_points(cell * step * np.array([direction]), np.zeros((1, 3)), np.ones(1)))
        cube = cube_of_paths(place, radar, tolerance, array=radar.virtual_sensor)
        assert relative_error(cube, if_cube(place, radar, radar.virtual_sensor)) <= tolerance


RADAR = Radar(waveform=Waveform(samples=256, range_bins=160, chirps=32))


def moving_points(speed_mps: float, count: int = 12, nearest_m: float = 4.0, seed: int = 1) -> PathTable:
    generator = np.random.default_rng(seed)
    azimuth, distance = generator.uniform(-0.9, 0.9, count), generator.uniform(nearest_m, 22.0, count)
    position = np.stack(
        [distance * np.cos(azimuth), distance * np.sin(azimuth), generator.uniform(-0.5, 0.5, count)], 1
    )
    velocity = generator.uniform(-speed_mps, speed_mps, (count, 3))
    return PathTable(ScatteredPaths.of_points(position, velocity, np.exp(2j * np.pi * generator.random(count))))


def by_definition(paths: PathTable, radar: Radar, cycles) -> NDArray[np.complex128]:
    """[chirps, samples, channels] sum of exp(j 2 pi cycles(tau, t, s)), tau a function of time."""
    waveform, array = radar.waveform, radar.array
    fast = np.arange(waveform.samples) * waveform.chirp_duration_s / waveform.samples
    cube = np.zeros((waveform.chirps, waveform.samples, array.channels), dtype=np.complex128)
    for channel, (tx, rx) in enumerate(zip(array.tx[array.channel_tx], array.rx[array.channel_rx], strict=True)):
        for chirp in range(waveform.chirps):
            start = chirp * waveform.chirp_interval_s

            def tau(time, tx=tx, rx=rx):
                return scattered_delays(paths.scattered, tx, rx, time)

            phase = np.stack([np.broadcast_to(cycles(tau, start, s), len(paths)) for s in fast])
            cube[chirp, :, channel] = np.exp(2j * np.pi * (phase % 1.0)) @ paths.scattered.amplitude
    return cube


@pytest.mark.parametrize("speed_mps", [3.0, 30.0])
def test_motion_within_the_chirp_is_that_of_every_sample(speed_mps):
    array = RADAR.array.model_copy(update={"rx_m": RADAR.array.rx_m[::8], "tx_m": RADAR.array.tx_m[:2]})
    waveform = Waveform(samples=64, range_bins=40, chirps=4)
    few_channels = RADAR.model_copy(update={"array": array, "waveform": waveform})

    def cycles(tau, start, fast):
        return (waveform.carrier_hz + waveform.slope_hz_per_s * fast) * tau(start + fast)

    paths = moving_points(speed_mps)
    exact = by_definition(paths, few_channels, cycles)
    ours = cube_of_paths(paths, few_channels, 1e-9, intra_chirp=True)
    # The term left out, 2 pi mu tau' (T_c / 2)^2 with tau' up to 2 sqrt(3) v / c, and its mean over the sweep.
    rate = 2.0 * np.sqrt(3.0) * speed_mps / SPEED_OF_LIGHT
    bound = 2.0 * np.pi * waveform.slope_hz_per_s * rate * (waveform.chirp_duration_s / 2.0) ** 2
    assert relative_error(ours, exact) < bound
    assert relative_error(cube_of_paths(paths, few_channels, 1e-9), exact) > 20.0 * bound
    # A scene at rest has none.
    still = moving_points(0.0)
    usual = cube_of_paths(still, few_channels)
    assert relative_error(cube_of_paths(still, few_channels, intra_chirp=True), usual) < 2e-6


def test_the_truth_follows_the_cube_in_its_motion_within_the_chirp():
    paths = moving_points(8.0, count=20)
    cube = cube_of_paths(paths, RADAR, 1e-9, intra_chirp=True).astype(np.complex64)
    spectra = np.abs(range_doppler(cube, RADAR)).mean(axis=-1)
    cells = np.argmax(spectra, axis=1)
    ours = near_field_images(truth_moments(paths, RADAR, cells, intra_chirp=True)[None], RADAR, RADAR.virtual_sensor)[0]
    whole = cube_of_paths(paths, RADAR, 1e-9, array=RADAR.virtual_sensor, intra_chirp=True)
    # Each row from the virtual sensor's own cube, filtered in its Doppler cell.
    expected = np.zeros_like(ours)
    for cell in np.unique(cells):
        moments = sweep_moments(doppler_filtered(whole, RADAR, int(cell)), RADAR, 5).astype(np.complex64)
        image = near_field_images(moments[None], RADAR, RADAR.virtual_sensor)[0]
        rows = cells == cell
        expected[rows] = image[rows]
    assert np.abs(np.abs(ours) - np.abs(expected)).max() < 10 ** (-45 / 20) * np.abs(expected).max()
