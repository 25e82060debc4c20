"""The price list: errors fall where accuracy is bought, the choice is the cheapest that keeps the budget."""

from __future__ import annotations

import csv
import json
from dataclasses import asdict, replace

import numpy as np
import pyarrow.parquet as pq
import pytest
from oracles import doppler_filtered, if_cube, peak_error_db, relative_error
from sampled_frames import EFFECTS, POSE, order_of_two, samples_at

from datafactory.accuracy import chart, report
from datafactory.accuracy.clock import Clock
from datafactory.accuracy.errors import FLOOR_DB, detections_changed, level_db, peak_error, relative_l2
from datafactory.accuracy.front import EVERYTHING, KNOBS, SAME_PATHS
from datafactory.accuracy.knobs import (
    DEFAULT,
    POWER_EFFECTS,
    Knob,
    KnobSettings,
    converged,
    effect_knobs,
)
from datafactory.accuracy.looking import reference_of, run
from datafactory.accuracy.row import Row
from datafactory.accuracy.samples import SampleFrame, lit_paths, made_with, traced
from datafactory.accuracy.variants import float32_geometry, linear_delays, reference_moments
from datafactory.accuracy.work import Work, cube_work, frame_work, trace_work, truth_work
from datafactory.effects.catalogue import ALL, NAMES, NO_CHOICE, EffectSet
from datafactory.frame.chain import ChainSettings
from datafactory.frame.measurement import Processing
from datafactory.paths.density import cell_power
from datafactory.paths.solver import TraceSettings
from datafactory.paths.table import PathTable, ScatteredPaths, SpecularPaths
from datafactory.run.making import render
from datafactory.run.pipeline import Execution
from datafactory.run.preparation import prepare
from datafactory.scenes.materials.table import load_materials
from datafactory.synthesis.sorting import sorted_paths
from shared.dataset.folder import open_dataset
from shared.radar import ImageGrid, Radar
from shared.radar.waveform import Waveform
from shared.signal.imaging import sweep_moments


@pytest.fixture
def table(generator) -> PathTable:
    """Moving points and one image of the TX, all within the small radar's range."""
    count = 12
    position = generator.uniform([3.0, -6.0, -1.0], [10.0, 6.0, 1.0], (count, 3))
    amplitude = np.exp(2j * np.pi * generator.random(count))
    scattered = ScatteredPaths.of_points(position, generator.uniform(-9.0, 9.0, (count, 3)), amplitude)
    # The points as the RX sees them lie elsewhere, so that a variant that mixes up the two sides shows.
    scattered = replace(
        scattered, rx_point=position + generator.uniform(0.1, 1.0, (count, 3)), between_m=np.full(count, 1.0)
    )
    normal = np.array([-1.0, 0.2, 0.1]) / np.linalg.norm([-1.0, 0.2, 0.1])
    specular = SpecularPaths(
        image=np.array([[20.0, -5.0, -2.0]]),
        image_velocity=np.array([[-6.0, 3.0, 0.0]]),
        axes=(np.eye(3) - 2.0 * np.outer(normal, normal))[None],
        amplitude=np.array([2.0 + 0.5j]),
        depth=np.ones(1, np.int8),
        object_index=np.zeros(1, np.int32),
        kinds=np.ones(1, np.uint8),
    )
    return PathTable(scattered, specular)


def find(rows: list[Row], knob: str, value: object) -> Row:
    return next(row for row in rows if (row.knob, row.setting) == (knob, str(value)))


def test_errors_have_a_finite_floor_and_a_scale():
    one = np.array([3.0, 4.0j])
    assert relative_l2(one, one) == peak_error(one, one) == 0.0
    assert level_db(0.0) == FLOOR_DB
    assert relative_l2(1.1 * one, one) == pytest.approx(0.1)
    assert peak_error(one + np.array([0.4, 0.0]), one) == pytest.approx(0.1)
    assert relative_l2(one, 0.0 * one) == 1.0


def test_detections_match_within_one_cell():
    expected = np.zeros((8, 8), bool)
    expected[2, 2] = expected[6, 6] = True
    moved = np.roll(expected, 1, axis=1)
    assert detections_changed(moved, expected) == 0.0
    assert detections_changed(np.roll(expected, 3, axis=1), expected) == 200.0
    assert detections_changed(np.zeros_like(expected), expected) == 100.0


