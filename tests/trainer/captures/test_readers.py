"""Raw captures read back: a cube that was simulated, written in each format, is the same to its quantisation."""

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import scipy.io
from numpy.typing import NDArray
from raw_files import COUNTS, quantised, radar_file, radar_of, scene, write_cascade, write_four_lanes, write_two_lanes

from shared.physics.errors import InputError
from shared.radar import CaptureRadar, Radar
from shared.signal.spectrum import range_doppler
from trainer.captures import reading
from trainer.captures.array_files import read_array_capture
from trainer.captures.importing import RawCapture, read_capture
from trainer.captures.options import Reading
from trainer.captures.reading import SUFFIXES, read_arrays

CASCADE = "tx = [12, 11, 1]\n"


def read(folder: Path, name: str, board: str, **options: object) -> RawCapture:
    return read_capture(folder / name, Reading(board, radar=str(folder / "capture.toml"), **options))  # type: ignore[arg-type]


def read_axes(path: Path, radar: Radar, axes: str | None = None) -> tuple[NDArray[np.complex64], str]:
    return read_array_capture(path, CaptureRadar(radar), Reading("iwr1843", axes=axes), read_arrays(path))


@pytest.mark.parametrize("board", ["iwr1642", "iwr1843"])
def test_two_lanes_complex(tmp_path: Path, board: str) -> None:
    radar = radar_of(tmp_path, board)
    write_two_lanes(tmp_path / "adc.bin", scene(radar, 3), radar)
    found = read(tmp_path, "adc.bin", board)
    np.testing.assert_array_equal(found.cube, quantised(scene(radar, 3)))
    assert (found.radar, found.scale, found.dead) == (radar, "relative", ())
    chosen = read(tmp_path, "adc.bin", board, frames=(1, 2))
    np.testing.assert_array_equal(chosen.cube, found.cube[1:2])


def test_quadrature_first(tmp_path: Path) -> None:
    radar = radar_of(tmp_path, "iwr1843")
    write_two_lanes(tmp_path / "adc.bin", scene(radar), radar, swap=True)
    np.testing.assert_array_equal(read(tmp_path, "adc.bin", "iwr1843", order="qi").cube, quantised(scene(radar)))


@pytest.mark.parametrize("rx", [(1, 2, 3, 4), (1, 3, 4)])
def test_four_lanes_with_some_off(tmp_path: Path, rx: tuple[int, ...]) -> None:
    radar = radar_of(tmp_path, "iwr1443", f"tx = [1, 3]\nrx = {list(rx)}\n")
    write_four_lanes(tmp_path / "adc.bin", scene(radar, 2), radar, tuple(n - 1 for n in rx))
    np.testing.assert_array_equal(read(tmp_path, "adc.bin", "iwr1443").cube, quantised(scene(radar, 2)))


@pytest.mark.parametrize("name", ["", "master_0000_data.bin"])
@pytest.mark.parametrize("rx", ["", "rx = [2, 3, 9, 16]\n"])
def test_cascade(tmp_path: Path, name: str, rx: str) -> None:
    radar = radar_of(tmp_path, "mmwcas", CASCADE)
    write_cascade(tmp_path, scene(radar, 2), radar)
    whole = quantised(scene(radar, 2))
    radar_file(tmp_path, "mmwcas", CASCADE + rx)
    found = read(tmp_path, name, "mmwcas").cube
    kept = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15] if not rx else [1, 2, 8, 15]
    np.testing.assert_array_equal(found, whole[..., [3 * r + t for r in kept for t in range(3)]])


def test_real_samples_have_the_range_profile_of_complex_ones(tmp_path: Path) -> None:
    """But for what leaks from the mirror image under a Hann window: -58 dB of the strongest echo, and quantisation."""
    radar = radar_of(tmp_path, "awr2944", "real = true\n")
    cube = scene(radar, noise=0.0)
    write_two_lanes(tmp_path / "adc.bin", cube, radar, real=True)
    found = read(tmp_path, "adc.bin", "awr2944").cube
    np.testing.assert_array_equal(found, 2.0 * quantised(cube).real)
    expected, profile = (np.abs(range_doppler(frame, radar)) for frame in (COUNTS * cube[0], found[0]))
    assert np.abs(profile - expected).max() < 10.0 ** (-57.0 / 20.0) * expected.max()


