"""Calibration on a simulated board with errors of gain, phase and delay: what another reflector leaves after it."""

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from raw_files import radar_file

from shared.physics.errors import InputError
from shared.physics.units import power_to_db
from shared.radar import Radar, load_radar
from shared.signal.signal import if_signal
from shared.signal.windows import hann
from trainer.captures.calibrating import Place, _moving, calibrate, residual
from trainer.captures.calibration import Calibration, read_calibration, to_toml
from trainer.captures.cube_file import Capture, read_cube
from trainer.captures.importing import RawCapture, import_capture, read_capture
from trainer.captures.options import Reading

BOARD = "mmwcas-azimuth"
GAIN_DB, PHASE_DEG, DELAY_S = 1.5, 12.0, 20e-12
CHIRPS = "tx = [1, 3, 5, 9]\n"


@dataclass(frozen=True)
class Bench:
    """A board with errors, which measures reflectors."""

    folder: Path
    radar: Radar
    gain_db: NDArray[np.float64]
    phase_deg: NDArray[np.float64]
    delay_s: NDArray[np.float64]

    @property
    def reading(self) -> Reading:
        return Reading(**self.read)

    @property
    def read(self) -> dict[str, Any]:
        return {"board": BOARD, "radar": str(self.folder / "capture.toml"), "axes": "chirp sample (rx tx)"}

    def calibrate(self, places: Sequence[Place], check: Place | None = None, **others: Any) -> Calibration:
        """By the captures of these places, into c.toml."""
        if check is not None:
            others |= {"check": check.source, "check_range": check.range_m, "check_angle": check.angle_deg}
        return calibrate(
            captures=[place.source for place in places], ranges=[place.range_m for place in places],
            angles=[place.angle_deg for place in places], out=self.folder / "c.toml", **self.read, **others,
        )  # fmt: skip

    def imported(self, source: Path, out: str) -> Capture:
        """A capture, with the calibration that was found."""
        calibration, out_file = self.folder / "c.toml", self.folder / out
        return import_capture(capture=source, out=out_file, calibration=calibration, **self.read)

    def measure(
        self, name: str, range_m: float, angle_deg: float, noise: float, dead: tuple[int, ...] = (),
        speed_mps: float = 0.0,
    ) -> Place:  # fmt: skip
        """A reflector of amplitude 1 with noise of this amplitude in each sample, and where it was said to stand."""
        waveform, angle = self.radar.waveform, np.deg2rad(angle_deg)
        place = range_m * np.array([[np.cos(angle), np.sin(angle), 0.0]])
        cube = if_signal(self.radar, place, speed_mps / range_m * place, np.array([np.exp(0.7j)]))
        offset = waveform.bandwidth_hz * (np.arange(waveform.samples) / waveform.samples - 0.5)
        error = 10.0 ** (self.gain_db / 20.0) * np.exp(1j * np.deg2rad(self.phase_deg))
        cube = cube * error * np.exp(2j * np.pi * offset[:, None] * self.delay_s)
        cube[..., list(dead)] = 0.0
        generator = np.random.default_rng(int(1e3 * range_m + 10 * angle_deg) % 2**32)
        cube += noise / np.sqrt(2.0) * (generator.standard_normal((*cube.shape, 2)) @ np.array([1.0, 1.0j]))
        np.save(self.folder / name, cube.astype(np.complex64))
        return Place(self.folder / name, range_m, angle_deg)


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    generator = np.random.default_rng(11)
    radar = load_radar(str(radar_file(tmp_path, BOARD, CHIRPS)))
    channels = radar.array.channels

    def drawn(rms: float) -> NDArray[np.float64]:
        values = generator.standard_normal(channels)
        return rms * (values - values.mean()) / values.std()

    return Bench(tmp_path, radar, drawn(GAIN_DB), drawn(PHASE_DEG), drawn(DELAY_S))


def noise_in_a_cell(radar: Radar, noise: float) -> float:
    """Its power after the Hann window of range and the mean over the chirps."""
    window = hann(radar.waveform.samples)
    return float(noise**2 * np.sum(window**2) / np.sum(window) ** 2 / radar.waveform.chirps)


