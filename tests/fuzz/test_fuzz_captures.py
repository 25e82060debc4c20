"""Raw captures, their radar files and calibrations, damaged and odd: they are read, or said no to in one line.

See ``tests/fuzzing.py``.
"""

from __future__ import annotations

import io
import json
import sys
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import scipy.io
from fuzzing import EDITS, JSON, SPLICES, Edit, Splice, altered, damaged, edited, fuzz, reads_or_says_one_line
from hypothesis import strategies as st
from numpy_bytes import of_array

from shared.dataset.documents import sealed
from shared.radar import load_radar

sys.path.append(str(Path(__file__).resolve().parents[1] / "trainer"))
from raw_files import quantised, radar_file, scene, write_cascade, write_two_lanes

from trainer.captures.calibration import read_calibration, to_toml
from trainer.captures.cube_file import Capture, read_cube, write_cube
from trainer.captures.importing import import_capture, read_capture
from trainer.captures.samples import Reading

ALTERATIONS = st.lists(st.tuples(st.floats(0.0, 1.0), JSON), min_size=1, max_size=3)
CFG = b"""% comment
channelCfg 15 5 0
adcCfg 2 1
profileCfg 0 77 7 6 60 0 0 20 1 256 5209 0 0 30
chirpCfg 0 0 0 0 0 0 0 1
chirpCfg 1 1 0 0 0 0 0 4
frameCfg 0 1 16 0 100 1 0
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A capture in each format, by names that begin with "good"."""
    made = tmp_path_factory.mktemp("captures")
    radar = load_radar(str(radar_file(made, "iwr1642")))
    cube = scene(radar, 2)
    write_two_lanes(made / "good.bin", cube, radar)
    (made / "good.npy").write_bytes(of_array(quantised(cube)))
    buffer = io.BytesIO()
    scipy.io.savemat(buffer, {"adc": quantised(cube), "time": np.arange(3, dtype=np.int16)})
    (made / "good.mat").write_bytes(buffer.getvalue())
    with h5py.File(made / "good.h5", "w") as file:
        file.create_dataset("adc", data=quantised(cube), chunks=True, compression="gzip")
    cascade = made / "cascade"
    cascade.mkdir()
    four = load_radar(str(radar_file(cascade, "mmwcas", "tx = [12]")))
    write_cascade(cascade, scene(four), four)
    return made


def read(path: Path) -> None:
    """With the axes of the cube's file, where it is one of arrays."""
    axes = None if path.suffix == ".bin" else "frame chirp sample (rx tx)"
    found = read_capture(path, Reading("iwr1642", str(path.parent / "capture.toml"), axes))
    assert np.isfinite(found.cube).all()


def try_damaged(folder: Path, name: str, content: bytes) -> None:
    path = folder / name
    path.write_bytes(content)
    reads_or_says_one_line(lambda: read(path))


@pytest.mark.parametrize("suffix", ["bin", "npy", "mat", "h5"])
def test_the_undamaged_files_are_read(folder: Path, suffix: str) -> None:
    read(folder / f"good.{suffix}")


@pytest.mark.parametrize("suffix", ["bin", "npy", "mat", "h5"])
@fuzz(60, splices=SPLICES, keep=st.floats(0.0, 1.0))
def test_damaged_captures(folder: Path, suffix: str, splices: list[Splice], keep: float) -> None:
    whole = (folder / f"good.{suffix}").read_bytes()
    try_damaged(folder, f"bad.{suffix}", damaged(whole, splices))
    try_damaged(folder, f"bad.{suffix}", whole[: int(keep * len(whole))])


@fuzz(40, splices=SPLICES, of=st.sampled_from(["master_0000_data", "slave2_0000_data", "master_0000_idx"]))
def test_damaged_cascade(folder: Path, splices: list[Splice], of: str) -> None:
    path = folder / "cascade" / f"{of}.bin"
    whole = path.read_bytes()
    try:
        path.write_bytes(damaged(whole, splices))
        reading = Reading("mmwcas", str(folder / "cascade" / "capture.toml"))
        reads_or_says_one_line(lambda: read_capture(folder / "cascade", reading))
    finally:
        path.write_bytes(whole)


@fuzz(100, edits=EDITS)
def test_edited_chirps(folder: Path, edits: list[Edit]) -> None:
    (folder / "edited.cfg").write_bytes(edited(CFG, edits))
    reads_or_says_one_line(lambda: read_capture(folder / "good.bin", Reading("iwr1843", str(folder / "edited.cfg"))))
    (folder / "edited.toml").write_bytes(edited((folder / "capture.toml").read_bytes(), edits))
    reads_or_says_one_line(lambda: read_capture(folder / "good.bin", Reading("iwr1642", str(folder / "edited.toml"))))


@fuzz(100, text=st.text("() framechiptxsqlo\n", max_size=40))
def test_odd_axes(folder: Path, text: str) -> None:
    reading = Reading("iwr1642", str(folder / "capture.toml"), text)
    reads_or_says_one_line(lambda: read_capture(folder / "good.npy", reading))


def _calibration(folder: Path) -> dict[str, Any]:
    radar = load_radar(str(folder / "capture.toml"))
    channels, waveform = radar.array.channels, radar.waveform
    document = {
        "board": "iwr1642", "array": radar.array.model_dump(), "carrier_hz": waveform.carrier_hz,
        "bandwidth_hz": waveform.bandwidth_hz, "gain_db": [0.5] * channels, "phase_deg": [3.0] * channels,
        "delay_s": [1e-12] * channels, "dead_channels": [2], "model_error_db": -20.5,
        "captures": [{"source": "a.bin", "source_sha256": "0" * 64, "range_m": 3.0, "angle_deg": 1.0}],
    }  # fmt: skip
    return sealed(document)


@fuzz(100, alterations=ALTERATIONS, splices=SPLICES)
def test_odd_calibrations(folder: Path, alterations: list[tuple[float, Any]], splices: list[Splice]) -> None:
    """Whole files of odd content with the checksum that belongs to it, and damaged ones."""
    path = folder / "c.toml"
    whole = _calibration(folder)
    path.write_text(to_toml(whole), encoding="utf-8")
    found = read_calibration(path)
    path.write_bytes(damaged(path.read_bytes(), splices))
    reads_or_says_one_line(lambda: read_calibration(path))
    odd = altered({name: value for name, value in whole.items() if name != "sha256"}, alterations)
    try:
        text = to_toml(sealed(odd))
    except (ValueError, AttributeError):  # NaN, or no table at all
        return
    path.write_text(text, encoding="utf-8", errors="surrogateescape")
    reading = Reading("iwr1642", str(folder / "capture.toml"), frames=(0, 1))
    reads_or_says_one_line(lambda: import_capture(folder / "good.bin", folder / "c.npz", reading, path, str))
    assert found.dead_channels == (2,)


@fuzz(100, alterations=ALTERATIONS)
def test_odd_descriptions_of_a_capture(folder: Path, alterations: list[tuple[float, Any]]) -> None:
    radar = load_radar(str(folder / "capture.toml"))
    capture = Capture(source="a", source_sha256="0" * 64, board="iwr1642", frames=1, scale="relative", noise_power=1.0)
    path = folder / "cube.npz"
    write_cube(path, quantised(scene(radar)), radar, capture)
    with np.load(path) as stored:
        content = dict(stored)
    odd = altered(json.loads(str(content["capture"])), alterations)
    np.savez(path, **(content | {"capture": np.asarray(json.dumps(odd))}))
    reads_or_says_one_line(lambda: read_cube(path, None))
