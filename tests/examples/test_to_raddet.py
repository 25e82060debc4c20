"""RADDet's folders: its loader reads them, and a target stands where its box says, on all three axes.

The loader is the one of https://github.com/ZhangAoCanada/RADDet (``util/loader.py``, ``util/helper.py``,
``dataset/batch_data_generator.py``); what it does with the files, and what it asks of them, is written down again here.
"""

import json
import pickle
from pathlib import Path

import numpy as np
import pytest
from boxed_frames import RADAR, box, frame, write
from examples_run import example

STEP_M = RADAR.waveform.range_step_m


def load(folder: Path, split: str) -> dict[int, tuple[np.ndarray, dict]]:
    """What the loader's generator gives of a split, by frame: the log spectra, and the instances."""
    settings = json.loads((folder / "config.json").read_text())
    data, found = settings["DATA"], {}
    for file in sorted(map(str, (folder / data[f"{split}_set_dir"]).glob("RAD/*/*.npy"))):
        spectra = np.load(file)
        assert spectra.dtype == np.complex64  # as complexTo2Channels asserts
        level = np.log10(np.abs(spectra) ** 2 + 1.0)
        level = (level - data["global_mean_log"]) / data["global_variance_log"]
        assert list(level.shape) == settings["MODEL"]["input_shape"]
        with open(
            str(folder / data[f"{split}_set_dir"] / "gt") + file.split("RAD")[-1].replace("npy", "pickle"), "rb"
        ) as f:
            instances = pickle.load(f)
        assert instances["classes"], "readRadarInstances returns None, and the generator raises"
        for index, name in enumerate(instances["classes"]):
            assert data["all_classes"].index(name) >= 0
            row = instances["boxes"][index][np.newaxis, :].astype(np.float32)
            cell = np.floor(row[0, :3] / 16).astype(int)  # encodeToLabels, at the stride of the network's head
            assert (cell >= 0).all()
            assert (cell < np.array(level.shape) / 16).all()
            flat = instances["cart_boxes"][index]
            assert ((flat[:2] >= 0) & (flat[:2] < [level.shape[0], 2 * level.shape[0]])).all()
        found[int(Path(file).stem)] = level, instances
    return found


def polar(row: float, column: float, settings: dict) -> tuple[float, float]:
    """Range [m] and angle [rad] of a cell, as helper.toCartesianMask has them; the angle rises to the right."""
    radar = settings["RADAR_CONFIGURATION"]
    range_m = ((radar["range_size"] - 1) - row) * radar["range_resolution"]
    sine = (column * (2 * np.pi / radar["azimuth_size"]) - np.pi) / (
        2 * np.pi * 0.5 * radar["config_frequency"] / radar["designed_frequency"]
    )
    return range_m, float(np.arcsin(sine))


def test_the_loader_finds_targets_where_their_boxes_are(tmp_path: Path) -> None:
    """One to the left, receding by two Doppler cells; one to the right, approaching; what has no place is counted."""
    step = RADAR.waveform.velocity_step_mps
    left, right = box(10.0, 4.0, "pedestrian", speed=2.0 * step), box(18.0, -6.0, "car", speed=-3.0 * step, yaw=0.3)
    tram, hidden, far = box(12.0, 3.0, "tram"), box(15.0, 0.0, power=0.0), box(40.0, 0.0)
    frames = [frame(0, [left]), frame(1, [right]), frame(2, [right, tram, hidden, far]), frame(3, [tram])]
    source = write(tmp_path / "data", frames, ["train", "validation", "test", "train"])
    done = example("to_raddet", source, "--out", tmp_path / "out")
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.splitlines() == [
        f"3 frames in {tmp_path / 'out'}",
        "left out: 1 boxes beyond the range that is kept",
        "left out: 2 boxes of class 'tram', which RADDet does not have",
        "left out: 1 boxes of objects that the radar does not see",
        "left out: 1 frames without a box of these classes",
    ]
    settings = json.loads((tmp_path / "out" / "config.json").read_text())
    assert settings["MODEL"]["input_shape"] == [80, 256, 16]
    found = load(tmp_path / "out", "train")  # RADDet has no split for validation
    assert sorted(found) == [0, 1]
    last = load(tmp_path / "out", "test")
    assert (list(last), last[2][1]["classes"]) == ([2], ["car"])
    every = [level for level, _ in (*found.values(), *last.values())]
    assert max(float(level.max()) for level in every) == pytest.approx(1.0, abs=1e-6)
    assert np.mean([level.mean() for level in every]) == pytest.approx(0.0, abs=1e-5)
    for (level, instances), item, name in ((found[0], left, "person"), (found[1], right, "car")):
        assert instances["classes"] == [name]
        strongest = np.unravel_index(level.argmax(), level.shape)
        range_m, angle = polar(float(strongest[0]), float(strongest[1]), settings)
        assert range_m == pytest.approx(np.hypot(*item.center[:2]), abs=STEP_M)
        assert angle == pytest.approx(-np.arctan2(item.center[1], item.center[0]), abs=0.02)
        middle, width = instances["boxes"][0][:3], instances["boxes"][0][3:]
        assert (np.abs(np.array(strongest) - middle) <= 0.5 * width + 1.0).all()
        # On the squares: ahead is up, right is right, the radar in the middle of the last row.
        flat = instances["cart_boxes"][0]
        assert (79 - flat[0]) * STEP_M == pytest.approx(item.center[0], abs=1e-9)
        assert (flat[1] - 80) * STEP_M == pytest.approx(-item.center[1], abs=1e-9)


@pytest.mark.parametrize(
    ("store", "boxes", "message"),
    [
        ("range-channel", [box(9.0, 0.0)], "has no cubes: make it with --store cube"),
        ("cube", [box(9.0, 0.0, "tram")], "no frame has a box of person, "),
    ],
)
def test_a_dataset_without_what_it_needs_is_refused(store: str, boxes: list, message: str, tmp_path: Path) -> None:
    source = write(tmp_path / "data", [frame(0, boxes, store)], ["train"], store)
    done = example("to_raddet", source, "--out", tmp_path / "out")
    assert (done.returncode, message in done.stderr) == (2, True)
    assert [path.name for path in tmp_path.iterdir()] == ["data"]
