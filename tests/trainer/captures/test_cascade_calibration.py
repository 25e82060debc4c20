"""``calibrateResults*.mat`` of the cascade: applied as TI's scripts apply it, and a capture to calibrate with."""

import tomllib
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import scipy.io
from command_line import ended, refused
from numpy.typing import NDArray
from raw_files import radar_file, radar_of

from shared.physics.errors import InputError
from shared.radar import Radar, load_radar
from shared.signal.signal import if_signal
from trainer.captures.cascade_calibration import read_cascade_calibration
from trainer.captures.cube_file import read_cube

PLACE = (4.0, 0.0)
"""Of the reflector: range [m] and angle [deg]."""
CHIRPS = "tx = [12, 11, 4, 1]\nrx = [2, 3, 9, 16]\n"


def reflector(radar: Radar) -> NDArray[np.complex128]:
    """[sample, RX, TX] of a whole cascade whose channels differ in gain, phase and delay."""
    waveform, generator = radar.waveform, np.random.default_rng(3)
    chirp = if_signal(radar, np.array([[PLACE[0], 0.0, 0.0]]), np.zeros((1, 3)), np.ones(1))[0]
    gain_db, phase_deg, delay_s = generator.standard_normal((3, 192)) * np.array([[1.5], [12.0], [60e-12]])
    offset = waveform.bandwidth_hz * (np.arange(waveform.samples) / waveform.samples - 0.5)
    error = 10.0 ** (gain_db / 20.0) * np.exp(1j * np.deg2rad(phase_deg))
    return (chirp * error * np.exp(2j * np.pi * offset[:, None] * delay_s)).reshape(-1, 16, 12)


def results(samples: NDArray[np.complex128], radar: Radar) -> dict[str, dict[str, Any]]:
    """What TI's scripts make of these samples: bins are counted from 1, as MATLAB does."""
    count = len(samples)
    window = 0.5 * (1.0 - np.cos(2.0 * np.pi * np.arange(1, count + 1) / (count + 1)))
    window /= np.sqrt(np.mean(window**2))
    spectra = np.fft.fft(samples * window[:, None, None], 5 * count, axis=0)
    at = np.abs(spectra).argmax(axis=0)
    peaks = np.take_along_axis(spectra, at[None], axis=0)[0]
    waveform = radar.waveform
    return {
        "calibResult": {
            "AngleMat": np.rad2deg(np.angle(peaks)).T, "RangeMat": (at.T + 1).astype(float), "PeakValMat": peaks.T,
            "RxMismatch": np.zeros((1, 16)), "TxMismatch": np.zeros((3, 4)), "Rx_fft": spectra,
        },
        "params": {
            "Slope_MHzperus": 1e-12 * waveform.bandwidth_hz / waveform.chirp_duration_s,
            "Sampling_Rate_sps": waveform.samples / waveform.chirp_duration_s,
        },
    }  # fmt: skip


def write_7_3(path: Path, content: dict[str, dict[str, Any]]) -> None:
    """As MATLAB 7.3 does: structures are groups, axes the other way round."""
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, fields in content.items():
            for field, values in fields.items():
                array = np.atleast_2d(values)
                if np.iscomplexobj(array):
                    pair = np.zeros(array.shape, np.dtype([("real", "f8"), ("imag", "f8")]))
                    pair["real"], pair["imag"] = array.real, array.imag
                    array = pair
                file.create_dataset(f"{name}/{field}", data=array.T).attrs["MATLAB_class"] = np.bytes_("double")


@pytest.fixture
def whole(tmp_path: Path) -> Radar:
    """The cascade with all of its TX and RX, in the order of their numbers; capture.toml in the folder says so."""
    return radar_of(tmp_path, "mmwcas")


