"""Element patterns: what they promise about power and width."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import dblquad

from shared.dataset.reading import radar_of
from shared.physics.errors import InputError
from shared.radar import load_radar
from shared.radar.antenna import (
    IsotropicPattern,
    ParabolicPattern,
    PatchPattern,
    TablePattern,
    Tr38901Pattern,
    car_radar_pattern,
    read_table,
)


def direction(azimuth_deg: float, elevation_deg: float) -> np.ndarray:
    azimuth, elevation = np.radians([azimuth_deg, elevation_deg])
    return np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])


def mean_gain(pattern) -> float:
    """Power gain averaged over the sphere: 1 for a lossless element, by the conservation of energy."""
    z, weight = np.polynomial.legendre.leggauss(500)  # uniform in the sine of elevation
    azimuth = 2.0 * np.pi * (np.arange(360) + 0.5) / 360
    rho = np.sqrt(1.0 - z**2)
    directions = np.stack(
        [np.outer(rho, np.cos(azimuth)), np.outer(rho, np.sin(azimuth)), np.repeat(z[:, None], 360, axis=1)], axis=-1
    )
    return float(weight @ pattern.power_gain(directions).mean(axis=1) / 2.0)


def test_the_car_radars_element_is_lossless():
    assert 10.0 * np.log10(mean_gain(car_radar_pattern())) == pytest.approx(0.0, abs=0.05)


def test_isotropic_is_isotropic():
    assert mean_gain(IsotropicPattern()) == pytest.approx(1.0)
    np.testing.assert_allclose(IsotropicPattern(gain_dbi=3.0).power_gain(np.ones((4, 5, 3))), 10.0**0.3)


@pytest.mark.parametrize(("azimuth_deg", "elevation_deg"), [(55.0, 0.0), (-55.0, 0.0), (0.0, 6.5), (0.0, -6.5)])
def test_two_way_widths_are_110_and_13_degrees(azimuth_deg, elevation_deg):
    pattern = car_radar_pattern()
    gains = pattern.power_gain(np.stack([direction(azimuth_deg, elevation_deg), direction(0.0, 0.0)])) ** 2
    assert 10.0 * np.log10(gains[0] / gains[1]) == pytest.approx(-3.0, abs=1e-9)


def test_gain_and_floor():
    pattern = ParabolicPattern(gain_dbi=10.0, azimuth_beamwidth_deg=60.0, elevation_beamwidth_deg=20.0, floor_db=25.0)
    levels = 10.0 * np.log10(
        pattern.power_gain(np.stack([direction(0, 0), direction(30, 0), direction(30, 10), direction(180, 0)]))
    )
    np.testing.assert_allclose(levels, [10.0, 7.0, 4.0, -15.0], atol=1e-9)


def level_dbi(pattern, azimuth_deg: float, elevation_deg: float) -> float:
    return float(10.0 * np.log10(pattern.power_gain(direction(azimuth_deg, elevation_deg))))


def test_the_3gpp_element_is_that_of_table_7_3_1():
    pattern = Tr38901Pattern()
    assert level_dbi(pattern, 0.0, 0.0) == pytest.approx(8.0)
    for azimuth, elevation in ((32.5, 0.0), (-32.5, 0.0), (0.0, 32.5), (0.0, -32.5)):
        assert level_dbi(pattern, azimuth, elevation) == pytest.approx(5.0)
    assert level_dbi(pattern, 32.5, 32.5) == pytest.approx(2.0)
    assert level_dbi(pattern, 180.0, 0.0) == pytest.approx(-22.0)
    assert level_dbi(pattern, 90.0, 60.0) == pytest.approx(-22.0)
    assert 10.0 * np.log10(mean_gain(pattern)) == pytest.approx(-1.83, abs=0.01)  # losses, as its docstring says


@pytest.mark.parametrize(
    "pattern",
    [
        PatchPattern(),
        PatchPattern(width_wavelengths=1.5, length_wavelengths=0.5, height_wavelengths=0.1, resonant_along="y"),
        PatchPattern(back_db=0.0),
    ],
)
def test_a_lossless_patch_radiates_what_it_accepts(pattern):
    # The quadrature over the sphere meets the step at the ground plane; its own error is 1e-3.
    assert mean_gain(pattern) == pytest.approx(1.0, abs=3e-3)
    assert mean_gain(pattern.model_copy(update={"efficiency_db": -2.0})) == pytest.approx(10.0**-0.2, abs=3e-3)


def test_a_patchs_directivity_is_that_of_the_textbook():
    """Two slots over an infinite ground plane, h -> 0: D = (2 pi W / lambda)^2 pi / I_2 (Balanis, eq. 14-55)."""
    width, length = 0.395, 0.356

    def integrand(theta: float, phi: float) -> float:
        slot = np.pi * width * np.sinc(width * np.cos(theta))  # sin(k W cos / 2) / cos
        return slot**2 * np.sin(theta) ** 3 * np.cos(np.pi * length * np.sin(theta) * np.sin(phi)) ** 2

    integral, _ = dblquad(integrand, 0.0, np.pi, 0.0, np.pi)
    expected = (2.0 * np.pi * width) ** 2 * np.pi / integral
    pattern = PatchPattern(width_wavelengths=width, length_wavelengths=length, height_wavelengths=0.0, back_db=200.0)
    assert pattern.boresight_gain_dbi == pytest.approx(10.0 * np.log10(expected), abs=1e-6)
    assert level_dbi(pattern, 0.0, 0.0) == pytest.approx(pattern.boresight_gain_dbi)


def test_a_patch_turns_with_its_resonant_length_and_has_a_back():
    upright = PatchPattern(back_db=25.0)
    lying = upright.model_copy(update={"resonant_along": "y"})
    assert level_dbi(upright, 40.0, 0.0) == pytest.approx(level_dbi(lying, 0.0, 40.0))
    assert level_dbi(upright, 40.0, 0.0) != pytest.approx(level_dbi(upright, 0.0, 40.0), abs=0.1)
    for azimuth in (100.0, 180.0):
        assert level_dbi(upright, azimuth, 0.0) == pytest.approx(upright.boresight_gain_dbi - 25.0)
    assert upright.power_gain(np.zeros(3)) == pytest.approx(float(upright.power_gain(direction(0, 0))))
    assert upright.power_gain(5.0 * direction(20, 10)) == pytest.approx(float(upright.power_gain(direction(20, 10))))


AZIMUTHS, ELEVATIONS = np.linspace(-180.0, 180.0, 73), np.linspace(-90.0, 90.0, 37)


def pattern_file(tmp_path: Path, rows: list[str], header: str = "azimuth_deg,elevation_deg,gain_dbi") -> Path:
    path = tmp_path / "pattern.csv"
    path.write_text("\n".join([header, *rows]) + "\n", encoding="utf-8")
    return path


def sampled(pattern) -> list[str]:
    return [f"{a:g},{e:g},{level_dbi(pattern, a, e)!r}" for a in AZIMUTHS for e in ELEVATIONS]


def test_a_table_is_the_pattern_it_was_sampled_from(tmp_path):
    pattern = ParabolicPattern(gain_dbi=9.0, azimuth_beamwidth_deg=110.0, elevation_beamwidth_deg=60.0, floor_db=300.0)
    rows = sampled(pattern)
    table = read_table(pattern_file(tmp_path, rows))
    for azimuth, elevation in ((0.0, 0.0), (35.0, -10.0), (-180.0, 5.0), (90.0, 85.0)):  # on the grid
        assert level_dbi(table, azimuth, elevation) == pytest.approx(level_dbi(pattern, azimuth, elevation), abs=1e-9)
    # Between its points: the chord of a parabola, 12 (2.5 / width)^2 too low at most in each axis.
    worst = 12.0 * (2.5 / 110.0) ** 2 + 12.0 * (2.5 / 60.0) ** 2
    for azimuth, elevation in ((2.5, 2.5), (-31.1, 13.7), (120.2, -44.4)):
        error = level_dbi(pattern, azimuth, elevation) - level_dbi(table, azimuth, elevation)
        assert 0.0 < error <= worst + 1e-9
    # The order of rows and columns does not matter.
    turned = [",".join(reversed(row.split(","))) for row in reversed(rows)]
    assert read_table(pattern_file(tmp_path, turned, "gain_dbi, elevation_deg, azimuth_deg")) == table


def test_a_radar_names_a_file_and_keeps_the_pattern_itself(tmp_path):
    pattern_file(tmp_path, ["-60,-20,1", "-60,20,2", "60,-20,3", "60,20,4"])
    path = tmp_path / "radar.toml"
    path.write_text(
        '[front_end]\nrx_pattern = { kind = "table", file = "pattern.csv", outside_gain_dbi = -40 }\n', encoding="utf-8"
    )
    radar = load_radar(str(path))
    expected = TablePattern(
        azimuth_deg=(-60.0, 60.0),
        elevation_deg=(-20.0, 20.0),
        gain_dbi=((1.0, 2.0), (3.0, 4.0)),
        outside_gain_dbi=-40.0,
    )
    assert radar.front_end.rx_pattern == expected
    (tmp_path / "pattern.csv").unlink()
    text = json.dumps(radar.metadata(), allow_nan=False)
    assert "pattern.csv" not in text
    assert radar_of(json.loads(text)) == radar


CORNERS = [f"{a},{e},0" for a in (-180, 0, 180) for e in (-90, 90)]


@pytest.mark.parametrize(
    ("rows", "parts"),
    [
        ([*CORNERS[:2], "0,-90,x", *CORNERS[3:]], ["line 4: gain_dbi is no number", "expected a number"]),
        ([*CORNERS[:2], "0,-90,nan", *CORNERS[3:]], ["line 4: gain_dbi = nan"]),
        ([*CORNERS[:2], "0,-91,0", *CORNERS[3:]], ["line 4: elevation_deg = -91", "-90 to 90"]),
        (["0,0", *CORNERS], ["line 2: 2 values", "expected 3"]),
        (CORNERS[:-1], ["no line with azimuth_deg = 180, elevation_deg = 90", "3 x 2"]),
        ([*CORNERS, "0,90,1"], ["line 8: azimuth_deg = 0, elevation_deg = 90 a second time"]),
        (CORNERS[:4], ["azimuth_deg runs from -180 to 0", "outside_gain_dbi"]),
        (["-180,0,1", "180,0,1"], ["elevation_deg: 1 in the file", "at least 2 azimuths and 2 elevations"]),
        ([], ["azimuth_deg: 0 in the file"]),
    ],
)
def test_a_table_with_a_fault_is_one_line_that_names_it(tmp_path, rows, parts):
    with pytest.raises(InputError) as caught:
        read_table(pattern_file(tmp_path, rows))
    for part in ("pattern.csv: ", *parts):
        assert part in str(caught.value)


def test_what_is_no_table_is_one_line(tmp_path):
    for content in (b"", b"azimuth,elevation,gain\n1,2,3\n", b"\xff\xfe\x00", b"\x00\n"):
        path = tmp_path / "pattern.csv"
        path.write_bytes(content)
        with pytest.raises(InputError, match=r"pattern\.csv: .*header azimuth_deg,elevation_deg,gain_dbi"):
            read_table(path)
    with pytest.raises(InputError, match=r"absent\.csv: not readable: No such file"):
        read_table(tmp_path / "absent.csv")
    with pytest.raises(InputError, match="not readable: Is a directory"):
        read_table(tmp_path)


@pytest.mark.parametrize(
    "content",
    [
        b"root:x:0:0:hunter2:/root:/bin/sh\n",
        b'"hunter2\n',
        b"azimuth_deg,elevation_deg,gain_dbi\n0,0,hunter2\n",
        b"azimuth_deg,elevation_deg,gain_dbi\nhunter2\n",
    ],
)
def test_no_error_quotes_a_file_that_a_radar_names(tmp_path, content):
    (tmp_path / "secret").write_bytes(content)
    (tmp_path / "radar.toml").write_text('[front_end]\nrx_pattern = { kind = "table", file = "secret" }\n')
    with pytest.raises(InputError) as caught:
        load_radar(str(tmp_path / "radar.toml"))
    assert "hunter2" not in str(caught.value)
    assert str(caught.value).startswith(f"{tmp_path / 'secret'}: ")
