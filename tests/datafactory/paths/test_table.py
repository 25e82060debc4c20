"""The path table: both delay laws, illumination, reciprocity, a table that stands still; on the disk bit for bit."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from oracles import mirror_path, mirrored, scattered_delays, specular_delays
from path_tables import a_table, different_columns

from datafactory.paths.storage import (
    TWO_POINTS,
    TracedFrame,
    paths_schema,
    read_frame_paths,
    read_paths,
    to_row,
    writer_options,
)
from datafactory.paths.table import SPECULAR, PathTable, ScatteredPaths, SpecularPaths
from datafactory.run.shards import write_tables
from datafactory.scenes.boxes import SeenThing
from datafactory.scenes.poses import Pose
from shared.physics.errors import InputError
from shared.radar import FrontEnd, Radar
from shared.radar.antenna import IsotropicPattern, ParabolicPattern
from shared.radar.waveform import Waveform
from shared.signal import round_trip_delays, target_amplitudes

LIGHT_MPS = 299_792_458.0
WALL = (np.array([9.0, 3.0, 0.0]), np.array([-0.8, -0.6, 0.0]))
FLOOR = (np.array([0.0, 0.0, -1.5]), np.array([0.0, 0.0, 1.0]))


def behind(planes, velocity=(0.0, 0.0, 0.0)) -> SpecularPaths:
    """One specular path by its mirrors, straight from the method of images."""
    image, axes = np.zeros(3), np.eye(3)
    for plane in planes:
        image = mirrored(image, plane)
        axes = (np.eye(3) - 2.0 * np.outer(plane[1], plane[1])) @ axes
    amplitude, owner = np.array([1.0 - 2.0j]), np.zeros(1, dtype=np.int32)
    return SpecularPaths.of(image[None], np.array([velocity]), axes[None], amplitude, owner, SPECULAR, len(planes))


def two_points() -> ScatteredPaths:
    generator = np.random.default_rng(1)
    return ScatteredPaths(
        tx_point=generator.uniform(2.0, 20.0, (2, 3)),
        rx_point=generator.uniform(2.0, 20.0, (2, 3)),
        tx_velocity=generator.uniform(-9.0, 9.0, (2, 3)),
        rx_velocity=generator.uniform(-9.0, 9.0, (2, 3)),
        between_m=np.array([0.0, 7.0]),
        between_rate_mps=np.array([0.0, -3.0]),
        amplitude=np.array([1.0, 2.0j]),
        depth=np.array([1, 2], dtype=np.int8),
        object_index=np.array([0, 1], dtype=np.int32),
        kinds=np.array([2, 3], dtype=np.uint8),
    )


@pytest.mark.parametrize("planes", [[WALL], [WALL, FLOOR]])
def test_specular_law_of_a_moving_mirror(planes):
    generator = np.random.default_rng(3)
    velocity = np.array([-12.0, 3.0, 0.5])
    # The first mirror moves; its image moves with twice the normal part, and further mirrors reflect that.
    image_velocity = 2.0 * (velocity @ WALL[1]) * WALL[1]
    for plane in planes[1:]:
        image_velocity = image_velocity - 2.0 * (image_velocity @ plane[1]) * plane[1]
    paths = behind(planes, tuple(image_velocity))
    for time_s in (0.0, 0.01, 0.5):
        now = [(WALL[0] + velocity * time_s, WALL[1]), *planes[1:]]
        for tx, rx in generator.uniform(-0.3, 0.3, (5, 2, 3)):
            length, _ = mirror_path(tx, rx, now)
            assert specular_delays(paths, tx, rx, time_s)[0] * LIGHT_MPS == pytest.approx(length, abs=1e-11)
            one_tx = scattered_delays(paths.as_scattered(tx), tx, rx, time_s)
            assert one_tx[0] * LIGHT_MPS == pytest.approx(length, abs=1e-11)


@pytest.mark.parametrize("planes", [[WALL], [WALL, FLOOR]])
def test_departure_points_to_the_first_mirror(planes):
    _, vertices = mirror_path(np.zeros(3), np.zeros(3), planes)
    paths = behind(planes)
    departure, arrival = paths.departure()[0], paths.image[0]
    np.testing.assert_allclose(departure / np.linalg.norm(departure), vertices[0] / np.linalg.norm(vertices[0]))
    np.testing.assert_allclose(arrival / np.linalg.norm(arrival), vertices[-1] / np.linalg.norm(vertices[-1]))


def test_a_single_bounce_is_equation_2():
    radar = Radar(waveform=Waveform(chirps=3))
    position, velocity = np.array([7.0, -2.0, 0.3]), np.array([4.0, 5.0, -1.0])
    paths = ScatteredPaths.of_points(position[None], velocity[None], np.ones(1))
    delays = round_trip_delays(radar, position, velocity)
    for channel, (i, j) in enumerate(zip(radar.array.channel_tx, radar.array.channel_rx, strict=True)):
        for m in range(3):
            tau = scattered_delays(paths, radar.array.tx[i], radar.array.rx[j], m * 80.6e-6)
            assert tau[0] == pytest.approx(delays[channel, m], rel=1e-14)


def test_a_reversed_path_takes_as_long_from_the_other_end():
    paths = two_points()
    a, b = np.array([0.0, 0.1, 0.0]), np.array([0.02, -0.2, 0.1])
    np.testing.assert_allclose(
        scattered_delays(paths, a, b, 0.01), scattered_delays(paths.reversed(), b, a, 0.01), rtol=1e-15
    )
    np.testing.assert_array_equal(paths.reversed().amplitude, paths.amplitude)
    again = paths.reversed().reversed()
    np.testing.assert_array_equal(again.tx_point, paths.tx_point)
    np.testing.assert_array_equal(again.rx_velocity, paths.rx_velocity)


def test_range_is_half_of_the_path():
    paths, origin = two_points(), np.zeros(3)
    np.testing.assert_allclose(paths.range_m(), scattered_delays(paths, origin, origin, 0.0) * LIGHT_MPS / 2.0)
    specular = behind([WALL])
    np.testing.assert_allclose(specular.range_m(), specular_delays(specular, origin, origin, 0.0) * LIGHT_MPS / 2.0)


def test_taking_and_joining_lose_nothing():
    paths = two_points()
    joined = ScatteredPaths.joined([paths.take(np.array([1])), paths.take(np.array([True, False]))])
    assert len(joined) == 2
    for name in paths.__dataclass_fields__:
        np.testing.assert_array_equal(getattr(joined, name), getattr(paths, name)[[1, 0]])
        assert getattr(joined, name).dtype == getattr(paths, name).dtype
    assert len(behind([WALL]).take(np.array([False]))) == 0


def test_only_what_moves_moves():
    still = ScatteredPaths.of_points(np.ones((2, 3)), np.zeros((2, 3)), np.ones(2))
    assert not PathTable(still, behind([WALL])).moves()
    assert PathTable(still, behind([WALL], (0.0, 0.0, 1e-9))).moves()
    assert PathTable(two_points()).moves()
    assert len(PathTable(still, behind([WALL]))) == 3


def test_illumination_is_the_radar_equation():
    # Isotropic amplitude of a point target with unit power: sqrt(lambda^2 sigma / ((4 pi)^3 R^4)).
    radar = Radar()
    position = np.array([[20.0, 5.0, -0.5], [30.0, -14.0, 2.0]])
    rcs_dbsm, phase = np.array([10.0, -3.0]), np.array([0.4, 2.0])
    range_m = np.linalg.norm(position, axis=1)
    isotropic = radar.waveform.wavelength_m * np.sqrt(10.0 ** (rcs_dbsm / 10.0) / (4.0 * np.pi) ** 3) / range_m**2
    table = PathTable(ScatteredPaths.of_points(position, np.zeros((2, 3)), isotropic * np.exp(1j * phase)))
    lit = table.illuminated(radar.front_end).scattered.amplitude
    np.testing.assert_allclose(lit, target_amplitudes(radar, position, rcs_dbsm, phase), rtol=1e-12)


def test_each_end_has_its_own_pattern():
    # A TX that looks ahead and an RX that looks everywhere: only the departure counts.
    narrow = ParabolicPattern(gain_dbi=0.0, azimuth_beamwidth_deg=20.0, elevation_beamwidth_deg=20.0, floor_db=40.0)
    one_way = FrontEnd(transmit_power_dbm=30.0, tx_pattern=narrow, rx_pattern=IsotropicPattern())
    ahead, aside = np.array([[5.0, 0.0, 0.0]]), np.array([[0.0, 5.0, 0.0]])
    base = ScatteredPaths.of_points(ahead, np.zeros((1, 3)), np.ones(1))
    leaving_ahead = PathTable(replace(base, rx_point=aside))
    assert np.abs(leaving_ahead.illuminated(one_way).scattered.amplitude[0]) == pytest.approx(1.0)
    leaving_aside = PathTable(leaving_ahead.scattered.reversed())
    assert np.abs(leaving_aside.illuminated(one_way).scattered.amplitude[0]) == pytest.approx(1e-2)
    # A specular path by wall and floor leaves and arrives in different directions, too.
    specular = PathTable(base, behind([WALL, FLOOR]))
    gains = narrow.power_gain(specular.specular.departure())
    lit = specular.illuminated(one_way).specular.amplitude / specular.specular.amplitude
    np.testing.assert_allclose(np.abs(lit) ** 2, gains)


def test_paths_beyond_the_unambiguous_range_are_counted():
    radar = Radar(waveform=Waveform(samples=64, range_bins=64))
    limit = radar.waveform.unambiguous_range_m
    position = np.array([[limit - 0.01, 0.0, 0.0], [limit + 0.01, 0.0, 0.0], [3.0, 0.0, 0.0]])
    table = PathTable(
        ScatteredPaths.of_points(position, np.zeros((3, 3)), np.arange(3.0)),
        behind([(np.array([limit + 1.0, 0.0, 0.0]), np.array([1.0, 0.0, 0.0]))]),
        counts={"rays": 7},
    )
    near = table.within(radar)
    assert near.scattered.amplitude.real.tolist() == [0.0, 2.0]
    assert len(near.specular) == 0
    assert near.counts == {"rays": 7, "beyond_range": 2}
    assert near.within(radar).counts == near.counts


@pytest.mark.parametrize("time_s", [0.0, 5.2e-3, -1.0])
def test_a_table_at_rest_keeps_the_delays_of_its_moment(generator, time_s: float) -> None:
    table = a_table(generator)
    still = table.at_rest(time_s)
    assert table.moves()
    assert not still.moves()
    tx, rx = np.array([0.0, -0.048, 0.0]), np.array([0.0, 0.045, 0.0])
    for later_s in (0.0, 0.3):
        scattered = (
            scattered_delays(part, tx, rx, at) for part, at in ((still.scattered, later_s), (table.scattered, time_s))
        )
        specular = (
            specular_delays(part, tx, rx, at) for part, at in ((still.specular, later_s), (table.specular, time_s))
        )
        for got, expected in (scattered, specular):
            np.testing.assert_allclose(np.asarray(got), np.asarray(expected), rtol=1e-12)
    np.testing.assert_array_equal(still.scattered.amplitude, table.scattered.amplitude)
    np.testing.assert_array_equal(still.specular.amplitude, table.specular.amplitude)


def a_frame(frame_id: int, scattered: int, specular: int) -> TracedFrame:
    generator = np.random.default_rng(frame_id)

    def labelled(paths: Any) -> Any:
        count = len(paths)
        return replace(
            paths,
            depth=generator.integers(1, 4, count).astype(np.int8),
            object_index=generator.integers(-1, 9, count).astype(np.int32),
            kinds=generator.integers(1, 32, count).astype(np.uint8),
        )

    paths = a_table(generator, scattered).scattered
    paths.tx_point[::2] = paths.rx_point[::2]  # of one point, as most are
    if scattered > 1:
        paths.rx_point[0, 0], paths.tx_point[0, 0] = 0.0, -0.0  # which differ in a bit
    images = a_table(generator, specular).specular
    counts = {"rays": 5, "pruned": 0}
    table = PathTable(labelled(paths), labelled(images), objects=("wall", "Größe"), counts=counts)
    pose = Pose((1.0, 2.0, 3.0), 10.0, -2.0, 0.5, (4.0, 5.0, 6.0), 0.25)

    def triple() -> tuple[float, float, float]:
        x, y, z = generator.normal(size=3).tolist()
        return x, y, z

    things = tuple(
        SeenThing(f"car {n}", "car", triple(), triple(), triple(), triple(), triple(), triple(), tuple(range(n)))
        for n in range(frame_id)
    )
    return TracedFrame(frame_id, "scene", 1, 2**62, pose, 3.87e-3, 1, table, things)


def written(folder: Path, frames: list[TracedFrame]) -> Path:
    path = folder / "paths" / "part-00000.parquet"
    rows = (pa.Table.from_pylist([to_row(frame)], schema=paths_schema()) for frame in frames)
    write_tables(path, rows, paths_schema(), **writer_options())
    return path


def test_a_path_of_one_point_stores_it_once(tmp_path):
    frame = a_frame(0, 4000, 1)
    scattered = frame.table.scattered
    once = replace(frame, table=replace(frame.table, scattered=replace(scattered, tx_point=scattered.rx_point)))
    sizes = [written(tmp_path / name, [given]).stat().st_size for name, given in
             (("all", frame), ("once", once))]  # fmt: skip
    assert sizes[0] - sizes[1] > 0.9 * 24 * 2000  # half of the first frame's have two


@pytest.mark.parametrize("marks", [[True] * 7, [False] * 6, []])
def test_marks_that_do_not_belong_to_the_points_are_named(tmp_path, marks):
    path = tmp_path / "part-00000.parquet"
    row = {**to_row(a_frame(0, 7, 2)), TWO_POINTS: np.array(marks, dtype=bool)}
    pq.write_table(pa.Table.from_pylist([row], schema=paths_schema()), path)
    with pytest.raises(InputError, match=r"part-00000\.parquet: a row is not understood: 4 first points and"):
        list(read_paths(path))


def test_round_trip(tmp_path):
    frames = [a_frame(0, 7, 2), a_frame(1, 0, 0), a_frame(2, 1, 1)]
    path = written(tmp_path, frames)
    alone = [read_frame_paths(path, row) for row in range(3)]
    for read, given in zip([*read_paths(path), *alone], frames * 2, strict=True):
        for name in ("frame_id", "scene", "seed", "pose", "wavelength_m", "point_targets", "things"):
            assert getattr(read, name) == getattr(given, name)
        assert read.table.objects == given.table.objects
        assert read.table.counts == given.table.counts
        assert different_columns(read.table, given.table) == []


def test_a_row_that_is_not_there_is_named(tmp_path):
    path = written(tmp_path, [a_frame(0, 7, 2)])
    with pytest.raises(InputError, match="1 rows, row 1 was asked for"):
        read_frame_paths(path, 1)
