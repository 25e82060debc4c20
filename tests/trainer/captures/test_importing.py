"""Captures that are not what was stated of them: what is refused, doubted, told, and taken all the same."""

from pathlib import Path

import numpy as np
import pytest
from raw_files import CFG, quantised, radar_file, radar_of, scene, write_cascade, write_four_lanes, write_two_lanes

from shared.physics.errors import InputError
from shared.radar import load_radar
from trainer.captures.importing import RawCapture, read_capture
from trainer.captures.options import Reading


def read(folder: Path, name: str, board: str, **options: object) -> RawCapture:
    return read_capture(folder / name, Reading(board, radar=folder / "capture.toml", **options))  # type: ignore[arg-type]


@pytest.mark.parametrize("board", ["iwr1642", "awr2944"])
def test_a_converter_of_fewer_bits_is_full_at_fewer_counts(tmp_path: Path, board: str) -> None:
    """12 bits reach 2048 counts; what goes beyond is of more bits. As 16-bit samples they were 24 dB too weak."""
    radar = radar_of(tmp_path, board)
    real = board == "awr2944"
    write_two_lanes(tmp_path / "adc.bin", scene(radar), radar, real=real)
    plain = read(tmp_path, "adc.bin", board).cube
    with (tmp_path / "capture.toml").open("a", encoding="utf-8") as file:
        file.write("[front_end]\nconverter = { bits = 12, full_scale_dbm = -10.0 }\n")
    np.testing.assert_allclose(read(tmp_path, "adc.bin", board).cube, plain * 1e-2 / 2048.0, rtol=1e-6)
    write_two_lanes(tmp_path / "adc.bin", 3.0 * scene(radar), radar, real=real)
    with pytest.raises(
        InputError, match=r"samples of \d{4} counts; expected at most 2048 of front_end.converter.bits = 12"
    ):
        read(tmp_path, "adc.bin", board)


@pytest.mark.parametrize(("bins", "told"), [(4, False), (3, False), (1, True)])
def test_an_echo_from_the_end_of_the_range_axis_is_no_sign_of_quadrature(tmp_path: Path, bins: int, told: bool) -> None:
    """But for one within two bins of bin 0, where leaking TX would stand if I and Q were the other way round."""
    radar = radar_of(tmp_path, "iwr1642")
    echo = np.exp(-2j * np.pi * bins * np.arange(32) / 32)[:, None]
    write_two_lanes(tmp_path / "adc.bin", 0.01 * scene(radar) + echo, radar)
    notes = read(tmp_path, "adc.bin", "iwr1642").notes
    assert [note.startswith("warning: the last range bins") for note in notes] == [True] * told


@pytest.mark.parametrize(("line", "order"), [("adcbufCfg -1 0 1 1 1", "qi"), ("adcbufCfg -1 0 0 1 1", "iq")])
def test_a_configuration_says_whether_q_comes_first(tmp_path: Path, line: str, order: str) -> None:
    """Unless --order does; a file of arrays has the order of whoever wrote it."""
    (tmp_path / "capture.toml").write_text('board = "iwr1843"\ncapture = "profile.cfg"\n', encoding="utf-8")
    (tmp_path / "profile.cfg").write_text(CFG.replace("256 5209", "32 2000") + line, encoding="utf-8")
    radar = load_radar(tmp_path / "capture.toml")
    write_two_lanes(tmp_path / "adc.bin", scene(radar), radar, swap=order == "qi")
    found = read(tmp_path, "adc.bin", "iwr1843")
    np.testing.assert_array_equal(found.cube, quantised(scene(radar)))
    assert found.notes == (
        f"order {order}, as SampleSwap = {int(order == 'qi')} of adcbufCfg says; --order goes before it",
    )
    other = read(tmp_path, "adc.bin", "iwr1843", order="iq" if order == "qi" else "qi").cube
    np.testing.assert_array_equal(other, found.cube.imag + 1j * found.cube.real)
    np.save(tmp_path / "a.npy", found.cube[0])
    arrays = read(tmp_path, "a.npy", "iwr1843", axes="chirp sample (rx tx)")
    np.testing.assert_array_equal(arrays.cube, found.cube)


@pytest.mark.parametrize("real", [False, True])
def test_arrays_of_the_other_kind_of_samples_are_refused(tmp_path: Path, real: bool) -> None:
    """Real ones listed a mirror image of each echo; complex ones of a real radar lost half of their range axis."""
    radar = radar_of(tmp_path, "iwr1642", f"real = {str(real).lower()}\n")
    cube = scene(radar)[0]
    kinds = {True: cube.real, False: cube}
    np.save(tmp_path / "a.npy", kinds[real])
    assert read(tmp_path, "a.npy", "iwr1642", axes="chirp sample (rx tx)").cube.any()
    np.save(tmp_path / "b.npy", kinds[not real])
    message = r"array has (real|complex) samples, radar 'capture' (complex|real) ones; expected .* under \[capture\]"
    with pytest.raises(InputError, match=message):
        read(tmp_path, "b.npy", "iwr1642", axes="chirp sample (rx tx)")
    np.save(tmp_path / "c.npy", np.stack([cube.real, cube.imag], axis=-1))
    if real:
        with pytest.raises(InputError, match="array has complex samples"):
            read(tmp_path, "c.npy", "iwr1642", axes="chirp sample (rx tx) iq")


