"""TDM: channels compensated for motion between the turns, the velocity interval, elements that coincide."""

import numpy as np
import pytest
from oracles import receiver_noise, reference_file

from shared.radar import Radar, load_radar
from shared.radar.arrays import AntennaArray, line
from shared.radar.waveform import Waveform
from shared.signal import if_signal
from shared.signal.signal import chirp_times
from shared.signal.spectrum import (
    DopplerSelection,
    doppler_neighbours,
    range_doppler,
    select_doppler,
    selection_at,
    unfold,
)
from shared.signal.tdm import averaged, compensated, statement
from shared.signal.windows import cell_noise_power

RANGE_M, U = 30.0, 0.6
"""Far enough for plane waves over the array: its sidelobes of -13.2 dB are nearly those of a uniform line."""


def tdm_radar(chirps: int = 128, **changes) -> Radar:
    """Turns of 40.3 us. With the three TX of the default array velocities below 8 m/s have their own Doppler cell."""
    array = changes.pop("array", Radar().array)
    waveform = Waveform(
        carrier_hz=77.375e9, bandwidth_hz=250e6, chirp_duration_s=40.3e-6, chirp_interval_s=len(array.tx_m) * 40.3e-6,
        multiplexing="tdm", samples=64, range_bins=64, chirps=chirps,
    )  # fmt: skip
    return Radar(waveform=waveform, array=array, **changes)


def half_wavelengths(tx: list[float], rx: list[float]) -> AntennaArray:
    """Elements at multiples of half the wavelength of :func:`tdm_radar`."""
    half = 0.5 * tdm_radar().waveform.wavelength_m
    return AntennaArray(tx_m=line(half * np.array(tx)), rx_m=line(half * np.array(rx)))


OVERLAPPED = half_wavelengths([0, 3, 6], [0, 1, 2, 3])
"""Elements 3 and 6 of a line of 10 are made by two TX each, one turn apart."""


def at_once(radar: Radar) -> Radar:
    return radar.model_copy(update={"waveform": radar.waveform.model_copy(update={"multiplexing": "simultaneous"})})


def selected(radar: Radar, velocities_mps, noise=None, u=U, amplitudes=None) -> tuple[DopplerSelection, int]:
    """(the peaks of targets at one range and angle with these range rates, their row at mid-frame)."""
    place = RANGE_M * np.array([np.sqrt(1.0 - u**2), u, 0.0])
    # Back from mid-frame, so that all stand at one range there.
    rates = np.array(velocities_mps)[:, None] * place / RANGE_M
    start = place - rates * radar.waveform.mid_frame_s
    cube = if_signal(radar, start, rates, np.ones(len(rates)) if amplitudes is None else np.array(amplitudes))
    if noise is not None:
        cube = cube + receiver_noise(radar, noise)
    power = 0.0 if noise is None else cell_noise_power(radar)
    selection = unfold(select_doppler(range_doppler(cube.astype(np.complex64), radar), power), radar)
    return selection, round(RANGE_M / radar.waveform.range_step_m)


def lobes(snapshot, y_m, wavelength_m) -> tuple[float, float]:
    """(u of the main lobe, level of the highest other one [dB]) of delay-and-sum."""
    u = np.linspace(-0.96, 0.96, 8001)
    image = np.abs(snapshot @ np.exp(2j * np.pi / wavelength_m * np.multiply.outer(y_m, u)))
    peak = int(image.argmax())
    falling = np.diff(image) < 0
    right = peak + int(np.argmin(np.append(falling[peak:], False)))
    left = peak - int(np.argmin(np.append(~falling[:peak][::-1], False)))
    return float(u[peak]), float(20.0 * np.log10(max(image[: left + 1].max(), image[right:].max()) / image[peak]))


@pytest.mark.parametrize("share", [-0.9999, -0.61, 0.003, 0.875, 0.9999])
def test_sidelobes_and_angle_hold_over_the_whole_velocity_interval(share):
    radar = tdm_radar()
    velocity = 0.5 * share * radar.waveform.velocity_span_mps
    selection, row = selected(radar, [velocity])
    u, level = lobes(selection.range_channel[0, row], radar.array.virtual[:, 1], radar.waveform.wavelength_m)
    assert level == pytest.approx(-13.25, abs=0.1)
    assert u == pytest.approx(U, abs=0.002)
    found = selection.velocities_mps(radar.waveform)[0, row]
    # The channels as they were before any compensation.
    turns = 2.0 * found / radar.waveform.wavelength_m * chirp_times(radar)[radar.array.channel_tx, 0]
    before = selection.range_channel[0, row] * np.exp(2j * np.pi * turns)
    uncompensated = lobes(before, radar.array.virtual[:, 1], radar.waveform.wavelength_m)[1]
    assert (uncompensated > -3.0) == (abs(share) > 0.8)
    assert found == pytest.approx(velocity, abs=1.01 * 0.5 * radar.waveform.velocity_step_mps)


