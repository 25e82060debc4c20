"""The main job from the command line, on a small radar: bytes, resume, splits, and the one line for each bad input."""

import json
import threading
from contextlib import suppress
from dataclasses import replace
from itertools import groupby
from pathlib import Path

import numpy as np
import pytest
from factory_command import but_made, frames_of, run, shards
from prepared_scenes import TINY
from town_scenes import flat, sheet

from datafactory.api.asking import order_of
from datafactory.api.forecasting import START_S, forecast
from datafactory.api.making import render
from datafactory.api.options import OrderOptions
from datafactory.frame.chain import FRAMES_WITH
from datafactory.frame.draws import frame_seed
from datafactory.inspection.dataset import MEANINGS, told
from datafactory.run import portions
from datafactory.run.preparation import prepare
from datafactory.scenes.materials.table import load_materials
from datafactory.scenes.poses import Pose
from datafactory.scenes.scene import PointTarget, Scene
from shared.dataset import arrow_schema
from shared.dataset.folder import open_dataset, read_manifest, verify
from shared.dataset.reading import open_shard, read_description
from shared.physics.errors import InputError
from shared.radar import load_radar
from shared.signal import if_signal, target_amplitudes

TWELVE = ("--frames", 9, "--points", 3, "--workers", 1)


def rendered(out: Path, radar: Path, *more: object) -> Path:
    run("render", "--scene", TINY, "--radar", radar, "--rays", 4000, "--out", out, *more)
    return out


@pytest.fixture(scope="module")
def dataset(tmp_path_factory, radar_file) -> Path:
    return rendered(tmp_path_factory.mktemp("reference") / "data", radar_file, *TWELVE)


def test_the_dataset_is_whole_split_by_the_pattern_counted_and_of_the_schema_that_was_meant(dataset):
    opened = open_dataset(dataset)
    assert verify(opened) == []
    kinds = {frame_id: (split, frame.kind) for frame_id, (split, frame) in frames_of(dataset).items()}
    assert sorted(kinds) == list(range(12))
    assert {index for index, (split, _) in kinds.items() if split == "validation"} == {6}
    assert {index for index, (split, _) in kinds.items() if split == "test"} == {7}
    assert [kinds[index][1] for index in range(12)] == ["scene"] * 9 + ["points"] * 3
    counts = read_manifest(dataset)["counts"]
    assert {name for name in counts if not name.startswith(FRAMES_WITH)} <= set(MEANINGS)
    # Down to the elements of the lists, never null: a list whose elements may be costs a quarter more to read.
    for shard in opened.splits["train"]:
        with open_shard(shard) as file:
            assert file.schema_arrow.equals(arrow_schema(read_description(shard)), check_metadata=True)


def test_workers_do_not_change_the_bytes(dataset, radar_file, tmp_path):
    other = rendered(tmp_path / "data", radar_file, *TWELVE[:4], "--workers", 2)
    assert shards(other) == shards(dataset)
    assert but_made(other) == but_made(dataset)


def test_a_frame_does_not_depend_on_how_many_are_rendered(dataset, radar_file, tmp_path):
    """Frame 1 of a run of two is frame 1 of the run of twelve: same seed, pose, paths, noise, image."""
    short = rendered(tmp_path / "data", radar_file, "--frames", 2, "--workers", 1)
    ours = list(open_dataset(dataset).frames("train"))[1]
    theirs = list(open_dataset(short).frames("train"))[1]
    assert theirs.seed == ours.seed == frame_seed(0, 1)
    for name in ("range_channel", "velocity", "image"):
        np.testing.assert_array_equal(getattr(theirs, name), getattr(ours, name))
    assert theirs.targets == ours.targets


def test_a_killed_run_resumes_to_the_same_bytes(dataset, radar_file, tmp_path, monkeypatch):
    """The run dies after its first shard was recorded: --resume ends where an undisturbed run ends."""
    out, recorded, record = tmp_path / "data", list[object](), portions.record_finished

    def dies_at_the_second(directory, plan, finished):
        if recorded:
            raise OSError(28, "No space left on device")
        recorded.append(plan)
        record(directory, plan, finished)

    monkeypatch.setattr(portions, "record_finished", dies_at_the_second)
    with pytest.raises(OSError, match="No space left"):
        rendered(out, radar_file, *TWELVE)
    monkeypatch.undo()
    assert not (out / "manifest.json").exists()
    with pytest.raises(InputError, match="seed"):
        rendered(out, radar_file, *TWELVE, "--resume", "--seed", 5)
    rendered(out, radar_file, *TWELVE, "--resume")
    assert shards(out) == shards(dataset)
    assert but_made(out) == but_made(dataset)


