"""What training begins with: random weights, those of another run, or those that come with the package."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from shared.physics.errors import InputError
from shared.radar import Radar
from trainer.data.arrays import ArrayChoice
from trainer.run.configuration import FitConfig
from trainer.run.folder import Run, load_imager, read_run
from trainer.run.imager import Imager
from trainer.run.pretrained import pretrained_names, pretrained_run

SHIPPED = "shipped"
"""In place of a start: the weights that come with the package where they fit, else random ones."""
NETWORK_FIELDS = (
    "model", "width", "hidden", "features", "iterations", "learned", "detection", "target", "exponent",
)  # fmt: skip
"""What the weights of a run mean depends on these."""
SAME_PLACES = 0.05
"""Elements of two virtual sensors whose places differ by less are the same [wavelengths]: those of the presets, 128
wavelengths wide, differ by 0.01."""


def shipped_start(config: FitConfig, radar: Radar, array: ArrayChoice) -> tuple[Path | None, str]:
    """(the shipped run to begin with, None for random weights; a line that says which, and why).

    No weight knows the array: of the shipped runs it is the one with the nearest number of channels.
    """
    channels = len(array.channels(radar))
    runs = {path: read_run(path) for path in map(pretrained_run, pretrained_names())}
    path = min(runs, key=lambda one: abs(len(runs[one].array.channels(runs[one].radar)) - channels))
    if misfit := _misfit(runs[path], config, radar):
        return None, f"begins with random weights: those that come with the package have {misfit}"
    return path, f"begins with the weights that come with the package for {path.name}; --from none: with random ones"


def _misfit(run: Run, config: FitConfig, radar: Radar) -> str:
    """What of a shipped run is not as in this one; "" if its weights fit."""
    for name in (*NETWORK_FIELDS, "truth_window"):
        theirs, asked = getattr(run.config, name), getattr(config, name)
        if theirs != asked:
            return f"{name} = {theirs!r}, not {asked!r}"
    if run.radar.grid != radar.grid:
        return "another angle grid"
    theirs, own = (one.virtual_sensor.virtual / one.waveform.wavelength_m for one in (run.radar, radar))
    if theirs.shape != own.shape or np.abs(theirs - own).max() > SAME_PLACES:
        return "another virtual sensor"
    return ""


def begin_with(imager: Imager, config: FitConfig, start: Path) -> float:
    """Give the new imager the weights of another run, zeros where that has no input for a prior; returns its gain.

    :raises InputError: no whole run, or another network
    """
    run, trained = load_imager(start)
    for name in NETWORK_FIELDS:
        if getattr(run.config, name) != getattr(config, name):
            raise InputError(
                "--from", f"{start} has {name} = {getattr(run.config, name)!r}", f"{getattr(config, name)!r}"
            )
    try:
        # Only a prior's weights can be in one network and not in the other: they stay zeros, or nothing asks for them.
        imager.network.load_state_dict(trained.network.state_dict(), strict=False)
    except RuntimeError as error:  # of another array or grid, where a network knows them
        raise InputError("--from", f"{start} has weights of other shapes", "a run of this array and grid") from error
    return trained.gain
