"""A small radar, frames of a tiny scene, and one small sweep that several tests look at."""

from __future__ import annotations

from dataclasses import replace

import pytest
from sampled_frames import EFFECTS, POSE, samples_at

from datafactory.accuracy.knobs import DEFAULT, Knob
from datafactory.accuracy.power import Effort
from datafactory.accuracy.row import Row
from datafactory.accuracy.samples import SampleFrame
from datafactory.accuracy.sweep import sweep
from shared.radar import ImageGrid, Radar
from shared.radar.waveform import Waveform


@pytest.fixture(scope="session")
def radar() -> Radar:
    """All 256 elements, because the range walk is over them, and no echo that folds; short in everything else."""
    return Radar(name="small", waveform=Waveform(samples=512, chirps=8, range_bins=96), grid=ImageGrid(bins=48))


@pytest.fixture(scope="session")
def samples(variant: str, radar: Radar) -> list[SampleFrame]:
    return samples_at(radar, POSE)


@pytest.fixture(scope="session")
def rows(samples, radar) -> list[Row]:
    signal = (
        Knob("tolerance", (1e-3, 1e-6, 1e-9)),
        Knob("width", ("float32 geometry",)),
        Knob("prune_db", (-20.0, -40.0)),
        Knob("delays", ("linear",)),
        Knob("truth_terms", (3, 6)),
        Knob("truth_wave", ("plane",)),
    )
    power = (
        Knob("rays", (500, 4000), power=True, paired=False),
        Knob("rays", (16_000,), power=True, paired=False, beside=("lattice", "sphere"), label="sphere rays"),
        Knob("depth", (1,), power=True),
        Knob("surface_phase", (False,), power=True),
        Knob("diffuse", (False,), power=True),
        Knob("diffraction", (True,), power=True),
    )
    effort = Effort(20_000, realisations=2, reference_realisations=2, repeats=2, batch=1, rays=4000)
    return sweep(samples, signal, power, effort, radar, usual=replace(DEFAULT, effects=EFFECTS))