def test_exact_targets_give_the_sum_of_equation_one(radar_file, tmp_path):
    near = {"x": 5.0, "y": 1.0, "rcs_dbsm": 0.0, "phase": 0.3}
    far = {"x": 20.0, "y": -9.0, "z": 0.5, "vx": -8.0, "rcs_dbsm": 10}
    file = tmp_path / "targets.json"
    file.write_text(json.dumps([[near, far]]), encoding="utf-8")
    out = tmp_path / "data"
    run("points", "--targets", file, "--no-noise", "--store", "cube", "--radar", radar_file, "--out", out)
    (frame,) = open_dataset(out).frames("train")
    radar = load_radar(str(radar_file))
    position = np.array([[5.0, 1.0, 0.0], [20.0, -9.0, 0.5]])
    velocity = np.array([[0.0, 0.0, 0.0], [-8.0, 0.0, 0.0]])
    amplitude = target_amplitudes(radar, position, np.array([0.0, 10.0]), np.array([0.3, 0.0]))
    reference = if_signal(radar, position, velocity, amplitude)
    assert np.linalg.norm(frame.cube - reference) <= 1e-6 * np.linalg.norm(reference)
    assert frame.noise_power == 0.0
    levels = [target.amplitude_db for target in frame.targets]
    np.testing.assert_allclose(levels, sorted(20 * np.log10(np.abs(amplitude)), reverse=True), atol=1e-9)
    approaching = min(frame.targets, key=lambda target: target.velocity_mps)
    assert approaching.velocity_mps == pytest.approx(-8.0 * 20.0 / np.linalg.norm(position[1]), rel=1e-3)


def test_rendering_from_traced_paths_gives_the_same_frames(dataset, radar_file, tmp_path):
    """The trace of a scene, rendered later, is the scene rendered at once; so is a second radar's."""
    here = ("--radar", radar_file, "--workers", 1)
    run("trace", "--scene", TINY, *here, "--rays", 4000, "--frames", 9, "--out", tmp_path / "trace")
    again = tmp_path / "data"
    for more in ((), ("--verify",)):
        said = run("inspect", tmp_path / "trace", *more)
        assert said.endswith(
            f"traced paths and no frames; next: datafactory render --paths {tmp_path / 'trace'} --out OTHER\n"
        )
    assert "as they were written" in said
    run("render", "--paths", tmp_path / "trace", *here, "--points", 3, "--out", again)
    assert shards(again) == shards(dataset)
    with pytest.raises(InputError, match="no traced paths"):
        run("render", "--paths", dataset, "--radar", radar_file, "--out", tmp_path / "other")
    near, far = tmp_path / "near.toml", tmp_path / "far.toml"
    for path, carrier in ((near, "78.5e9"), (far, "78.6e9")):  # 1.91 and 2.03 % from 77.2 GHz
        path.write_text(radar_file.read_text().replace("[waveform]", f"[waveform]\ncarrier_hz = {carrier}"))
    run("view", "--paths", tmp_path / "trace", "--radar", near, "--out", tmp_path / "near.html")
    for command, out in (("render", "other"), ("view", "other.html")):
        with pytest.raises(
            InputError, match=r"traced at 77\.2 GHz, the radar has 78\.8 GHz .*; expected .* within 2 %"
        ):
            run(command, "--paths", tmp_path / "trace", "--radar", far, "--out", tmp_path / out)
        assert not (tmp_path / out).exists()


def test_ground_too_small_for_a_split_is_refused_before_the_run_begins(radar_file, tmp_path):
    yard = Scene("yard", (sheet("floor", (0.0, 12.0), (0.0, 8.0), flat),))
    with pytest.raises(InputError, match="yard: no free ground is left for validation"):
        render(yard, tmp_path / "out", radar=radar_file, frames=7, rays=100)
    assert not (tmp_path / "out").exists()
    assert render(yard, tmp_path / "out", radar=radar_file, frames=1, rays=100).frames == 1