AXES = [
    ("frame (chirp tx) rx sample", (2, 12, 4, 32), (0, 1, 4, 3, 2)),
    ("frame chirp (tx rx) sample", (2, 4, 12, 32), (0, 1, 4, 3, 2)),
    ("sample rx (frame chirp) tx", (32, 4, 8, 3), (2, 3, 0, 1, 4)),
]
KINDS = [".npy", ".npz", ".mat", "7.3.mat", ".h5"]


@pytest.mark.parametrize(
    ("kind", "axes", "shape", "order"),
    [*((kind, *AXES[2]) for kind in KINDS), *((".npy", *axes) for axes in AXES[:2])],
)
def test_arrays(tmp_path: Path, kind: str, axes: str, shape: tuple[int, ...], order: tuple[int, ...]) -> None:
    radar = radar_of(tmp_path, "iwr1843")
    cube = quantised(scene(radar, 2))
    apart = cube.reshape(2, 4, 32, 4, 3)  # frame, chirp, sample, rx, tx
    stored = np.ascontiguousarray(apart.transpose(order)).reshape(shape)
    path = tmp_path / f"a{kind}"
    if kind == ".npy":
        np.save(path, stored)
    elif kind == ".npz":
        np.savez(path, adc=stored, time=np.arange(3.0))
    elif kind == ".mat":
        scipy.io.savemat(path, {"adc": stored, "time": np.arange(3.0)})
    else:
        with h5py.File(path, "w", userblock_size=512 if kind == "7.3.mat" else 0) as file:
            pair = np.zeros(stored.shape, np.dtype([("real", "f8"), ("imag", "f8")]))
            pair["real"], pair["imag"] = stored.real, stored.imag
            if kind == "7.3.mat":
                made = file.create_dataset("adc", data=pair.T, chunks=True, compression="gzip")
                made.attrs["MATLAB_class"] = np.bytes_("double")
            else:
                file.create_dataset("radar/file", data=stored, chunks=True, compression="gzip", shuffle=True)
            file["text"] = "no numbers"
    found, taken = read_axes(path, radar, axes)
    np.testing.assert_array_equal(found, cube)
    assert taken == axes


def test_axes_are_guessed_where_their_lengths_tell(tmp_path: Path) -> None:
    radar = radar_of(tmp_path, "iwr1843")
    cube = quantised(scene(radar))
    apart = cube.reshape(1, 4, 32, 4, 3)
    np.save(tmp_path / "a.npy", apart.transpose(0, 1, 4, 3, 2).reshape(12, 4, 32))
    found, axes = read_axes(tmp_path / "a.npy", radar)
    np.testing.assert_array_equal(found, cube)
    assert axes == "(chirp tx) rx sample"


def test_an_axis_of_real_and_imaginary_part(tmp_path: Path) -> None:
    radar = radar_of(tmp_path, "iwr1642")
    cube = quantised(scene(radar))
    np.save(tmp_path / "a.npy", np.stack([cube[0].real, cube[0].imag], axis=-1).astype(np.int16))
    found, _ = read_axes(tmp_path / "a.npy", radar, "chirp sample (rx tx) iq")
    np.testing.assert_array_equal(found, cube)


@pytest.mark.parametrize("kind", [np.complex128, np.uint16, np.float32, np.int32, np.int64])
def test_a_sign_that_was_lost_comes_back(tmp_path: Path, kind: type[np.number[Any]]) -> None:
    """Numbers of uint16 that were int16, in whatever type they are held."""
    radar = radar_of(tmp_path, "iwr1642")
    cube = quantised(scene(radar))[0]
    lost = np.stack([cube.real, cube.imag], axis=-1).astype(np.int16).view(np.uint16)
    np.save(tmp_path / "a.npy", lost @ np.array([1, 1j]) if kind is np.complex128 else lost.astype(kind))
    axes = "chirp sample (rx tx)" + " iq" * (kind is not np.complex128)
    found, _ = read_axes(tmp_path / "a.npy", radar, axes)
    np.testing.assert_array_equal(found[0], cube)