@pytest.mark.parametrize("off", [0.0, 0.25, 0.5])
def test_what_is_left_is_the_stated_phase_and_magnitude(off):
    # Against the same target seen by all TX at once: 2 pi off i / (N M) rad, and i / N of a chirp's range migration.
    radar = tdm_radar(chirps=32)
    waveform = radar.waveform
    velocity = (9 + off) * waveform.velocity_step_mps
    place, rate = np.array([[RANGE_M, 0.0, 0.0]]), np.array([[velocity, 0.0, 0.0]])
    row = round((RANGE_M + velocity * waveform.mid_frame_s) / waveform.range_step_m)
    in_turns, together = (
        range_doppler(if_signal(one, place, rate, np.ones(1)).astype(np.complex64), one)[row, 16 + 9]
        for one in (radar, at_once(radar))
    )
    left = np.mean((in_turns / together).reshape(16, 3), axis=0)
    np.testing.assert_allclose(np.angle(left), 2.0 * np.pi * off * np.arange(3) / (3 * 32), atol=2e-4)
    crossed = velocity * waveform.chirp_interval_s / waveform.range_step_m  # bins a chirp
    assert np.abs(np.abs(left) - 1.0).max() < crossed


@pytest.mark.parametrize(
    ("array", "intervals"),
    [
        (OVERLAPPED, 3),
        (half_wavelengths([0, 4], [0, 1, 2, 3]), 1),
        (half_wavelengths([0, 3], [0, 1, 2, 3]), 2),
        (half_wavelengths([0, 20, 3, 40], [0, 1, 2, 3]), 2),  # only TX 0 and 2 meet: h is known modulo 2 of 4
        (half_wavelengths([0, 3, 20, 23], [0, 1, 2, 3]), 4),
        (half_wavelengths([0, 1, 0.005], [0, 10]), 3),  # within a hundredth of a wavelength
        (half_wavelengths([0, 1, 0.05], [0, 10]), 1),
    ],
)
def test_overlapped_elements_say_how_many_intervals_are_told_apart(array, intervals):
    radar = tdm_radar(array=array)
    assert radar.velocity_intervals == intervals
    assert at_once(radar).velocity_intervals == 1


@pytest.mark.parametrize("share", [-2.998, -1.002, -0.998, 0.0, 0.998, 1.002, 1.7, 2.998])
def test_overlapped_elements_tell_the_interval(share):
    radar = tdm_radar(array=OVERLAPPED)
    velocity = 0.5 * share * radar.waveform.velocity_span_mps
    selection, row = selected(radar, [velocity], np.random.default_rng(3))
    assert selection.velocities_mps(radar.waveform)[0, row] == pytest.approx(
        velocity, abs=0.51 * radar.waveform.velocity_step_mps
    )
    elements, places = averaged(selection.range_channel[0, row], radar)
    assert elements.shape == (10,)
    u, level = lobes(elements, places[:, 1], radar.waveform.wavelength_m)
    assert u == pytest.approx(U, abs=0.01)
    assert level == pytest.approx(-12.97, abs=0.1)


@pytest.mark.parametrize(
    ("array", "intervals"),
    [(half_wavelengths([0, 3], [0, 1, 2, 3]), 2), (OVERLAPPED, 3), (half_wavelengths([0, 3, 20, 23], [0, 1, 2, 3]), 4)],
)
@pytest.mark.parametrize("sign", [-1, 1])
def test_at_the_end_of_the_velocities_the_side_is_told(array, intervals, sign):
    # The cell of +-K / 2 intervals: the lowest of the spectrum where K is odd, the middle one where it is even.
    radar = tdm_radar(array=array)
    velocity = sign * (0.5 * intervals * radar.waveform.velocity_span_mps - 0.1 * radar.waveform.velocity_step_mps)
    for seed in range(6):
        selection, row = selected(radar, [velocity], np.random.default_rng(seed))
        found = selection.velocities_mps(radar.waveform)[0, row]
        assert found == pytest.approx(velocity, abs=0.51 * radar.waveform.velocity_step_mps)