def test_errors_are_found(bench: Bench) -> None:
    """To what the noise leaves: 0.01 rad and 0.09 dB in a cell of noise at -43 dB."""
    bench.calibrate([bench.measure("a.npy", 4.0, 10.0, 0.05)])
    found = read_calibration(bench.folder / "c.toml")
    spread = np.sqrt(0.5 * noise_in_a_cell(bench.radar, 0.05))
    assert np.abs(np.array(found.gain_db) - bench.gain_db).max() < 5.0 * 8.7 * spread
    turned = np.exp(1j * np.deg2rad(np.array(found.phase_deg) - bench.phase_deg))
    assert np.abs(np.angle(turned * turned.mean().conj())).max() < 5.0 * spread
    # A tone's delay under these weights: a spread of sqrt(6) / pi bins at most for each rad of phase.
    assert np.abs(np.array(found.delay_s) - bench.delay_s).max() < 5.0 * spread / bench.radar.waveform.bandwidth_hz


def test_another_reflector_leaves_what_the_noise_of_both_captures_does(bench: Bench) -> None:
    """(1 - 1/C) (1/S_1 + 1/S_2), near as it is; before calibration -10 dB, as the errors drawn have it."""
    noise = (0.05, 0.1)
    places = bench.measure("a.npy", 3.0, 10.0, noise[0]), bench.measure("b.npy", 5.0, -20.0, noise[1])
    found = bench.calibrate([places[0]], check=places[1])
    cells = [noise_in_a_cell(bench.radar, each) for each in noise]
    channels = bench.radar.array.channels
    # The amplitudes of the channels are not the same: the first noise is divided by each one's gain.
    weight = np.mean(10.0 ** (-bench.gain_db / 10.0))
    expected = float(power_to_db((1.0 - 1.0 / channels) * weight * (cells[0] + cells[1])))
    left = residual(read_capture(places[1].source, bench.reading), places[1], found)
    assert left.stated_db < -18.0
    assert left.stated_db == pytest.approx(expected, abs=1.0)  # 128 real numbers of noise: 0.5 dB
    assert found.model_error_db == left.best_db
    assert left.best_db == pytest.approx(left.stated_db, abs=0.5)
    plain = found.model_copy(update={"gain_db": (0.0,) * channels, "phase_deg": (0.0,) * channels,
                                     "delay_s": (0.0,) * channels})  # fmt: skip
    before = residual(read_capture(places[1].source, bench.reading), places[1], plain)
    errors = 10.0 ** (bench.gain_db / 20.0) * np.exp(1j * np.deg2rad(bench.phase_deg))
    drawn = 1.0 - np.abs(errors.mean()) ** 2 / np.mean(np.abs(errors) ** 2)
    assert before.stated_db == pytest.approx(power_to_db(drawn), abs=1.0)


def test_an_angle_stated_wrong_is_told_apart_from_model_error(bench: Bench) -> None:
    """At the stated angle the residual is what the exact round trips of both angles differ by."""
    first, truly = bench.measure("a.npy", 4.0, 0.0, 0.01), bench.measure("b.npy", 5.0, 12.0, 0.01)
    found = bench.calibrate([first])
    stated = Place(truly.source, 5.0, 12.2)
    left = residual(read_capture(truly.source, bench.reading), stated, found)
    y = bench.radar.array.virtual[:, 1]
    turn = 2.0 * np.pi / bench.radar.waveform.wavelength_m * y * (np.sin(np.deg2rad(12.2)) - np.sin(np.deg2rad(12.0)))
    expected = float(power_to_db(1.0 - np.abs(np.exp(1j * turn).mean()) ** 2))
    assert left.stated_db == pytest.approx(expected, abs=0.5)
    assert left.best_deg == pytest.approx(12.0, abs=0.02)
    assert left.best_db < left.stated_db - 10.0


def test_a_check_on_the_other_side_is_told(bench: Bench) -> None:
    lines: list[str] = []
    first, other = bench.measure("a.npy", 4.0, 5.0, 0.01), bench.measure("b.npy", 5.0, 12.0, 0.01)
    turned = Place(other.source, 5.0, -12.0)
    bench.calibrate([first], check=turned, announce=lines.append)
    assert any("at 12 deg: see --mirror" in line for line in lines)


