"""The evidence for a plan: what a scene and a radar lack, what is measured."""

from __future__ import annotations

import pytest
from prepared_scenes import a_sample

from datafactory.effects.catalogue import NAMES
from datafactory.effects.evidence import FLOOR_DB, Evidence, gather
from datafactory.effects.plan import decide
from datafactory.frame.chain import ChainSettings
from datafactory.frame.prepared import Sample
from datafactory.scenes.poses import Pose
from shared.radar import FrontEnd, Radar
from shared.radar.antenna import IsotropicPattern
from shared.radar.waveform import Waveform


def gathered(*poses: Pose, **radar: object) -> dict[str, Evidence]:
    """On one point target at 80 m, seen from these poses."""
    return gather(a_sample("target_80m", *poses), Radar(**radar), ChainSettings()).evidence


def test_the_evidence_says_what_a_scene_lacks(variant: str) -> None:
    found = gathered()
    assert tuple(found) == NAMES
    for name in ("specular", "diffuse", "multi_bounce"):
        assert found[name] == Evidence(FLOOR_DB, "there is no surface")
    for name in ("doppler", "range_migration", "intra_chirp_motion"):
        assert found[name].text.startswith("nothing moves")
    assert found["diffraction"].text == "there is no edge"
    assert found["refraction"].change_db == FLOOR_DB
    assert found["rcs_targets"].change_db == pytest.approx(0.0, abs=1e-9)
    assert found["rcs_targets"].power_share == found["rcs_targets"].cell_share == 1.0
    assert gathered() == found


def test_the_evidence_is_of_the_radar_too(variant: str) -> None:
    isotropic = FrontEnd(tx_pattern=IsotropicPattern(), rx_pattern=IsotropicPattern())
    driving = Pose((0.0, 0.0, 0.5), velocity=(5.0, 0.0, 0.0))
    found = gathered(driving, front_end=isotropic, waveform=Waveform(chirps=1))
    assert found["antenna_pattern"].text == "the radar's elements are isotropic"
    assert found["doppler"].text == found["range_migration"].text == "the frame has one chirp"
    assert found["intra_chirp_motion"].change_db > -40.0


def test_a_scene_without_a_frame_is_not_judged() -> None:
    sample = a_sample("target_80m")
    found = gather(Sample(sample.scene, ()), Radar(), ChainSettings()).evidence
    assert {item.text for item in found.values()} == {"no frame of the run stands in this scene"}
    assert decide("scene", found).effects.names == ()