@pytest.mark.parametrize("interval", [0, 1])
def test_the_cells_beside_one_are_turned_as_it_is(interval):
    """An echo between two cells has one angle in both, also beyond the interval that one TX tells."""
    radar = tdm_radar(array=OVERLAPPED)
    waveform = radar.waveform
    velocity = waveform.velocities_mps[100] + 0.4 * waveform.velocity_step_mps + interval * waveform.velocity_span_mps
    place = RANGE_M * np.array([[np.sqrt(1.0 - U**2), U, 0.0]])
    cube = if_signal(radar, place, place / RANGE_M * velocity, np.ones(1))
    spectra = range_doppler(cube.astype(np.complex64), radar)
    row = int(np.abs(spectra).sum(axis=(1, 2)).argmax())
    selection = unfold(selection_at(spectra, np.full(len(spectra), 100)), radar)
    assert selection.interval[0, row] == interval
    own, above = selection.range_channel[0, row], doppler_neighbours(spectra, selection, radar)[1, 0, row]
    assert abs(np.vdot(own, above)) > 0.999999 * np.linalg.norm(own) * np.linalg.norm(above)


def test_each_peak_of_a_range_bin_has_its_own_interval():
    radar = tdm_radar(array=OVERLAPPED)
    span = radar.waveform.velocity_span_mps
    selection, row = selected(radar, [0.1 * span, 1.3 * span, -0.8 * span], amplitudes=[1.0, 0.6, 0.3])
    assert selection.interval[:, row].tolist() == [0, 1, -1]
    found = selection.velocities_mps(radar.waveform)[:, row] / span
    np.testing.assert_allclose(found, [0.1, 1.3, -0.8], atol=0.51 / 128)


@pytest.mark.parametrize("chirps", [1, 2, 3, 8])
def test_silence_and_few_chirps_have_interval_0(chirps):
    radar = tdm_radar(chirps=chirps, array=OVERLAPPED)
    selection = unfold(select_doppler(np.zeros((5, chirps, 12), np.complex64), 0.0), radar)
    assert not selection.range_channel.any()
    assert np.abs(selection.velocities_mps(radar.waveform)).max() <= 0.5 * radar.waveform.velocity_span_mps
    assert not selection.interval.any()


def test_the_interval_is_found_at_the_stated_signal_to_noise_ratio():
    # docs/notes/tdm.md: two overlapped elements, 3 TX: 8 % are wrong at 3 dB, 1 % at 6 dB, 1 of 20 000 at 10 dB.
    radar = tdm_radar(chirps=16, array=OVERLAPPED)
    generator = np.random.default_rng(5)
    waveform, share = radar.waveform, {}
    for snr_db in (3.0, 10.0):
        h, cell = generator.integers(-1, 2, 1000), generator.integers(2, 14, 1000)
        cycles = (cell - 8) / 16 + h
        phase, u = generator.random(1000)[:, None], generator.uniform(-0.9, 0.9, 1000)[:, None]
        phase = phase - u * radar.array.virtual[:, 1] / waveform.wavelength_m
        signal = np.exp(2j * np.pi * (phase + cycles[:, None] * radar.array.channel_tx / 3))
        noise = generator.standard_normal((1000, 12, 2)) @ np.array([1.0, 1.0j]) * np.sqrt(0.5)
        spectra = np.zeros((1000, 16, 12), np.complex64)
        spectra[np.arange(1000), cell] = 10.0 ** (snr_db / 20.0) * signal + noise
        found = unfold(select_doppler(compensated(spectra, radar), 1.0), radar)
        share[snr_db] = np.mean(found.interval[0] == h)
    assert share[10.0] > 0.998
    assert 0.9 < share[3.0] < 0.94


@pytest.mark.parametrize(("range_m", "u"), [(2.0, 0.7), (2.0, -0.3), (5.0, 0.5), (20.0, -0.8)])
def test_the_cascade_tells_nine_intervals_from_2_m_on(range_m, u):
    # Nearer, the wave front's curvature decides wrongly at times: elements coincide in the far field.
    radar = load_radar("mmwcas-azimuth")
    short = radar.waveform.model_copy(update={"samples": 16, "range_bins": 16, "chirps": 16})
    radar = radar.model_copy(update={"waveform": short})
    assert radar.velocity_intervals == 9
    row = round(range_m / short.range_step_m) % 16  # ranges fold
    towards = np.array([[np.sqrt(1.0 - u**2), u, 0.0]])
    for velocity in short.velocity_span_mps * np.array([-4.4, -1.7, 0.2, 3.1]):
        start = towards * (range_m - velocity * short.mid_frame_s)
        cube = if_signal(radar, start, velocity * towards, np.ones(1))
        selection = unfold(select_doppler(range_doppler(cube.astype(np.complex64), radar), 0.0), radar)
        found = selection.velocities_mps(short)[0, row]
        assert found == pytest.approx(velocity, abs=0.51 * short.velocity_step_mps)