def test_several_captures_check_each_other(bench: Bench) -> None:
    places = [bench.measure(f"{n}.npy", 3.0 + n, 8.0 * n - 10.0, 0.1) for n in range(3)]
    found = bench.calibrate(places)
    assert len(found.captures) == 3
    assert found.model_error_db is not None
    one = noise_in_a_cell(bench.radar, 0.1) * np.mean(10.0 ** (-bench.gain_db / 10.0))
    # The third's noise, and that of the mean of two.
    assert found.model_error_db == pytest.approx(power_to_db(1.5 * one), abs=1.0)


def test_a_dead_channel_is_named_and_left_out(bench: Bench) -> None:
    place = bench.measure("a.npy", 4.0, 10.0, 0.002, dead=(7,))
    found = bench.calibrate([place])
    assert found.dead_channels == (7,)
    assert (found.gain_db[7], found.phase_deg[7], found.delay_s[7]) == (0.0, 0.0, 0.0)
    capture = bench.imported(place.source, "a.npz")
    assert capture.dead_channels == (7,)


def test_import_applies_it(bench: Bench) -> None:
    places = bench.measure("a.npy", 4.0, 10.0, 0.0), bench.measure("b.npy", 5.0, -20.0, 0.0)
    bench.calibrate([places[0]], check=places[1])
    capture = bench.imported(places[1].source, "b.npz")
    assert capture.calibration is not None
    assert capture.model_error_db is not None
    assert capture.model_error_db < -60.0
    found = read_cube(bench.folder / "b.npz", None)
    assert (found.radar, found.capture) == (bench.radar, capture)
    clean = if_signal(bench.radar, places[1].position[None], np.zeros((1, 3)), np.ones(1))
    ratio = found.cube[0] / clean
    np.testing.assert_allclose(ratio, ratio.mean(), atol=0.01)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"board": "iwr1843"}, r"of board 'iwr1843'; expected one of 'mmwcas-azimuth'"),
        ({"carrier_hz": 60e9}, r"measured from 60.000 to .*; expected the capture's 77.150 to"),
        ({"array": "turned"}, r"its 4 TX are not the capture's 4, or in another order"),
    ],
)
def test_a_calibration_of_something_else_is_refused(bench: Bench, change: dict[str, object], message: str) -> None:
    place = bench.measure("a.npy", 4.0, 10.0, 0.01)
    found = bench.calibrate([place])
    if "array" in change:
        turned = found.array.model_copy(update={"tx_m": found.array.tx_m[::-1]})
        change = {"array": turned}
    changed = found.model_copy(update=change)
    with pytest.raises(InputError, match=message):
        changed.require_fits("c.toml", BOARD, bench.radar)


def test_any_text_comes_back() -> None:
    """TOML has no control characters in a text but the tab; JSON has U+007F."""
    text = "".join(map(chr, (*range(0x180), 0x2028, 0xFFFE, 0x1F600)))
    document = {"source": text, "captures": [{"source": text}]}
    assert tomllib.loads(to_toml(document)) == document


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("mmwcas-azimuth", "iwr1843", r"its entries have sha256"),
        ("captures = [", "captures = [}", r"not readable as TOML"),
        ("gain_db = [", "gain_db = [0.0, ", r"its entries have sha256"),
        ("carrier_hz = ", "carrier_hz = 1979-05-27 #", r"not readable"),
    ],
)
def test_a_changed_file_is_one_line(bench: Bench, old: str, new: str, message: str) -> None:
    path = bench.folder / "c.toml"
    bench.calibrate([bench.measure("a.npy", 4.0, 10.0, 0.01)])
    assert isinstance(read_calibration(path), Calibration)
    path.write_text(path.read_text(encoding="utf-8").replace(old, new), encoding="utf-8")
    with pytest.raises(InputError, match=message):
        read_calibration(path)


def test_no_reflector_there_is_one_line(bench: Bench) -> None:
    place = bench.measure("a.npy", 4.0, 10.0, 0.01)
    with pytest.raises(InputError, match=r"no reflector within .* m of 7.5 m"):
        bench.calibrate([Place(place.source, 7.5, 10.0)])
    assert not (bench.folder / "c.toml").exists()