def test_linear_delays_touch_the_exact_ones_at_mid_frame(radar, table):
    """From the origin: value and first derivative agree at mid-frame, the second derivative is gone."""
    linear = linear_delays(table, radar)
    middle, step = radar.waveform.mid_frame_s, 1e-3

    def lengths(paths: PathTable, time: float) -> np.ndarray:
        part = paths.scattered
        both = [
            np.linalg.norm(getattr(part, f"{e}_point") + getattr(part, f"{e}_velocity") * time, axis=1)
            for e in ("tx", "rx")
        ]
        image = np.linalg.norm(paths.specular.image + paths.specular.image_velocity * time, axis=1)
        return np.append(both[0] + both[1], image)

    def bend(paths: PathTable) -> np.ndarray:
        return (lengths(paths, middle + step) - 2.0 * lengths(paths, middle) + lengths(paths, middle - step)) / step**2

    np.testing.assert_allclose(lengths(linear, middle), lengths(table, middle), rtol=1e-13)
    rates = [(lengths(t, middle + step) - lengths(t, middle - step)) / (2 * step) for t in (linear, table)]
    np.testing.assert_allclose(rates[0], rates[1], atol=1e-4)
    assert np.abs(bend(linear)).max() < 1e-6 * np.abs(bend(table)).max() + 1e-7
    assert np.abs(bend(table)).max() > 1.0


def test_float32_geometry_moves_points_by_less_than_its_rounding(table):
    rounded = float32_geometry(table)
    moved = np.abs(rounded.scattered.tx_point - table.scattered.tx_point)
    assert 0.0 < moved.max() <= np.abs(table.scattered.tx_point).max() * 2.0**-24
    np.testing.assert_array_equal(rounded.scattered.amplitude, table.scattered.amplitude)


def test_reference_moments_are_those_of_the_whole_virtual_cube(radar, table):
    cells = np.random.default_rng(5).integers(0, radar.waveform.chirps, radar.waveform.range_bins)
    moments = reference_moments(table, radar, cells, 4)
    some = (0, 100, 255)  # elements of three blocks
    sensor = radar.virtual_sensor.model_copy(update={"rx_m": tuple(radar.virtual_sensor.rx_m[e] for e in some)})
    cube = if_cube(table, radar, sensor)
    for cell in np.unique(cells):
        rows = np.flatnonzero(cells == cell)
        expected = sweep_moments(doppler_filtered(cube, radar, int(cell)), radar, 4)[:, rows]
        assert peak_error_db(moments[:, rows][:, :, some], expected) < -100.0


def test_cell_power_keeps_the_power_of_every_path_in_range(samples, radar):
    paths = lit_paths(samples[0], replace(DEFAULT, rays=2000, effects=EFFECTS), radar)
    inside = np.rint(paths.scattered.range_m() / radar.waveform.range_step_m) < radar.waveform.range_bins
    images = np.rint(paths.specular.range_m() / radar.waveform.range_step_m) < radar.waveform.range_bins
    expected = (np.abs(paths.scattered.amplitude[inside]) ** 2).sum()
    expected += (np.abs(paths.specular.amplitude[images]) ** 2).sum()
    assert expected > 0.0
    assert cell_power(paths, radar, "taylor-30").sum() == pytest.approx(expected, rel=1e-12)


def test_tighter_settings_have_smaller_errors(rows):
    cube = [find(rows, "tolerance", value).cube_error_db for value in (1e-3, 1e-6, 1e-9)]
    assert cube[0] > cube[1] > cube[2]
    assert all(error <= 20.0 * np.log10(promise) for error, promise in zip(cube, (1e-3, 1e-6, 1e-9), strict=True))
    assert find(rows, "prune_db", -20.0).cube_error_db > find(rows, "prune_db", -40.0).cube_error_db
    assert find(rows, "truth_wave", "plane").image_error_db > find(rows, "truth_terms", 6).image_error_db + 10.0
    exact = find(rows, "tolerance", 1e-6).cube_error_db
    for knob, value in (("delays", "linear"), ("width", "float32 geometry")):
        assert find(rows, knob, value).cube_error_db > exact
    assert find(rows, "rays", 500).image_error_db > find(rows, "rays", 4000).image_error_db
    few, many = find(rows, "rays", 500).power_l1_db, find(rows, "rays", 4000).power_l1_db
    assert few is not None
    assert many is not None
    assert few > many
    assert find(rows, "diffuse", "off").power_bias_db < 0.0 < find(rows, "diffraction", "on").power_bias_db


