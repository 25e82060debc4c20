"""Effects by name, and what switching one off means."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from datafactory.effects.catalogue import ALL, DESCRIPTIONS, NAMES, PATH_EFFECTS, EffectSet, parse_effects
from datafactory.frame.chain import ChainSettings
from datafactory.frame.measurement import Processing
from datafactory.paths.solver import TraceSettings
from shared.physics.errors import InputError
from shared.radar import FrontEnd

CONTRACT = (
    "specular", "diffuse", "multi_bounce", "refraction", "diffraction", "corners", "doppler",
    "range_migration", "intra_chirp_motion", "near_field", "antenna_pattern", "rcs_targets", "noise",
)  # fmt: skip
"""Names and order as users' scripts know them."""


def test_the_names_are_those_of_the_contract_in_its_order() -> None:
    assert NAMES == CONTRACT == tuple(DESCRIPTIONS)
    assert set(PATH_EFFECTS) < set(CONTRACT)


def test_effects_are_read_from_the_command_line() -> None:
    assert parse_effects("auto") is None
    assert parse_effects("all") == ALL
    assert parse_effects(" noise, specular ,diffuse,") == EffectSet.of({"specular", "diffuse", "noise"})
    assert EffectSet.of({"noise", "specular"}).names == ("specular", "noise")


@pytest.mark.parametrize("text", ["nonsense", "specular,nonsense", "Specular", "auto,noise", "all,noise", "a\nb"])
def test_a_name_that_does_not_exist_is_refused(text: str) -> None:
    with pytest.raises(InputError) as caught:
        parse_effects(text)
    wrong = next(name for name in text.split(",") if name not in NAMES)
    assert "--effects" in str(caught.value)
    assert repr(wrong) in str(caught.value)
    assert ",".join(CONTRACT) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", ["", " ", ",", " , ,"])
def test_no_effect_at_all_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="--effects"):
        parse_effects(text)


def test_one_effect_is_added_or_taken_away() -> None:
    few = EffectSet.of({"diffuse", "noise"})
    assert few.with_also("doppler").names == ("diffuse", "doppler", "noise")
    assert few.without("noise").names == ("diffuse",)
    assert few.with_also("noise") == few


def test_each_path_effect_sets_one_field_of_the_trace() -> None:
    settings = ChainSettings(trace=TraceSettings(rays=7, depth=3, polarization=("V", "H")))
    everything = ALL.settings(settings).trace
    assert everything == replace(settings.trace, refraction=True, diffraction=True, corners=True)
    for name in NAMES:
        left = ALL.without(name).settings(settings).trace
        fields: dict[str, dict[str, Any]] = {"multi_bounce": {"depth": 1}, "rcs_targets": {"point_targets": False}}
        expected = fields.get(name, {name: False} if name in PATH_EFFECTS else {})
        assert left == replace(everything, **expected), name


def test_what_the_user_left_out_of_the_trace_stays_out() -> None:
    settings = ChainSettings(trace=TraceSettings(depth=1, specular=False, diffuse=False))
    assert ALL.settings(settings).trace == replace(settings.trace, refraction=True, diffraction=True, corners=True)


def test_each_signal_effect_sets_one_field_of_the_processing() -> None:
    everything = ALL.settings(ChainSettings()).processing
    assert everything == replace(Processing(), intra_chirp_motion=True)
    for name in NAMES:
        expected: dict[str, Any] = {name: False} if name in ("doppler", "noise") else {}
        assert ALL.without(name).settings(ChainSettings()).processing == replace(everything, **expected), name
    assert not ALL.settings(ChainSettings(processing=Processing(noise=False))).processing.noise


def test_without_its_pattern_an_element_has_the_gain_of_boresight_everywhere() -> None:
    front_end, directions = FrontEnd(), np.array([[1.0, 0.0, 0.0], [1.0, 2.0, -0.5], [0.0, 0.0, -1.0]])
    assert ALL.settings(ChainSettings()).antenna_pattern
    assert not ALL.without("antenna_pattern").settings(ChainSettings()).antenna_pattern
    flat = front_end.with_boresight_gain()
    for before, after in ((front_end.tx_pattern, flat.tx_pattern), (front_end.rx_pattern, flat.rx_pattern)):
        assert after.power_gain(directions) == pytest.approx(np.full(3, before.power_gain(directions[0])), rel=1e-12)
        assert before.power_gain(directions[2]) < 1e-2 * after.power_gain(directions[2])
    assert flat.transmit_power_dbm == front_end.transmit_power_dbm
