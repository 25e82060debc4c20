"""What a run is made with: one frozen value, written into the run folder and compared when it is resumed.

Among it is how boards differ from the array that their data sheet describes (:mod:`trainer.training.imperfections` has
the physics).
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, BeforeValidator, Field, FiniteFloat, model_validator

from shared.processes.defaults import ANGLE_WINDOWS, LARGEST_SEED, TRUTH_WINDOW
from shared.radar.front_end import PhaseNoise
from shared.radar.validation import Described
from trainer.defaults import Features, Model, Precision, Target

Share = Annotated[FiniteFloat, Field(ge=0, le=1)]


def first_difference(one: BaseModel, other: BaseModel, names: Iterable[str]) -> tuple[str, Any, Any] | None:
    """(name, one's value, the other's) of the first of these fields that is not the same; None where all are."""
    values = ((name, getattr(one, name), getattr(other, name)) for name in names)
    return next((entry for entry in values if entry[1] != entry[2]), None)


def _rising(ends: tuple[float, float]) -> tuple[float, float]:
    if ends[0] > ends[1]:
        raise ValueError(f"{ends[0]:g} to {ends[1]:g} does not rise")
    return ends


NotNegative = Annotated[FiniteFloat, Field(ge=0)]
Spread = Annotated[tuple[NotNegative, NotNegative], AfterValidator(_rising)]
"""Least and largest root mean square of a board."""
Level = Annotated[tuple[FiniteFloat, FiniteFloat], AfterValidator(_rising)]
"""Least and largest level of a board [dB]."""


class Imperfections(Described):
    """Magnitudes of boards after calibration with a reflector, by default.

    A field with two numbers holds the ends between which each board draws its own, uniformly.

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


Count = Annotated[int, Field(ge=1, le=10**9)]
Few = Annotated[int, Field(ge=1, le=2**14)]
"""Channels, units, frames of a batch: one array holds them all."""
Positive = Annotated[FiniteFloat, Field(gt=0)]

FEATURES: dict[str, Features] = {"unrolled": "snapshots", "doa-cnn": "covariance"}
"""What a network sees where its configuration does not say; "adaptive" for the others."""
USED_WITH: dict[str, tuple[str, tuple[str, ...]]] = {
    "hidden": ("model", ("spectral-unet",)),
    "learned": ("model", ("unrolled",)),
    "detection": ("model", ("unrolled",)),
    "iterations": ("features", ("snapshots", "adaptive")),
    "exponent": ("features", ("snapshots", "adaptive")),
    "beta": ("target", ("paper",)),
    "threshold_db": ("target", ("class",)),
    "linear": ("target", ("row",)),
    "alpha": ("target", ("row", "paper")),
    "foreground": ("target", ("row", "paper", "class")),
}
"""Fields that make a difference only where another field has one of these values."""