def test_a_check_without_its_reflector_is_no_check(bench: Bench) -> None:
    """It would leave all, and every echo after it would be model error."""
    place, noise = bench.measure("a.npy", 4.0, 10.0, 0.01), np.random.default_rng(3)
    shape = np.load(place.source).shape
    np.save(bench.folder / "noise.npy", (noise.standard_normal((*shape, 2)) @ [1.0, 1.0j]).astype(np.complex64))
    for check in (Place(bench.folder / "noise.npy", 5.0, 0.0), Place(place.source, 7.5, 10.0)):
        with pytest.raises(InputError, match=rf"{check.source.name}: no reflector within .* m of {check.range_m:g} m"):
            bench.calibrate([place], check=check)
        assert not (bench.folder / "c.toml").exists()


@pytest.mark.parametrize(("angle_deg", "told"), [(10.0, False), (40.0, True)])
def test_a_check_that_is_hardly_explained_is_told(bench: Bench, angle_deg: float, told: bool) -> None:
    lines: list[str] = []
    first, other = bench.measure("a.npy", 4.0, 5.0, 0.01), bench.measure("b.npy", 5.0, 10.0, 0.01)
    bench.calibrate([first], check=Place(other.source, 5.0, angle_deg), announce=lines.append)
    assert any("are angle and board right?" in line for line in lines) == told


@pytest.mark.parametrize(
    ("range_m", "angle_deg", "message"),
    [(-3.0, 0.0, "--check-range: -3.0; expected metres"), (5.0, 95.0, "--check-angle: 95.0; expected degrees")],
)
def test_a_check_nowhere_ahead_is_told_by_its_own_options(
    bench: Bench, range_m: float, angle_deg: float, message: str
) -> None:
    first = bench.measure("a.npy", 4.0, 5.0, 0.01)
    with pytest.raises(InputError, match=message):
        calibrate(
            captures=[first.source], ranges=[4.0], angles=[5.0], check=first.source, check_range=range_m,
            check_angle=angle_deg, out=bench.folder / "c.toml", **bench.read,
        )  # fmt: skip


@pytest.mark.parametrize("bins", [-8, -6, -4.5, 4.5, 6, 8])
def test_a_sidelobe_is_no_reflector(bench: Bench, bins: float) -> None:
    """Stated beside where it stands, without noise: sidelobes are all that is there."""
    place = bench.measure("a.npy", 4.0, 10.0, 1e-6)
    stated = 4.0 + bins * bench.radar.waveform.range_step_m
    with pytest.raises(InputError, match=r"no reflector within .* \(the strongest echo .* at (3\.[89]|4\.[01]).* m\)"):
        bench.calibrate([Place(place.source, stated, 10.0)])


@pytest.mark.parametrize(("cells", "moves"), [(0.0, False), (2.5, True)])
def test_what_moves_in_the_reflector_s_range_bin_is_told(bench: Bench, cells: float, moves: bool) -> None:
    said: list[str] = []
    speed_mps = cells * bench.radar.waveform.velocity_step_mps
    bench.calibrate([bench.measure("a.npy", 4.0, 10.0, 0.05, speed_mps=speed_mps)], announce=said.append)
    told = [float(line.split("something moves at ")[1].split()[0]) for line in said if "something moves at" in line]
    assert len(told) == moves
    assert all(0.0 < slowest <= speed_mps for slowest in told)  # "or faster"


def test_a_channel_far_behind_the_others_is_named(bench: Bench) -> None:
    bench.delay_s[3] = 0.9 / bench.radar.waveform.bandwidth_hz
    with pytest.raises(InputError, match=r"a\.npy: channels 3 stand 0\.6 range bins or more off .* expected delays"):
        bench.calibrate([bench.measure("a.npy", 4.0, 10.0, 0.01)])


@pytest.mark.parametrize("chirps", [1, 2, 3, 5])
def test_noise_in_many_frames_is_nothing_that_moves(bench: Bench, chirps: int) -> None:
    """The mean over all frames shows the reflector, where each frame is noise."""
    radar = bench.radar.model_copy(update={"waveform": bench.radar.waveform.model_copy(update={"chirps": chirps})})
    generator, place = np.random.default_rng(1), Place(Path("a"), 4.0, 10.0)
    echo = if_signal(radar.of_one_chirp, place.position[None], np.zeros((1, 3)), np.ones(1, dtype=complex))[0]
    shape = (60, chirps, *echo.shape)
    noise = generator.standard_normal((*shape, 2)) @ np.array([5.0, 5.0j])
    assert _moving(RawCapture((echo + noise).astype(np.complex64), radar, "", "relative", (), ()), place) == []