def test_coinciding_elements_are_averaged_and_missing_ones_left_out():
    radar = tdm_radar(array=OVERLAPPED)
    half = 0.5 * radar.waveform.wavelength_m
    channels = np.arange(12.0) + 1j
    elements, places = averaged(channels, radar)
    np.testing.assert_allclose(places[:, 1] / half, np.arange(10), atol=1e-9)
    # rx-major: RX 3 with TX 0 and RX 0 with TX 1 make element 3, RX 3 with TX 1 and RX 0 with TX 2 element 6.
    np.testing.assert_allclose(elements[[0, 1, 3, 6]].real, [0, 3, (9 + 1) / 2, (10 + 2) / 2])
    elements, places = averaged(channels, radar, missing=(9, 0))
    np.testing.assert_allclose(places[:, 1] / half, np.arange(1, 10), atol=1e-9)
    np.testing.assert_allclose(elements[[0, 2]].real, [3, 1])


def test_the_statement_says_what_is_resolved():
    assert statement(at_once(tdm_radar())) is None
    assert "nothing resolves the Doppler ambiguity; velocities hold from -8 to 8 m/s" in str(statement(tdm_radar()))
    told = str(statement(tdm_radar(array=OVERLAPPED)))
    assert "resolve 3 Doppler intervals of 16 m/s; velocities hold from -24 to 24 m/s" in told
    assert "\n" not in told


def test_a_real_capture_shows_the_reflector_and_both_movers():
    # 77 GHz, 2 TX in turns x 4 RX, 60 MHz/us, 2.5 Msps, idle 30 us and ramp 62 us; elements run to the right.
    raw = np.load(reference_file("measured", "openradar", "doppler_example_1.npy"))  # [chirp, TX x RX, sample]
    signed = raw.real.astype(np.uint16).astype(np.int16) + 1j * raw.imag.astype(np.uint16).astype(np.int16)
    duration = 128 / 2.5e6
    waveform = Waveform(
        carrier_hz=77.4201e9, bandwidth_hz=60e12 * duration, chirp_duration_s=duration, chirp_interval_s=184e-6,
        chirps=128, samples=128, range_bins=128, multiplexing="tdm",
    )  # fmt: skip
    half = 0.5 * waveform.wavelength_m
    array = AntennaArray(tx_m=line(-half * np.array([0.0, 4.0])), rx_m=line(-half * (np.arange(4.0) - 1.5)))
    radar = Radar(waveform=waveform, array=array)
    cube = signed.reshape(128, 2, 4, 128).transpose(0, 3, 2, 1).reshape(128, 128, 8)  # rx-major
    selection = unfold(select_doppler(range_doppler(cube.astype(np.complex64), radar), 0.0), radar)
    velocity = selection.velocities_mps(waveform)
    for range_m, rate, angle_deg in ((5.22, 0.0, 2.5), (2.93, 0.56, 7.0), (2.98, -0.48, -15.0)):
        row = round(range_m / waveform.range_step_m)
        peak = int(np.abs(velocity[:, row] - rate).argmin())
        assert velocity[peak, row] == pytest.approx(rate, abs=0.51 * waveform.velocity_step_mps)
        u, _ = lobes(selection.range_channel[peak, row], array.virtual[:, 1], waveform.wavelength_m)
        assert np.degrees(np.arcsin(u)) == pytest.approx(angle_deg, abs=1.0)
    assert "nothing resolves" in str(statement(radar))


def test_where_only_half_of_the_intervals_are_told_apart_the_slower_one_is_taken():
    radar = tdm_radar(array=half_wavelengths([0, 20, 3, 40], [0, 1, 2, 3]))
    span = radar.waveform.velocity_span_mps
    for velocity, found in ((0.8, 0.8), (-0.8, -0.8), (1.3, -0.7)):
        selection, row = selected(radar, [velocity * span])
        assert selection.velocities_mps(radar.waveform)[0, row] == pytest.approx(found * span, abs=span / 128)