def test_targets_beyond_the_unambiguous_range_are_said(radar_file, tmp_path):
    """48 m of this radar: those of a list fold, those of a scene are left out."""
    (tmp_path / "far.json").write_text('[[{"x": 60, "y": 0, "rcs_dbsm": 30}]]', encoding="utf-8")
    said = run("points", "--targets", tmp_path / "far.json", "--radar", radar_file, "--out", tmp_path / "points")
    assert "1 targets of a list beyond the unambiguous range, folded onto a nearer one" in said
    yard = sheet("floor", (0.0, 12.0), (0.0, 8.0), flat)
    scene = Scene("yard", (yard,), tuple(PointTarget(f"at {x}", (x, 4.0, 0.5), 30.0) for x in (6.0, 40.0, 80.0)))
    here, out = [Pose((6.0, 4.0, 0.5))], tmp_path / "scene"
    for effects in ("all", "auto"):
        report = render(scene, out / effects, radar=radar_file, poses=here, rays=100, effects=effects)
        assert report.counts["targets_beyond_range"] == 1
    lines = told(report.counts, verbose=False)
    assert "1 echo points of targets beyond the unambiguous range, left out" in lines
    assert "1 echo points of targets within 1 cm of the sensor, left out" in lines


def test_traced_paths_keep_their_split(radar_file, tmp_path):
    """Drawn poses stand in their split's region: the split of the trace is taken, and another one refused."""
    traced = tmp_path / "traced"
    run("trace", "--scene", TINY, "--radar", radar_file, "--rays", 500, "--frames", 4, "--split", "2:1:1",
        "--effects", "diffuse,noise", "--workers", 1, "--out", traced)  # fmt: skip
    run("render", "--paths", traced, "--radar", radar_file, "--workers", 1, "--out", tmp_path / "data")
    assert [len(open_dataset(tmp_path / "data").rows(split)) for split in ("train", "validation", "test")] == [2, 1, 1]
    with pytest.raises(InputError, match=r"--split: '6:1:1': the poses of .* were drawn in the regions of '2:1:1'"):
        run("render", "--paths", traced, "--radar", radar_file, "--split", "6:1:1", "--out", tmp_path / "other")


def test_threads_of_a_process_take_turns_and_make_what_each_makes_alone(radar_file, tmp_path):
    """They moved each other's scenes: frames were wrong, without a word."""
    meeting, reports = threading.Barrier(2), []

    def make(seed: int, out: Path, together: bool) -> None:
        def told(*_: object) -> None:
            reports.append(seed)
            if together and reports.count(seed) == 1:
                with suppress(threading.BrokenBarrierError):  # the other one waits for its turn
                    meeting.wait(1.0)

        render(TINY, out, radar=radar_file, frames=2, rays=200, workers=1, seed=seed, progress=told)

    for seed in (1, 2):
        make(seed, tmp_path / f"alone {seed}", together=False)
    reports.clear()
    threads = [threading.Thread(target=make, args=(seed, tmp_path / f"at once {seed}", True)) for seed in (1, 2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert [seed for seed, _ in groupby(reports)] in ([1, 2], [2, 1])
    for seed in (1, 2):
        assert shards(tmp_path / f"at once {seed}") == shards(tmp_path / f"alone {seed}")


def test_a_dry_run_says_what_the_run_will_take_and_writes_nothing(dataset, radar_file, tmp_path):
    out = tmp_path / "new" / "data"
    said = run("render", TINY, "--radar", radar_file, "--rays", 4000, "--out", out, *TWELVE, "--dry-run").splitlines()
    assert said[0] == "12 frames (train 10, validation 1, test 1) in 4 shards"
    assert len(list(dataset.glob("*/*.parquet"))) == 4
    assert not out.parent.exists()
    order = order_of(OrderOptions(str(TINY), radar=radar_file, frames=9, points=3, rays=4000))
    found = forecast(prepare(order, load_materials()), out, 8)
    stored = sum(path.stat().st_size for path in dataset.glob("*/*.parquet"))
    assert stored / 3 < found.bytes < 3 * stored
    assert found.workers == 8  # frames are dealt, not shards
    more = forecast(prepare(replace(order, frames=18), load_materials()), out, 8)
    assert more.seconds > found.seconds > START_S  # what comes before the first frame is counted
    with pytest.raises(InputError, match="no such file"):
        run("render", "none.usda", "--out", out, "--dry-run")
