"""What training begins with: the configuration that ``--recipe`` and the device stand for, and the weights.

These are random ones, those of another run, or those that come with the package.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch

from shared.physics.errors import InputError, meant
from shared.radar import Radar, read_toml, validated
from trainer.data.arrays import ArrayChoice
from trainer.run.configuration import USED_WITH, FitConfig, first_difference
from trainer.run.folder import Run, load_imager, read_run
from trainer.run.imager import Imager, has_bfloat16, lay_out
from trainer.run.pretrained import pretrained_names, pretrained_run

Changes = Mapping[str, object]
"""Fields of :class:`trainer.run.configuration.FitConfig` that differ from its defaults."""

GPU: Changes = {
    "steps": 13_000, "rows": 0, "width": 24, "hidden": 768, "precision": "bf16", "validate_every": 500, "batch": 8,
}  # fmt: skip
"""What a GPU changes: whole images, a wider network, six epochs of the paper's 17 500 frames."""

RECIPES: dict[str, Changes] = {
    "recommended": {},
    # The recipe of the paper.
    "paper": {
        "model": "attention-unet", "features": "paper", "target": "paper", "width": 64, "rows": 0, "batch": 2,
        "accumulate": 4, "learning_rate": 1e-4, "foreground": 0.0, "augment": False, "points": 0,
    },
    # The direction-of-arrival network that the paper compares with, on online samples of 64 snapshots. Small batches
    # learn more in the same time: ``trainer fit DIR --array sparse4 --recipe doa --precision bf16``, one thread, takes
    # 120 s of the processor with ``--batch 8 --steps 200``, to a validation loss of 0.0289, and 150 s with
    # ``--batch 2 --steps 700``, to 0.0264.
    "doa": {
        "model": "doa-cnn", "features": "covariance", "target": "doa", "width": 256, "rows": 64, "batch": 2,
        "steps": 4000, "learning_rate": 1e-3, "weight_decay": 0.0, "augment": False, "points": 0,
    },
}  # fmt: skip
"""By the name that ``--recipe`` takes."""


def configuration(
    recipe: str = "recommended", given: Changes | None = None, config: FitConfig | Path | None = None
) -> FitConfig:
    """The configuration of a recipe on this machine's device.

    :param given: fields stated by the user, which count before the file's; those count before the recipe's, and the
        recipe's before the device's. None stands for a field that is not stated.
    :param config: TOML file with fields of :class:`trainer.run.configuration.FitConfig`, by their names; or a
        configuration, in place of recipe and device
    :raises InputError: an unknown recipe, a file that is no TOML, a field or value that no run has, a field that makes
        no difference to this network
    """
    if recipe not in RECIPES:
        *names, last = RECIPES
        raise InputError("--recipe", repr(recipe), f"{', '.join(names)} or {last}{meant(recipe, RECIPES)}")
    stated = {name: value for name, value in (given or {}).items() if value is not None}
    if isinstance(config, FitConfig):
        return validated(FitConfig, config.model_dump(exclude_unset=True) | stated, "trainer fit")
    if not isinstance(config, str | Path | None):
        raise InputError("config", repr(config), "a TOML file's path, or a FitConfig")
    from_file = {} if config is None else _fields_of(Path(config))
    source = "trainer fit" if config is None else f"trainer fit with {config}"
    device = GPU if torch.cuda.is_available() else {"precision": "bf16" if has_bfloat16() else "32"}
    found = validated(FitConfig, {**device, **RECIPES[recipe], **from_file, **stated}, source)
    for name in {**from_file, **stated}:
        value = getattr(found, name)
        # A file with every field of a run asks for nothing where it has a field's default.
        if not found.uses(name) and value != FitConfig.model_fields[name].default:
            other, values = USED_WITH[name]
            problem = f"{name} = {value!r} makes no difference with {other} {getattr(found, other)!r}"
            raise InputError(source, problem, f"no {name}, or {other} {' or '.join(map(repr, values))}")
    return found


def _fields_of(path: Path) -> Changes:
    """The entries of a TOML file, whose names are checked here: a slip of the pen is told with the field it is like."""
    fields = read_toml(path, "a TOML file in UTF-8, e.g. steps = 600")
    known = FitConfig.model_fields
    if unknown := [name for name in fields if name not in known]:
        raise InputError(path, f"unknown field {unknown[0]!r}", f"one of {', '.join(known)}{meant(unknown[0], known)}")
    return fields


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
    channels = len(array.line(radar))
    runs = {path: read_run(path) for path in map(pretrained_run, pretrained_names())}
    path = min(runs, key=lambda one: abs(len(runs[one].array.line(runs[one].radar)) - channels))
    if misfit := _misfit(runs[path], config, radar):
        return None, f"begins with random weights: those that come with the package have {misfit}"
    return path, f"begins with the weights that come with the package for {path.name}; --from none: with random ones"


def _misfit(run: Run, config: FitConfig, radar: Radar) -> str:
    """What of a shipped run is not as in this one; "" if its weights fit."""
    if differing := first_difference(run.config, config, filter(config.uses, (*NETWORK_FIELDS, "truth_window"))):
        name, theirs, asked = differing
        return f"{name} = {theirs!r}, not {asked!r}"
    if run.radar.grid != radar.grid:
        return "another angle grid"
    there, own = (one.virtual_sensor.virtual / one.waveform.wavelength_m for one in (run.radar, radar))
    if there.shape != own.shape or np.abs(there - own).max() > SAME_PLACES:
        return "another virtual sensor"
    return ""


def new_imager(config: FitConfig, radar: Radar, array: ArrayChoice) -> Imager:
    """With the random weights that the configuration's seed stands for."""
    torch.manual_seed(config.seed)
    imager = Imager(config, radar, array)
    lay_out(imager.network, torch.channels_last)
    return imager


def begin_with(imager: Imager, config: FitConfig, start: Path) -> float:
    """Give the new imager the weights of another run, zeros where that has no input for a prior; returns its gain.

    :raises InputError: no whole run, or another network
    """
    run, trained = load_imager(start)
    if differing := first_difference(run.config, config, filter(config.uses, NETWORK_FIELDS)):
        name, theirs, asked = differing
        raise InputError("--from", f"{start} has {name} = {theirs!r}", f"{asked!r}")
    try:
        # Only a prior's weights can be in one network and not in the other: they stay zeros, or nothing asks for them.
        imager.network.load_state_dict(trained.network.state_dict(), strict=False)
    except RuntimeError as error:  # of another array or grid, where a network knows them
        raise InputError("--from", f"{start} has weights of other shapes", "a run of this array and grid") from error
    return trained.gain