class FitConfig(Described):
    """Network, features, target, loss and schedule of one run.

    :param model: network, see :mod:`trainer.networks`
    :param width: channels of the first level of its U-Net; of every convolution of the "doa-cnn"
    :param hidden: units of the spectral network's angular mixing
    :param features: input, see :mod:`shared.signal.features`
    :param iterations: of the spectrum among the "adaptive" features; of the "unrolled" network those without weights
    :param learned: iterations of the "unrolled" network with weights
    :param truth_window: over the virtual sensor's elements in the truth; that of the datasets
    :param detection: weight of the loss of the "unrolled" network's detection head; 0 for a network without one
    :param target: what the network is asked for, see :func:`trainer.run.imager.encode`
    :param exponent: compression of the "row" target's magnitudes
    :param beta: scale of the "paper" target (paper, section III-A)
    :param threshold_db: a pixel of the "class" target is a target down to this level below the image's peak [dB]
    :param alpha: weight of the L1 norm of the estimate (paper, Table 2)
    :param foreground: additional weight of a pixel of target value 1, against the empty background
    :param linear: weight of the normalised error of the linear image, for the "row" target
    :param batch: frames of one forward pass, on each device
    :param accumulate: batches of one optimiser step
    :param steps: optimiser steps of the whole run
    :param learning_rate: peak of the schedule, a warm-up followed by a half cosine; a fifth of the default where
        a run begins with the weights of another and none is stated
    :param weight_decay: of AdamW
    :param clip: largest norm of the gradient
    :param rows: range bins of a training crop, 0 for whole images; snapshots of one online sample of the "doa-cnn"
    :param augment: shift and mirror the training frames in angle
    :param points: crops of online point targets beside each training frame, see :mod:`trainer.training.online_points`
    :param told: share of the training frames of which the "unrolled" network is told the sensor's motion, the others
        being flat (:mod:`shared.signal.ego_motion`); if any are, it is told wherever the motion is known, else nowhere
    :param imperfections: of the boards that training frames and online points are seen by, or their name; None for
        ideal ones, see :mod:`trainer.training.imperfections`
    :param seed: of initial weights, data order, crops and augmentation
    :param precision: "bf16" computes the network in bfloat16 where the device can, weights stay float32
    :param validate_every: most optimiser steps from one validation to the next; the last is at the end, or where the
        steps do not divide fewer steps before it than there are validations
    :param patience: validations without improvement before an early stop, 0 for never
    :param frames: of each dataset, train and validate with the frames whose ``frame_id`` is below it; 0 for all
    """

    model: Model = "unrolled"
    width: Few = 12
    hidden: Few = 384
    features: Features = "snapshots"
    iterations: Few = 5
    learned: Annotated[int, Field(ge=0, le=64)] = 2
    truth_window: str = TRUTH_WINDOW
    detection: NotNegative = 0.25
    target: Target = "row"
    exponent: Annotated[FiniteFloat, Field(gt=0, le=1)] = 0.5
    beta: Positive = 10.0
    threshold_db: Positive = 30.0
    alpha: NotNegative = 0.0
    foreground: NotNegative = 1.0
    linear: NotNegative = 0.02
    batch: Few = 2
    accumulate: Count = 1
    steps: Count = 600
    learning_rate: Positive = 1e-3
    weight_decay: NotNegative = 1e-2
    clip: Positive = 1.0
    rows: Annotated[int, Field(ge=0, le=2**20)] = 160
    augment: bool = True
    points: Annotated[int, Field(ge=0, le=2**14)] = 1
    told: Share = 0.0
    imperfections: Given = None
    seed: Annotated[int, Field(ge=0, le=LARGEST_SEED)] = 0
    precision: Precision = "32"
    validate_every: Count = 200
    patience: Annotated[int, Field(ge=0, le=10**9)] = 0
    frames: Annotated[int, Field(ge=0, le=10**9)] = 0

    def uses(self, name: str) -> bool:
        """Whether a field makes a difference."""
        other, values = USED_WITH.get(name, ("model", (self.model,)))
        return getattr(self, other) in values

    @model_validator(mode="before")
    @classmethod
    def _features_of_the_model(cls, given: object) -> object:
        """Each network's own features, where none are stated."""
        if isinstance(given, dict) and "features" not in given and isinstance(given.get("model", "unrolled"), str):
            return {**given, "features": FEATURES.get(given.get("model", "unrolled"), "adaptive")}
        return given

    @model_validator(mode="after")
    def _parts_match(self) -> FitConfig:
        of_doa = [self.model == "doa-cnn", self.features == "covariance", self.target == "doa"]
        if any(of_doa) and not all(of_doa):
            raise ValueError("model 'doa-cnn', features 'covariance' and target 'doa' belong together")
        if all(of_doa) and self.points:
            raise ValueError(f"model 'doa-cnn' has samples of its own; got points = {self.points}, expected 0")
        if all(of_doa) and self.imperfections is not None:
            raise ValueError("model 'doa-cnn' is trained on ideal boards alone; expected imperfections 'none'")
        if (self.model == "unrolled") != (self.features == "snapshots"):
            raise ValueError(
                f"model 'unrolled' and features 'snapshots' belong together; got {self.model!r} and {self.features!r}"
            )
        if self.told and self.model != "unrolled":
            raise ValueError(f"model 'unrolled' alone is told the motion; got told = {self.told:g}, expected 0")
        if self.model == "unrolled" and self.target != "row":
            raise ValueError(f"model 'unrolled' answers target 'row'; got {self.target!r}")
        if self.truth_window not in ANGLE_WINDOWS:
            raise ValueError(f"truth_window = {self.truth_window!r}, expected one of {list(ANGLE_WINDOWS)}")
        if self.target == "row" and self.features not in ("snapshots", "adaptive"):
            raise ValueError(
                f"target 'row' needs the scale that features 'snapshots' and 'adaptive' take out; "
                f"got features {self.features!r}"
            )
        if self.target == "paper" and self.rows:
            raise ValueError(f"target 'paper' is normalised per whole image; got rows = {self.rows}, expected 0")
        return self