def test_the_surface_turns_phases_alone(rows, samples, radar):
    """Not a watt in any cell, and yet another signal."""
    assert find(rows, "surface_phase", "off").image_error_db == FLOOR_DB
    settings = replace(DEFAULT, rays=1000, effects=EFFECTS)
    rough, smooth = (
        lit_paths(samples[0], replace(settings, surface_phase=on), radar).scattered for on in (True, False)
    )
    np.testing.assert_allclose(np.abs(rough.amplitude), np.abs(smooth.amplitude), rtol=1e-12)
    assert relative_l2(rough.amplitude, smooth.amplitude) > 0.5


def test_more_truth_terms_follow_the_range_walk(variant, radar):
    """From a radar at rest, where the Doppler filter adds no error of its own."""
    still = samples_at(radar, replace(POSE, velocity=(0.0, 0.0, 0.0)))
    settings = replace(converged(DEFAULT), rays=2000, effects=EFFECTS)
    frames = [traced(still[0], settings, radar)]
    reference = reference_of(frames, settings, radar)
    errors = []
    for terms in (3, 4, 6):
        outcome = run(frames, replace(settings, truth_terms=terms), radar, Clock(), reference.cells, batch=1)
        errors.append(level_db(peak_error(outcome.images[0], reference.images[0])))
    assert errors[0] > errors[1] + 5.0
    assert errors[1] > errors[2] + 5.0
    assert errors[2] < -70.0


def test_every_row_is_priced(rows):
    assert rows[0].knob == "defaults"
    for row in rows:
        assert set(row.stage_seconds) == {"trace", "delays and spread", "range-Doppler", "truth", "image", "write"}
        assert row.seconds == pytest.approx(sum(row.stage_seconds.values()))
        assert all(FLOOR_DB <= error < 60.0 for error in (row.cube_error_db, row.image_error_db, row.image_l2_db))
        assert row.work > 0.0
        assert row.peak_mb >= 0.0
        assert row.reference
        assert (row.power_l1_db is None) == (row.kind != "power")
        assert (row.seconds_beside is None) == (row.knob in ("defaults", "sphere rays", *KNOBS) or row.kind == "front")
    assert [row.setting for row in rows if row.default and row.knob == "tolerance"] == ["0.001"]


def test_tables_and_picture(rows, tmp_path):
    parquet, text = report.write_tables(rows, tmp_path)
    picture = chart.write_picture(rows, "tiny", tmp_path)
    read = pq.read_table(parquet).to_pylist()
    columns = {
        "knob", "setting", "seconds", "stage_seconds", "cube_error_db", "image_error_db", "detections_changed",
        "peak_mb", "reference",
    }  # fmt: skip
    assert columns <= set(read[0])
    assert read == [asdict(row) for row in rows]
    with text.open(encoding="utf-8", newline="") as handle:
        lines = list(csv.DictReader(handle))
    assert [float(line["cube_error_db"]) for line in lines] == [row.cube_error_db for row in rows]
    assert json.loads(lines[0]["stage_seconds"]) == rows[0].stage_seconds
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert len(report.table_rows(rows)[0]) == len(report.HEADINGS)


def test_the_sweep_measures_its_front(rows):
    front = [row for row in rows if row.kind == "front"]
    assert {row.knob for row in front} == {EVERYTHING, SAME_PATHS}
    for row in front:
        assert (row.power_error_db is None) == (row.knob == SAME_PATHS)
        # What was predicted from single knobs is what all of them have together, to a decibel or two.
        assert chart.front_error_db(row) <= float(row.setting.split(" dB")[0]) + 2.0
    assert "What does accuracy cost?" in {axis.get_title(loc="left") for axis in chart.draw(rows, "tiny").axes}


