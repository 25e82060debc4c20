"""The chirps of a TI radar as its tools state them, and the :class:`Waveform` that this is.

A chirp takes its turn in ``idle_time + ramp_end_time``. Its frequency rises from ``start_frequency`` at the end of the
idle time, and sampling begins ``adc_start_time`` later (mmWave SDK user guide, ``profileCfg``; mmWave Studio the same).
What is sampled is therefore a sweep that begins at

    f_c = start_frequency + slope * adc_start_time

and covers B = slope * samples / sample_rate. TX send one after the other in the order of ``tx``, again from the first
in the next loop. Not supported: chirps of several TX (BPM, DDM, beamforming), falling ramps.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import Field, FiniteFloat, model_validator

from shared.physics.errors import InputError
from shared.radar.arrays import AntennaArray
from shared.radar.validation import Described, validated
from shared.radar.waveform import Duration, Frequency, Waveform

Number = Annotated[int, Field(ge=1, le=64)]


class ChirpProfile(Described):
    """Chirps of a frame.

    :param start_frequency_hz: at the begin of the ramp
    :param slope_hz_per_s: of the ramp
    :param idle_time_s: before the ramp
    :param adc_start_time_s: from the ramp's begin to the first sample
    :param ramp_end_time_s: length of the ramp
    :param samples: a chirp
    :param sample_rate_hz: of the converter
    :param chirps: of each TX in a frame ("loops")
    :param tx: numbers of the TX as the board has them, from 1, in the order they send; all by default
    :param rx: numbers of the RX that were recorded, rising; all by default
    :param real: True where the converter records the in-phase signal alone; the board's where it is not stated
    """

    start_frequency_hz: Frequency
    slope_hz_per_s: Annotated[FiniteFloat, Field(gt=0, le=1e16)]
    idle_time_s: Annotated[FiniteFloat, Field(ge=0, le=1e3)] = 0.0
    adc_start_time_s: Annotated[FiniteFloat, Field(ge=0, le=1e3)] = 0.0
    ramp_end_time_s: Duration
    samples: Annotated[int, Field(ge=1, le=2**20)]
    sample_rate_hz: Frequency
    chirps: Annotated[int, Field(ge=1, le=2**16)]
    tx: tuple[Number, ...] = ()
    rx: tuple[Number, ...] = ()
    real: bool | None = None

    @model_validator(mode="after")
    def _within_the_ramp(self) -> ChirpProfile:
        end = self.adc_start_time_s + self.samples / self.sample_rate_hz
        if end > self.ramp_end_time_s * (1.0 + 1e-9):
            raise ValueError(f"samples end {end:g} s after the ramp began; expected at most {self.ramp_end_time_s:g} s")
        if len(set(self.tx)) != len(self.tx):
            raise ValueError(f"tx = {list(self.tx)}; expected each TX once")
        if list(self.rx) != sorted(set(self.rx)):
            raise ValueError(f"rx = {list(self.rx)}; expected rising numbers without repetition")
        return self

    def array(self, board: AntennaArray) -> AntennaArray:
        """The elements in use, TX in the order they send.

        :raises ValueError: numbers that the board does not have
        """
        chosen = []
        for name, numbers, positions in (("tx", self.tx, board.tx_m), ("rx", self.rx, board.rx_m)):
            if beyond := [number for number in numbers if number > len(positions)]:
                raise ValueError(f"{name} = {list(numbers)}: there is no {beyond[0]}; expected 1 to {len(positions)}")
            chosen.append(tuple(positions[number - 1] for number in numbers) or positions)
        return AntennaArray(tx_m=chosen[0], rx_m=chosen[1])

    def waveform(self, tx_count: int) -> Waveform:
        """The sweep that is sampled. Of real samples half the range bins are mirror images, and left out."""
        duration = self.samples / self.sample_rate_hz
        return Waveform(
            carrier_hz=self.start_frequency_hz + self.slope_hz_per_s * self.adc_start_time_s,
            bandwidth_hz=self.slope_hz_per_s * duration,
            chirp_duration_s=duration,
            chirp_interval_s=tx_count * (self.idle_time_s + self.ramp_end_time_s),
            chirps=self.chirps,
            samples=self.samples,
            range_bins=max(self.samples // 2, 1) if self.real else self.samples,
            multiplexing="tdm" if tx_count > 1 else "simultaneous",
        )


def read_cfg(path: Path) -> tuple[ChirpProfile, bool | None]:
    """(the chirps of a configuration of the mmWave SDK's demos, whether Q comes first; None where it does not say).

    Of ``channelCfg``, ``adcCfg``, ``profileCfg``, ``chirpCfg`` and ``frameCfg`` (mmWave SDK user guide, "Configuration
    file format"); the order of I and Q is ``SampleSwap`` of ``adcbufCfg``.

    :raises InputError: a line that is missing, not understood, or that asks for what is not supported
    """
    lines = _lines(path)
    profile, frame = _numbers(path, lines, "profileCfg", 11), _numbers(path, lines, "frameCfg", 3)
    channel = _numbers(path, lines, "channelCfg", 2)
    tx = _senders(path, lines, profile[0], frame, _set_bits(int(channel[1])))
    stated = {
        "start_frequency_hz": profile[1] * 1e9,
        "idle_time_s": profile[2] * 1e-6,
        "adc_start_time_s": profile[3] * 1e-6,
        "ramp_end_time_s": profile[4] * 1e-6,
        "slope_hz_per_s": profile[7] * 1e12,
        "samples": int(profile[9]),
        "sample_rate_hz": profile[10] * 1e3,
        "chirps": int(frame[2]),
        "tx": tx,
        "rx": _set_bits(int(channel[0])),
        "real": _numbers(path, lines, "adcCfg", 2)[1] == 0 if "adcCfg" in lines else None,
    }
    return validated(ChirpProfile, stated, f"{path}: profileCfg"), _quadrature_first(path, lines)


def _quadrature_first(path: Path, lines: dict[str, list[list[str]]]) -> bool | None:
    """What ``SampleSwap`` says: "0 - I in LSB, Q in MSB; 1 - Q in LSB, I in MSB" (the SDK's ``MmwDemo_ADCBufCfg``).

    A sample is one little-endian word in the buffer that the lanes send, so that its LSB comes first.
    """
    if "adcbufCfg" not in lines:
        return None
    numbers = _numbers(path, lines, "adcbufCfg", 4)
    swap = numbers[1 if len(numbers) == 4 else 2]  # the demos of the first SDKs name no subframe before
    if swap not in (0.0, 1.0):
        raise InputError(path, f"adcbufCfg: SampleSwap = {swap:g}", "0 where I comes first, 1 where Q does")
    return swap == 1.0


def _lines(path: Path) -> dict[str, list[list[str]]]:
    """The words after each command, by command."""
    expected = "a configuration of the mmWave SDK"
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(path, f"not readable: {error}", expected) from error
    found: dict[str, list[list[str]]] = {}
    for line in text.splitlines():
        command, *words = line.split("%")[0].split() or [""]
        if command:
            found.setdefault(command, []).append(words)
    return found


def _numbers(path: Path, lines: dict[str, list[list[str]]], command: str, count: int) -> list[float]:
    """The numbers of a command that stands there once."""
    given = lines.get(command, [])
    if len(given) != 1:
        raise InputError(path, f"{len(given)} lines {command}", "exactly one: one profile, one frame")
    return _as_numbers(path, command, given[0], count)


def _as_numbers(path: Path, command: str, words: list[str], count: int) -> list[float]:
    try:
        numbers = [float(word) for word in words]
    except ValueError as error:
        raise InputError(path, f"{command}: {error}", "numbers") from error
    if len(numbers) < count or not all(abs(number) < 2**53 for number in numbers):  # NaN too
        raise InputError(path, f"{command} {' '.join(words)}", f"at least {count} finite numbers")
    return numbers


def _senders(
    path: Path, lines: dict[str, list[list[str]]], profile: float, frame: list[float], on: tuple[int, ...]
) -> tuple[int, ...]:
    """The TX that the chirps of a frame are sent by, one after the other.

    :param profile: number of the one that there is
    :param on: numbers of the TX that are switched on
    """
    first, last = int(frame[0]), int(frame[1])
    masks: dict[int, int] = {}
    for words in lines.get("chirpCfg", []):
        numbers = _as_numbers(path, "chirpCfg", words, 8)
        begin, end = int(numbers[0]), int(numbers[1])
        if not 0 <= begin <= end < 512:
            raise InputError(path, f"chirpCfg {begin} {end}", "chirps from 0 to 511, rising")
        if numbers[2] != profile or any(numbers[3:7]):
            given, expected = " ".join(words), f"profile {profile:g} and variations of 0: chirps that are alike"
            raise InputError(path, f"chirpCfg {given}", expected)
        masks.update(dict.fromkeys(range(begin, end + 1), int(numbers[7])))
    if not 0 <= first <= last < 512 or not set(range(first, last + 1)) <= masks.keys():
        raise InputError(path, f"frameCfg {first} {last}", "chirps that a chirpCfg describes")
    senders = [_set_bits(masks[chirp]) for chirp in range(first, last + 1)]
    for chirp, numbers_of_tx in enumerate(senders, first):
        if len(numbers_of_tx) != 1:
            problem = f"chirp {chirp} is sent by TX {list(numbers_of_tx)}"
            raise InputError(path, problem, "one TX a chirp; BPM, DDM and beamforming are not supported")
        if numbers_of_tx[0] not in on:
            problem = f"chirp {chirp} is sent by TX {numbers_of_tx[0]}"
            raise InputError(path, problem, f"one of TX {list(on)}, which channelCfg switches on")
    return tuple(numbers_of_tx[0] for numbers_of_tx in senders)


def _set_bits(mask: int) -> tuple[int, ...]:
    """Numbers from 1 of the bits that are set."""
    return tuple(bit + 1 for bit in range(16) if mask >> bit & 1)