def test_a_converter_makes_watts(tmp_path: Path) -> None:
    """Full scale of -10 dBm is sqrt(1e-4 W) at 32768 counts."""
    radar = radar_of(tmp_path, "iwr1642")
    write_two_lanes(tmp_path / "adc.bin", scene(radar), radar)
    with (tmp_path / "capture.toml").open("a", encoding="utf-8") as file:
        file.write("[front_end]\nconverter = { bits = 16, full_scale_dbm = -10.0 }\n")
    found = read(tmp_path, "adc.bin", "iwr1642")
    assert found.scale == "sqrt(W)"
    np.testing.assert_allclose(found.cube, quantised(scene(radar)) * 1e-2 / 32768.0, rtol=1e-6)


def test_a_dead_channel_is_named(tmp_path: Path) -> None:
    radar = radar_of(tmp_path, "iwr1642")
    cube = scene(radar)
    cube[..., 5] *= 1e-3
    write_two_lanes(tmp_path / "adc.bin", cube, radar)
    assert read(tmp_path, "adc.bin", "iwr1642").dead == (5,)


def test_an_empty_first_frame_is_not_judged(tmp_path: Path) -> None:
    radar = radar_of(tmp_path, "iwr1642")
    cube = scene(radar, 3)
    cube[..., 5] *= 1e-3
    cube[:2] = 0.0
    write_two_lanes(tmp_path / "adc.bin", cube, radar)
    found = read(tmp_path, "adc.bin", "iwr1642")
    np.testing.assert_array_equal(found.cube, quantised(cube))
    assert (found.dead, found.notes) == ((5,), ("empty frames first: 2; noise and dead channels are those of frame 2",))
    assert read(tmp_path, "adc.bin", "iwr1642", frames=(1, 3)).dead == (5,)
    with pytest.raises(InputError, match="all samples are 0; expected a capture, or other frames with --frames"):
        read(tmp_path, "adc.bin", "iwr1642", frames=(0, 2))
    np.save(tmp_path / "a.npy", 0.0 * cube)
    with pytest.raises(InputError, match=r"a\.npy: all samples are 0"):
        read(tmp_path, "a.npy", "iwr1642", axes="frame chirp sample (rx tx)")


def test_quadrature_that_was_taken_for_in_phase_is_noticed(tmp_path: Path) -> None:
    radar = radar_of(tmp_path, "iwr1642")
    leak = np.exp(2j * np.pi * np.arange(32) / 32)[:, None]  # from TX to RX, in range bin 1
    write_two_lanes(tmp_path / "adc.bin", 0.1 * scene(radar) + leak, radar)
    assert not read(tmp_path, "adc.bin", "iwr1642").notes
    (note,) = read(tmp_path, "adc.bin", "iwr1642", order="qi").notes
    assert "warning: the last range bins hold" in note


FRAME = 2 * 2 * 4 * 2 * 4 * 32
"""Bytes of a frame of the IWR1642: I and Q, 2 bytes, 4 chirps, 2 TX, 4 RX, 32 samples."""


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda b: b[:-2], rf"{3 * FRAME - 2} bytes; expected a multiple of {FRAME} \(4 chirps x 2 TX x 4 RX x 32 "
         rf"complex samples\): {2 * FRAME}, {3 * FRAME}, {4 * FRAME}"),
        (lambda b: b[: FRAME // 2], r"the file would fit 1 TX or 2 RX or 1 RX|the file would fit 1 TX or 1 RX or 2 RX"),
        (lambda b: np.array([1, 0, 1456, 0, 0, 0, 0], "<i2").tobytes() + b[14:], r"holds the headers of its packets"),
        (lambda b: np.array([1, 0, 1456, 0, 0, 0, 0], "<i2").tobytes() + b, r"holds the headers of its packets"),
    ],
)  # fmt: skip
def test_a_wrong_binary_is_one_line(tmp_path: Path, change: object, message: str) -> None:
    radar = radar_of(tmp_path, "iwr1642")
    write_two_lanes(tmp_path / "adc.bin", scene(radar, 3), radar)
    path = tmp_path / "adc.bin"
    path.write_bytes(change(path.read_bytes()))  # type: ignore[operator]
    with pytest.raises(InputError, match=message):
        read(tmp_path, "adc.bin", "iwr1642")


