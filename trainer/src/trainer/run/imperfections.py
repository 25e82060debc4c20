"""How boards differ from the array that their data sheet describes: magnitudes, as part of a run's configuration.

A field with two numbers holds the ends between which each board draws its own, uniformly.
:mod:`trainer.training.imperfections` has the physics.
"""

from __future__ import annotations

from typing import Annotated

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, FiniteFloat

from shared.radar.front_end import PhaseNoise


def _rising(ends: tuple[float, float]) -> tuple[float, float]:
    if ends[0] > ends[1]:
        raise ValueError(f"{ends[0]:g} to {ends[1]:g} does not rise")
    return ends


NotNegative = Annotated[FiniteFloat, Field(ge=0)]
Share = Annotated[FiniteFloat, Field(ge=0, le=1)]
Spread = Annotated[tuple[NotNegative, NotNegative], AfterValidator(_rising)]
"""Least and largest root mean square of a board."""
Level = Annotated[tuple[FiniteFloat, FiniteFloat], AfterValidator(_rising)]
"""Least and largest level of a board [dB]."""


class Imperfections(BaseModel):
    """Magnitudes of boards after calibration with a reflector, by default.

    :param perfect: share of boards without any imperfection, as simulated frames are
    :param gain_db: rms over the channels. 77 GHz captures of several boards have 0.9 to 1.6 dB
    :param phase_deg: rms over the channels. The same captures have 10 to 14 degrees before calibration, 2 to 5 after
    :param delay_s: rms over the receivers, between mixer and converter. An assumption: a low pass of first order at 20
        MHz delays by 8 ns, and parts of 5 % tolerance vary that by 0.4 ns
    :param position_m: rms over the elements, along the array. Etching is exact to 25 to 50 um
    :param coupling_db: power of an element's signal in each of its neighbours. Patches half a wavelength apart have -20
        to -30 dB (Balanis, Antenna Theory, chapter 14.8); here TX stand half a wavelength apart, RX one and a half
    :param dead: probability of each receiver. An assumption: of a line of a hundred boards one or two miss one
    :param leakage_db: power of what goes from TX to RX directly, over the noise of a channel, at range zero. An
        assumption: the high pass behind the mixer and the choice of Doppler cells leave little of it
    :param bits: of the converter, effective: 12 of the usual chips less two of its own noise and distortion
    :param headroom_db: of the converter's full scale over the root mean square of the signal
    :param phase_noise: of the oscillator. At 1 MHz from 77 GHz it has the -95 dBc/Hz of the data sheet of TI's AWR1243
    :param reported_db: standard deviation of the model error that calibration reports about the one that is there
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    perfect: Share = 0.25
    gain_db: Spread = (0.9, 1.6)
    phase_deg: Spread = (2.0, 5.0)
    delay_s: Spread = (0.0, 0.4e-9)
    position_m: Spread = (0.0, 0.05e-3)
    coupling_db: Level | None = (-40.0, -28.0)
    dead: Share = 0.01
    leakage_db: Level | None = (0.0, 40.0)
    bits: Annotated[int, Field(ge=1, le=24)] | None = 10
    headroom_db: NotNegative = 12.0
    phase_noise: PhaseNoise | None = PhaseNoise(level_dbc_per_hz=-84.2)
    reported_db: NotNegative = 2.0


CALIBRATED = Imperfections()
IMPERFECTIONS: dict[str, Imperfections | None] = {
    "none": None,
    "calibrated": CALIBRATED,
    "uncalibrated": CALIBRATED.model_copy(update={"phase_deg": (10.0, 14.0)}),
}
"""By the name that ``--imperfections`` takes."""


def _named(given: object) -> object:
    if not isinstance(given, str):
        return given
    if given not in IMPERFECTIONS:
        raise ValueError(f"{given!r}, expected one of {', '.join(IMPERFECTIONS)}")
    return IMPERFECTIONS[given]


Given = Annotated[Imperfections | None, BeforeValidator(_named)]
"""Of a configuration: the value, or its name in :data:`IMPERFECTIONS`."""