@pytest.mark.parametrize("version", ["5", "7.3"])
@pytest.mark.parametrize(("board", "tx", "mirror"), [("mmwcas", (12, 11, 4, 1), ""), ("mmwcas-azimuth", (1, 9), "m")])
def test_it_is_applied_as_the_scripts_do(
    tmp_path: Path, whole: Radar, version: str, board: str, tx: tuple[int, ...], mirror: str
) -> None:
    """``calibrationCascade`` channel by channel, to a capture of another slope and sample rate."""
    content = results(reflector(whole), whole)
    path = tmp_path / "calibrateResults_high.mat"
    scipy.io.savemat(path, content) if version == "5" else write_7_3(path, content)
    file = radar_file(tmp_path, board, f"tx = {list(tx)}\nrx = [2, 3, 9, 16]\n")
    text = file.read_text(encoding="utf-8").replace("30e12", "45e12").replace("= 2e6", "= 2.5e6")
    file.write_text(("mirror = true\n" if mirror else "") + text, encoding="utf-8")
    radar = load_radar(str(file))
    generator = np.random.default_rng(4)
    cube = (generator.standard_normal((2, 4, 32, radar.array.channels, 2)) @ np.array([1.0, 1.0j])).astype(np.complex64)
    found = read_cascade_calibration(path).calibration(board, radar).applied(cube, radar)
    kept, n = content["calibResult"], np.arange(32)
    for column, rx in enumerate((2, 3, 9, 16)):
        for row, number in enumerate(tx):
            at = (number if board == "mmwcas" else 13 - number) - 1, rx - 1
            bins = (kept["RangeMat"][at] - kept["RangeMat"][11, 0]) * (2e6 / 2.5e6) * (45e12 / 30e12)
            phase = kept["PeakValMat"][11, 0] / kept["PeakValMat"][at]
            factor = np.exp(-2j * np.pi * bins / (5 * 32) * n) * phase / abs(phase)
            channel = len(tx) * column + row
            np.testing.assert_allclose(found[..., channel], cube[..., channel] * factor, atol=1e-5)