def test_work_counts_what_is_bought(table):
    radar = Radar(waveform=Waveform(samples=128, chirps=32, range_bins=96), grid=ImageGrid(bins=48))

    def cube(paths: PathTable, tolerance: float) -> Work:
        by_kernel = sorted_paths(paths, radar, tolerance, radar.array, intra_chirp=False)
        return cube_work(by_kernel, radar, tolerance, radar.array, intra_chirp=False)

    standing = table.at_rest(0.0)
    found = [cube(table, tolerance).by_paths for tolerance in (1e-2, 1e-3, 1e-6, 1e-9)]
    assert found == sorted(found)
    assert found[-1] > 5.0 * found[0]
    # One chirp for all of 32.
    assert cube(standing, 1e-9).by_paths == pytest.approx(found[-1] / 32)
    doubled = replace(table, scattered=ScatteredPaths.joined([table.scattered, table.scattered]))
    assert found[0] < cube(doubled, 1e-2).by_paths < 2.0 * found[0]
    assert cube(doubled, 1e-2).fixed == cube(table, 1e-2).fixed
    cells = np.full(96, 16)
    terms = [truth_work(table, radar, cells, count, intra_chirp=False) for count in (3, 6)]
    assert terms[0].fixed < terms[1].fixed
    assert terms[0].by_paths == terms[1].by_paths
    for dearer in (replace(DEFAULT, rays=400_000), replace(DEFAULT, depth=3)):
        assert trace_work(dearer) > trace_work(DEFAULT)
    # Few rays are not for nothing: every pass has its price, and a single bounce has one pass of three.
    few = replace(DEFAULT, rays=1)
    assert trace_work(few) == pytest.approx(3.0 * trace_work(replace(few, depth=1)), rel=1e-3)
    assert frame_work(replace(DEFAULT, truth_terms=6), radar) > frame_work(DEFAULT, radar)


def test_default_settings_are_those_of_a_run() -> None:
    silent = ChainSettings(processing=Processing(noise=False))
    assert DEFAULT.chain() == ALL.settings(silent)
    for name in NAMES:
        effects = ALL.without(name)
        settings = replace(DEFAULT, effects=effects)
        assert settings.chain() == effects.settings(silent)
        # What changes no path leaves the realisations kept for others valid.
        assert (settings.tracing() == DEFAULT.tracing()) == (name not in POWER_EFFECTS)
    assert {*POWER_EFFECTS, *NO_CHOICE, "doppler", "noise"} == set(NAMES)


@pytest.mark.parametrize("left_out", [(), ("doppler",), ("near_field", "antenna_pattern")])
def test_a_frame_of_the_sweep_is_a_frame_of_the_run(left_out, radar, tmp_path, variant) -> None:
    """Rendered by the pipeline itself, without noise."""
    effects = EffectSet.of(set(NAMES) - {"noise", "diffraction", "refraction", *left_out})
    settings = ChainSettings(trace=TraceSettings(rays=1000), processing=Processing(store="cube"))
    order = replace(order_of_two(radar), poses=(POSE,), effects=effects, seed=5, settings=settings)
    render(order, load_materials(None), Execution(tmp_path / "data"))
    (expected,) = open_dataset(tmp_path / "data").frames("train")

    prepared = prepare(order, load_materials(None))
    sample = SampleFrame(prepared.deal.frame(0), prepared.scenes[0])
    knobs = replace(made_with(order), rays=1000)
    outcome = run([traced(sample, knobs, radar)], knobs, radar, Clock(), batch=1)
    assert expected.cube is not None
    assert relative_error(outcome.cubes[0], expected.cube) < 1e-6
    assert peak_error_db(outcome.images[0], expected.image * expected.image_peak) < -60.0


def test_what_a_frame_has_is_left_out_in_turn():
    knobs = effect_knobs({"diffuse", "doppler", "near_field", "multi_bounce", "noise"})
    assert {knob.name: (knob.values, knob.power) for knob in knobs} == {
        "doppler": ((False,), False),
        "diffuse": ((False,), True),
    }
    off = Knob("diffuse", (False,), power=True).at(DEFAULT, False)
    assert off == replace(DEFAULT, effects=ALL.without("diffuse"))
    sphere = Knob("rays", (7,), beside=("lattice", "sphere")).at(DEFAULT, 7)
    assert sphere == KnobSettings(rays=7, lattice="sphere")
    with pytest.raises(ValueError, match="moonlight"):
        Knob("moonlight", (True,))
