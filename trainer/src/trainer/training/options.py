"""What is trained on what, and where it is kept: see :mod:`shared.processes.declared`."""

from collections.abc import Sequence
from dataclasses import field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_args

from shared.processes.declared import Option, either
from shared.processes.defaults import LARGEST_SEED
from shared.processes.telling import AnnouncingOptions
from trainer.defaults import LOGGERS, TENSORBOARD, Features, Model, Precision, Target
from trainer.run.pretrained import pretrained_names, run_or_pretrained

if TYPE_CHECKING:
    from shared.dataset.locations import Location
    from trainer.run.configuration import FitConfig

SHIPPED = "shipped"
"""In place of a start: the weights that come with the package where they fit, else random ones."""
NO_START = "none"
"""In place of a run to begin with. A run folder of this name is ./none."""


def start_of(named: Path | str | None) -> Path | None:
    """The run to begin with; None for random weights."""
    return None if named in (None, NO_START) else run_or_pretrained(Path(str(named)))


def _by_recipe(meaning: str, **others: Any) -> Option:
    """A field of the configuration that recipe and device state where the user does not."""
    return Option(meaning, otherwise="by recipe and device", **others)


# Not formatted: an option is read as a whole, in two or three lines.
# fmt: off
class FitRequest(AnnouncingOptions):
    """What is trained on what, and where it is kept.

    Options named as a field of :class:`trainer.run.configuration.FitConfig` state that field.
    """

    datasets: Annotated["Sequence[Location | str]", Option(
        "Folders of datasets of one radar; also s3://, gs://, hf:// and https://.",
        "The doa-cnn takes only the radar from them.",
        typed=list[str], flag=None, several=True)] = field(kw_only=False)
    out: Annotated[Path, Option("Run folder; new or empty.")] = field(kw_only=False)
    array: Annotated[str, Option("full, sparse6, sparse4 or a TOML file with rx = [...].")] = "sparse6"
    recipe: Annotated[str, Option("recommended, paper (its network, features, target), or doa.")] = "recommended"
    config: Annotated["FitConfig | Path | None", Option(
        "TOML file of a run's fields, e.g. steps = 600; options count before it.",
        "Or a configuration, in place of recipe and device.", typed=Path)] = None
    model: Annotated[str | None, _by_recipe(f"{either(get_args(Model))}.")] = None
    features: Annotated[str | None, _by_recipe(f"{either(get_args(Features))}.")] = None
    target: Annotated[str | None, _by_recipe(f"{either(get_args(Target))}.")] = None
    width: Annotated[int | None, _by_recipe("Channels of the network's first level.")] = None
    hidden: Annotated[int | None, _by_recipe("Units of the spectral network's angular mixing.")] = None
    steps: Annotated[int | None, _by_recipe("Optimiser steps.")] = None
    batch: Annotated[int | None, _by_recipe("Frames of one forward pass.")] = None
    accumulate: Annotated[int | None, _by_recipe("Batches of one optimiser step.")] = None
    points: Annotated[int | None, _by_recipe("Crops of online point targets beside each frame.")] = None
    imperfections: Annotated[str | None, _by_recipe(
        "Of the boards that see the training data: none, calibrated or uncalibrated.")] = None
    rows: Annotated[int | None, _by_recipe("Range bins of a training crop; 0: whole images.")] = None
    learning_rate: Annotated[float | None, _by_recipe("Peak learning rate.")] = None
    precision: Annotated[str | None, _by_recipe(f"{either(get_args(Precision))}.")] = None
    validate_every: Annotated[int | None, _by_recipe("Steps from one validation to the next.")] = None
    patience: Annotated[int | None, _by_recipe("Validations without gain before stopping; 0: never.")] = None
    frames: Annotated[int | None, Option(
        "Train and validate with the first N frames of each dataset; 0: all.", otherwise="0")] = None
    start: Annotated[Path | str | None, Option(
        "Begin with the weights of this run, of a network that comes with the package, or with random ones.",
        f"Also None for random ones; {SHIPPED!r}: those that come with the package where they fit.",
        typed=str, flag="--from", metavar="|".join(("RUN", *pretrained_names(), NO_START)), read=start_of,
        otherwise="the shipped weights where they fit")] = SHIPPED
    seed: Annotated[int | None, Option(
        "Same seed, same weights on one device.", least=0, most=LARGEST_SEED, otherwise="0")] = None
    weights: Annotated["Sequence[float] | None", Option(
        "Share of each dataset, in their order.", typed=list[float], flag="--weight")] = None
    workers: Annotated[int, Option("Reading processes beside the training one.", least=0)] = 0
    devices: Annotated[int, Option("GPUs, or processes on a CPU; torchrun says it by itself.", least=1)] = 1
    check: Annotated[bool, Option("Hash every shard first.")] = True
    logger: Annotated[str, Option(f"Of the curves: {either(LOGGERS)}.", choices=LOGGERS)] = TENSORBOARD
    resume: Annotated[bool, Option("Go on with the run in --out.", "At the batch after its last checkpoint.")] = False
# fmt: on