@pytest.mark.parametrize(("board", "lanes"), [("iwr1443", "2-lane"), ("iwr1843", "4-lane")])
def test_a_file_of_a_board_with_other_lanes_is_told_by_its_range_profile(
    tmp_path: Path, board: str, lanes: str
) -> None:
    """Their files have the same size. Whoever says --layout is believed."""
    radar = radar_of(tmp_path, board)
    if lanes == "2-lane":
        write_two_lanes(tmp_path / "adc.bin", scene(radar), radar)
    else:
        write_four_lanes(tmp_path / "adc.bin", scene(radar), radar, (0, 1, 2, 3))
    with pytest.raises(InputError, match=rf"as {lanes} its range profile is .* dB narrower than as"):
        read(tmp_path, "adc.bin", board)
    np.testing.assert_array_equal(read(tmp_path, "adc.bin", board, layout=lanes).cube, quantised(scene(radar)))


def test_the_makers_scripts_agree(tmp_path: Path) -> None:
    """``readDCA1000.m`` of SWRA581 for four lanes; ``organize`` of OpenRadar, the same for two, by their formulas."""
    radar_file(tmp_path, "iwr1642")
    generator = np.random.default_rng(3)
    raw = generator.integers(-900, 900, 2 * 4 * 2 * 4 * 32, dtype=np.int16)
    raw.astype("<i2").tofile(tmp_path / "adc.bin")
    organized = np.empty(len(raw) // 2, complex)
    organized[0::2], organized[1::2] = raw[0::4] + 1j * raw[2::4], raw[1::4] + 1j * raw[3::4]
    chirps = organized.reshape(8, 4, 32)  # chirp after chirp, TX in turns; RX; sample
    columns = raw.reshape(-1, 8).T
    lanes = (columns[0:4] + 1j * columns[4:8]).reshape(4, 8, 32)  # RX; chirp after chirp; sample
    for layout, by_rx in (("2-lane", chirps.transpose(1, 0, 2)), ("4-lane", lanes)):
        found = read(tmp_path, "adc.bin", "iwr1642", layout=layout).cube[0]
        for rx in range(4):
            for tx in range(2):
                np.testing.assert_array_equal(found[:, :, 2 * rx + tx], by_rx[rx, tx::2])


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        ("missing", r"slave2_0000_data.bin: not there; expected the data of master and slave1"),
        ("index", r"master_0000_idx.bin: 5 frames in"),
        ("short index", r"3 bytes; expected a header of 24"),
        ("fewer", r"frames of master 2, slave1 2, slave2 2, slave3 1; expected the same"),
        ("two", r"2 files master_\*_data.bin; expected one"),
    ],
)
def test_a_wrong_cascade_is_one_line(tmp_path: Path, fault: str, message: str) -> None:
    radar = radar_of(tmp_path, "mmwcas", CASCADE)
    write_cascade(tmp_path, scene(radar, 2), radar)
    if fault == "missing":
        (tmp_path / "slave2_0000_data.bin").unlink()
    elif fault == "index":
        index = tmp_path / "master_0000_idx.bin"
        index.write_bytes(index.read_bytes()[:12] + b"\x05" + index.read_bytes()[13:])
    elif fault == "short index":
        (tmp_path / "master_0000_idx.bin").write_bytes(b"abc")
    elif fault == "fewer":
        (tmp_path / "slave3_0000_idx.bin").unlink()
        data = tmp_path / "slave3_0000_data.bin"
        data.write_bytes(data.read_bytes()[: data.stat().st_size // 2])
    else:
        (tmp_path / "master_0001_data.bin").write_bytes(b"")
    with pytest.raises(InputError, match=message):
        read(tmp_path, ".", "mmwcas")


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("content", [b"", b"\x89HDF\r\n\x1a\n" + bytes(100), b"PK\x03\x04", b"no arrays" * 30])
def test_a_damaged_file_of_arrays_is_one_line(tmp_path: Path, suffix: str, content: bytes) -> None:
    (tmp_path / f"a{suffix}").write_bytes(content)
    with pytest.raises(InputError, match=f"^{tmp_path}/a{suffix}: not readable: "):
        read_arrays(tmp_path / f"a{suffix}")


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_library_that_crashes_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, suffix: str) -> None:
    (tmp_path / "crash.py").write_text("import os\nos.abort()\n")
    monkeypatch.setattr(reading, "READER", tmp_path / "crash.py")
    (tmp_path / f"a{suffix}").write_bytes(b"whole")
    with pytest.raises(InputError, match=r"not readable: its library ended with status -6"):
        read_arrays(tmp_path / f"a{suffix}")