def test_whole_frames_of_a_recording_that_was_cut_off(tmp_path: Path) -> None:
    radar = radar_of(tmp_path, "iwr1642")
    write_two_lanes(tmp_path / "adc.bin", scene(radar, 3), radar)
    path = tmp_path / "adc.bin"
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(InputError, match=r"; whole frames in it: 2 \(--frames 0:2\)$"):
        read(tmp_path, "adc.bin", "iwr1642")
    said = f"{path} ends within a frame: its last {2 * 2 * 4 * 2 * 4 * 32 - 100} bytes are left out"
    for frames in ((0, 2), (0, None)):
        found = read(tmp_path, "adc.bin", "iwr1642", frames=frames)
        np.testing.assert_array_equal(found.cube, quantised(scene(radar, 3))[:2])
        assert found.notes == (said,)
    fewer = f"frames 1 to 1 of {path}, which has no more"
    assert read(tmp_path, "adc.bin", "iwr1642", frames=(1, 5)).notes == (said, fewer)
    with pytest.raises(InputError, match=r"--frames: 2:3 of .*, which has 2; expected a part of 0:2"):
        read(tmp_path, "adc.bin", "iwr1642", frames=(2, 3))


@pytest.mark.parametrize("cut", ["one", "all"])
def test_whole_frames_of_a_cascade_that_was_cut_off(tmp_path: Path, cut: str) -> None:
    radar = radar_of(tmp_path, "mmwcas", "tx = [12, 11, 1]\n")
    write_cascade(tmp_path, scene(radar, 3), radar)
    for path in tmp_path.glob("*_data.bin" if cut == "all" else "slave2_0000_data.bin"):
        path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(InputError, match=r"whole frames in it: 2 \(--frames 0:2\)$"):
        read(tmp_path, ".", "mmwcas")
    np.testing.assert_array_equal(read(tmp_path, ".", "mmwcas", frames=(0, 2)).cube, quantised(scene(radar, 3))[:2])


@pytest.mark.parametrize("rx", [(1, 2), (2, 4), (1, 2, 3, 4)])
@pytest.mark.parametrize(("board", "lanes"), [("iwr1443", "2-lane"), ("iwr1843", "4-lane")])
@pytest.mark.parametrize(("level", "told"), [(0.0, ""), (0.25, "warning: as"), (3.0, "refused")])
def test_other_lanes_are_doubted_and_refused_whatever_rx_are_on(
    tmp_path: Path, board: str, lanes: str, rx: tuple[int, ...], level: float, told: str
) -> None:
    """One echo above noise, of which alone nothing is known; a file of the right lanes is never doubted."""
    right, more = "iwr1843" if lanes == "2-lane" else "iwr1443", f"rx = {list(rx)}\n"
    radar = radar_of(tmp_path, right, more)
    cube = 0.1 * (scene(radar, 2, noise=1.0) - scene(radar, 2, noise=0.0))
    cube += level * np.exp(2j * np.pi * 12.4 * np.arange(32) / 32)[:, None]
    if lanes == "2-lane":
        write_two_lanes(tmp_path / "adc.bin", cube, radar)
    else:
        write_four_lanes(tmp_path / "adc.bin", cube, radar, tuple(number - 1 for number in rx))
    assert not read(tmp_path, "adc.bin", right).notes
    radar_file(tmp_path, board, more)
    try:
        said = "".join(read(tmp_path, "adc.bin", board).notes)
    except InputError as refused:
        said = f"refused: {refused}"
    assert said.startswith(told)
    assert (f"{lanes} its range profile is" in said) == bool(told), said


def test_a_folder_for_a_single_file_is_told_what_it_may_be(tmp_path: Path) -> None:
    radar_of(tmp_path, "iwr1642")
    (tmp_path / "scene").mkdir()
    with pytest.raises(InputError, match=r"scene, a folder, beside board iwr1642 and layout 2-lane; expected a \.bin"):
        read(tmp_path, "scene", "iwr1642")


def test_samples_that_predict_would_refuse_are_refused_at_once(tmp_path: Path) -> None:
    radar = radar_of(tmp_path, "iwr1642")
    np.save(tmp_path / "a.npy", (scene(radar)[0] * 1e16).astype(np.complex64))
    with pytest.raises(InputError, match=r"a\.npy: cube has samples of .*e\+1\d; expected at most 1e\+12"):
        read(tmp_path, "a.npy", "iwr1642")
