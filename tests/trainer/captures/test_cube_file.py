"""The file of a cube: what is written is read, and what was changed since is one line."""

import json
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from captured_cubes import write_plain_cube
from numpy.typing import NDArray
from tiny_radar import RADAR

from shared.physics.errors import InputError
from shared.signal import if_signal
from shared.signal.windows import cell_noise_power
from trainer import predict
from trainer.captures.cube_file import Capture, CubeFile, frame_shape, measured_noise, read_cube, write_cube
from trainer.data.measurements import open_measurements

CAPTURE = Capture(
    source="adc_data.bin", source_sha256="a" * 64, board="iwr1843", frames=2, scale="relative", noise_power=2.5,
    model_error_db=-21.5, dead_channels=(3,),
)  # fmt: skip


def frames(count: int) -> NDArray[np.complex64]:
    generator = np.random.default_rng(count)
    return (generator.standard_normal((count, *frame_shape(RADAR), 2)) @ np.array([1.0, 1.0j])).astype(np.complex64)


@pytest.mark.parametrize("count", [1, 2])
def test_what_is_written_is_read(tmp_path: Path, count: int) -> None:
    capture = CAPTURE.model_copy(update={"frames": count})
    for name in ("a.npz", "b.npz"):
        write_cube(tmp_path / name, frames(count), RADAR, capture)
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    with np.load(tmp_path / "a.npz") as stored:
        assert stored["cube"].ndim == (3 if count == 1 else 4)
    found = read_cube(tmp_path / "a.npz", None)
    np.testing.assert_array_equal(found.cube, frames(count))
    assert (found.radar, found.capture) == (RADAR, capture)


def test_every_frame_is_a_measurement_with_the_noise_that_was_measured(tmp_path: Path) -> None:
    write_cube(tmp_path / "drive.npz", frames(2), RADAR, CAPTURE)
    _, measurements = open_measurements(tmp_path / "drive.npz", None, "test")
    found = list(measurements)
    assert [(m.name, m.frame_id, m.noise_power) for m in found] == [
        ("drive-000000", 0, 2.5),
        ("drive-000001", 1, 2.5),
    ]
    assert not np.array_equal(found[0].cells.range_channel, found[1].cells.range_channel)


def test_noise_is_of_the_first_frame_that_is_not_empty() -> None:
    cube = 1e3 * frames(3)
    cube[:2] = 0.0
    noise = measured_noise(cube[2:], RADAR)
    assert noise > 0.0
    assert measured_noise(cube, RADAR) == noise == CubeFile(cube, RADAR, None).noise_power


@pytest.mark.parametrize("counts", [True, False])
def test_noise_that_no_capture_states_is_thermal_or_measured_where_the_samples_are_counts(
    tmp_path: Path, counts: bool
) -> None:
    """Two targets in noise: 1861 lines were listed of counts, whose noise was held to be that of sqrt(W)."""
    waveform = RADAR.waveform.model_copy(update={"chirps": 16, "samples": 64, "range_bins": 60})
    radar = RADAR.model_copy(update={"waveform": waveform})
    places = np.array([[3.0, 0.5, 0.0], [6.0, -1.0, 0.0]])
    noise = np.random.default_rng(1).standard_normal((16, 64, 6, 2)) @ np.array([0.5**0.5, 0.5**0.5 * 1j])
    cube = np.sqrt(radar.sample_noise_power_w) * (noise + if_signal(radar, places, 0.0 * places, np.full(2, 10 + 0j)))
    scale = 3.0 / np.sqrt(radar.sample_noise_power_w) if counts else 1.0
    path = write_plain_cube(tmp_path / "own.npz", scale * cube, radar)
    (measurement,) = open_measurements(path, None, "test")[1]
    assert measurement.noise_power == pytest.approx(
        scale**2 * cell_noise_power(radar), rel=0.1 if counts else 1e-12, abs=0.0
    )
    said = list[str]()
    predict([path], tmp_path / "out", method="das", points=True, false_alarms=0.01, announce=said.append)
    assert len(pq.read_table(tmp_path / "out/images.parquet")["detections"][0]) == 2
    remarks = [line for line in said if "noise as measured in the cube" in line]
    assert len(remarks) == counts
    assert all(line.startswith(f"{path}: ") for line in remarks)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"frames": 3}, "its entries have sha256"),
        ({"sha256": None, "frames": 3}, r"capture says 3 frames, cube has 2"),
        ({"sha256": None, "dead_channels": [7]}, r"capture names the dead channel 7; expected one of the 6"),
        ({"sha256": None, "noise_power": -1.0}, r"capture: noise_power = -1.0"),
        ({"sha256": None, "noise_power": 0.0}, r"noise of 0 beside .* expected adc_data.bin imported anew"),
    ],
)
def test_a_changed_capture_is_one_line(tmp_path: Path, changed: dict[str, object], message: str) -> None:
    write_cube(tmp_path / "cube.npz", frames(2), RADAR, CAPTURE)
    with np.load(tmp_path / "cube.npz") as stored:
        content = dict(stored)
    document = json.loads(str(content["capture"])) | changed
    document = {name: value for name, value in document.items() if value is not None or name != "sha256"}
    np.savez(tmp_path / "cube.npz", **(content | {"capture": np.asarray(json.dumps(document))}))
    with pytest.raises(InputError, match=message):
        read_cube(tmp_path / "cube.npz", None)