def test_import_makes_the_channels_of_its_own_reflector_one(
    tmp_path: Path, whole: Radar, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In phase in the middle of the sweep: a peak half of a padded bin off turns it by nothing there."""
    monkeypatch.chdir(tmp_path)
    samples = reflector(whole)
    scipy.io.savemat("calibrateResults.mat", results(samples, whole))
    np.save("corner.npy", np.tile(samples.reshape(1, 1, 32, 192), (1, 4, 1, 1)))
    options = ("--board", "mmwcas", "--radar", "capture.toml", "--axes", "frame chirp sample (rx tx)")
    code, said, _ = ended(
        "trainer", "import", "corner.npy", *options, "--calibration", "calibrateResults.mat",
        "--out", "cube.npz",
    )  # fmt: skip
    assert code == 0
    assert "calibrated; what it leaves of a reflector is not known" in said
    cube = read_cube(tmp_path / "cube.npz", None).cube[0, 0]
    before, after = (np.angle(each * each.sum().conj()).std() for each in (samples.reshape(32, 192)[16], cube[16]))
    assert before > np.deg2rad(10.0)
    assert after < np.deg2rad(1.0)


@pytest.mark.parametrize("chirps", ["", CHIRPS])
def test_calibrate_finds_what_it_finds_in_the_samples(
    tmp_path: Path, whole: Radar, monkeypatch: pytest.MonkeyPatch, chirps: str
) -> None:
    """Gain, phase and delay of the exact place, of the elements in use and in the order in which they send."""
    monkeypatch.chdir(tmp_path)
    samples = reflector(whole)
    scipy.io.savemat("calibrateResults.mat", results(samples, whole))
    used = samples[:, [1, 2, 8, 15]][:, :, [11, 10, 3, 0]] if chirps else samples
    np.save("corner.npy", np.tile(used.reshape(1, 32, -1), (4, 1, 1)))
    radar_file(tmp_path, "mmwcas", chirps)
    found = []
    options = ("--board", "mmwcas", "--radar", "capture.toml", "--range", PLACE[0], "--angle", PLACE[1])
    out = tmp_path / "c.toml"
    for source, axes in (("calibrateResults.mat", ()), ("corner.npy", ("--axes", "chirp sample (rx tx)"))):
        code, _, said = ended("trainer", "calibrate", source, *options, *axes, "--out", out)
        assert (code, said) == (0, "")
        found.append(tomllib.loads(out.read_text(encoding="utf-8")))
        out.unlink()
    for name, unit in (("gain_db", 1e-4), ("phase_deg", 1e-3), ("delay_s", 1e-15)):
        np.testing.assert_allclose(found[0][name], found[1][name], atol=unit)
    assert np.std(found[0]["gain_db"]) > 0.5


def changed(content: dict[str, dict[str, Any]], field: str, value: Any) -> dict[str, dict[str, Any]]:
    """The file with another value of a field, or without it where that is None."""
    structure, name = field.split("/")
    fields = {key: each for key, each in content[structure].items() if key != name}
    return {**content, structure: fields if value is None else {**fields, name: value}}


CALIBRATE = ("calibrate", "FILE", "--range", "4", "--angle", "0", "--out", "c.toml")
NO_REFERENCE = 1.0 - (np.arange(192).reshape(12, 16) == 176.0)


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("calibResult/PeakValMat", np.ones((3, 4), complex), "FIELD is 3 x 4; expected 12 x 16, of"),
        ("calibResult/RangeMat", None, "no FIELD (calibResult/AngleMat, calibResult/PeakValMat, "),
        ("params/Slope_MHzperus", 30e12, "FIELD = 3e+13; expected MHz/us, 1 to 300"),
        ("params/Sampling_Rate_sps", -1.0, "FIELD = -1; expected samples a second, more than 0"),
        ("calibResult/PeakValMat", np.full((12, 16), np.nan), "FIELD has values that are not finite"),
        ("calibResult/PeakValMat", NO_REFERENCE, "FIELD of the reference, TX12 and RX1, has no echo; expected a"),
        # Samples mean something with their own chirp only.
        ("30e12", "45e12", "params/Slope_MHzperus = 30; expected 45, as the capture's --radar has it"),
        ("= 2e6", "= 2.5e6", "params/Sampling_Rate_sps = 2e+06; expected 2.5e+06, as the capture's --radar has it"),
        ("samples = 32", "samples = 64", "calibResult/Rx_fft is of 32 samples; expected 64, as --radar has it"),
        ("--board", "iwr1843", "calibResult/PeakValMat is of the cascade's 12 TX x 16 RX; expected a calibration of"),
        ("import", "iwr1843", "calibResult/PeakValMat is of the cascade's 12 TX x 16 RX; expected a calibration of"),
        ("--axes", "chirp sample channel", "'chirp sample channel' of FILE; expected no FIELD: TI's file says how"),
        ("--order", "qi", "'qi' of FILE; expected no FIELD: TI's file says how it is laid out"),
    ],
)
def test_what_does_not_fit_is_one_line(
    tmp_path: Path, whole: Radar, monkeypatch: pytest.MonkeyPatch,
    field: str, value: Any, message: str,
) -> None:  # fmt: skip
    """A field of the file, an entry of the radar's, the board, or an option that tells nothing of such a file."""
    monkeypatch.chdir(tmp_path)
    content, board, source = results(reflector(whole), whole), "mmwcas", "calibrateResults.mat"
    command, options = [source if word == "FILE" else word for word in CALIBRATE], list[str]()
    if "/" in field:
        content = changed(content, field, value)
    elif field in ("--board", "import"):
        board = value
        radar_file(tmp_path, board)
    elif field.startswith("--"):
        options, source = [field, value], field
    else:
        file = tmp_path / "capture.toml"
        file.write_text(file.read_text(encoding="utf-8").replace(field, value), encoding="utf-8")
    if field == "import":
        np.save("corner.npy", np.zeros((4, 32, 192), complex))
        command = ["import", "corner.npy", "--calibration", source, "--out", "cube.npz"]
    scipy.io.savemat("calibrateResults.mat", content)
    said = refused("trainer", *command, *options, "--board", board, "--radar", "capture.toml")
    expected = message.replace("FIELD", field).replace("FILE", "calibrateResults.mat")
    assert said.startswith(f"trainer: {source}: {expected}")


@pytest.mark.parametrize("count", [256, 2048])
def test_samples_of_any_number_come_back(tmp_path: Path, whole: Radar, count: int) -> None:
    """The window leaves 2e-8 of the last of 256, 5e-12 of the last of 2048; one that is told of fewer is refused."""
    duration = count / 2e6
    waveform = {"samples": count, "range_bins": count, "chirp_duration_s": duration, "bandwidth_hz": 30e12 * duration}
    radar = whole.model_copy(update={"waveform": whole.waveform.model_copy(update=waveform)})
    samples = reflector(radar)
    scipy.io.savemat(tmp_path / "calibrateResults.mat", results(samples, radar))
    found = read_cascade_calibration(tmp_path / "calibrateResults.mat")
    np.testing.assert_allclose(found.samples("mmwcas", radar)[0, 0], samples.reshape(count, -1), rtol=1e-5)
    shorter = {"samples": count - 1, "chirp_duration_s": duration - 5e-7, "bandwidth_hz": 30e12 * (duration - 5e-7)}
    other = radar.model_copy(update={"waveform": radar.waveform.model_copy(update=shorter)})
    with pytest.raises(InputError, match=f"is of {count} samples"):
        found.samples("mmwcas", other)
