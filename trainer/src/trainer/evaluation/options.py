"""Who is compared by what, and how much is computed: see :mod:`shared.processes.declared`."""

from collections.abc import Sequence
from dataclasses import field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from shared.physics.errors import InputError
from shared.processes.declared import Option, Options, either
from shared.processes.defaults import LARGEST_SEED
from shared.processes.telling import TellingOptions
from trainer.defaults import (
    DEFAULT_ARRAYS,
    DEFAULT_METHODS,
    ESTIMATOR_NAMES,
    EXPERIMENT_NAMES,
    NETWORKS,
    OF_MEASURED_ROWS,
)
from trainer.run.pretrained import pretrained_names, pretrained_run, require_run

if TYPE_CHECKING:
    from shared.dataset.locations import Location


def _names(text: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in text.split(",") if name.strip())


# Not formatted: an option is read as a whole, in two or three lines.
# fmt: off
class FolderOptions(Options):
    dataset: Annotated["Location | str | None", Option(
        "Folder of a dataset with a test split, also s3://, hf:// or https://; none for --measured alone.",
        typed=str, flag=None)] = field(default=None, kw_only=False)
    out: Annotated[Path, Option("Folder of the evaluation; new or empty.")]


class EvaluationConfig(Options):
    """Who is compared by what, and how much is computed."""

    run: Annotated["Sequence[Path | str]", Option(
        "Run folder of trainer fit; repeatable.", typed=list[Path], several=True)] = ()
    pretrained: Annotated["Sequence[str]", Option(
        f"A network that comes with the package: {either(pretrained_names())}; repeatable.", typed=list[str],
        several=True)] = ()
    methods: Annotated["Sequence[str] | None", Option(
        f"Comma-separated: {', '.join(ESTIMATOR_NAMES)}; of a measured row also {' and '.join(OF_MEASURED_ROWS)}; "
        f"{' and '.join(NETWORKS)} stand for the runs. By default {', '.join(DEFAULT_METHODS)} and all runs, of a "
        "measured row all.", typed=str, read=_names, several=True)] = None
    arrays: Annotated["Sequence[str]", Option(
        "Comma-separated: names, or TOML files.",
        typed=str, read=_names, usual=",".join(DEFAULT_ARRAYS), several=True)] = DEFAULT_ARRAYS
    experiments: Annotated["Sequence[str] | None", Option(
        f"Comma-separated: {', '.join(EXPERIMENT_NAMES)}. By default all that apply.", typed=str, read=_names,
        several=True)] = None
    frames: Annotated[int, Option(
        "Most test frames of each kind that are scored.", least=1, most=10**6)] = 50
    shown: Annotated[int, Option("Frames to look at in the report.", least=1, most=1000)] = 3
    trials: Annotated[int, Option("Simulated trials of each condition.", least=2, most=10**5)] = 120
    seed: Annotated[int, Option("Same seed, same numbers.", least=0, most=LARGEST_SEED)] = 0

    @property
    def runs(self) -> tuple[Path, ...]:
        """Run folders of trainer fit, each evaluated on its own array."""
        return (*map(Path, self.run), *map(pretrained_run, self.pretrained))

    def __post_init__(self) -> None:
        super().__post_init__()
        for run in self.run:
            require_run(Path(run))


class EvaluateOptions(TellingOptions, EvaluationConfig, FolderOptions):
    """What is evaluated, and where."""

    measured: Annotated[Path | None, Option(
        "A measured snapshot of a half-wavelength line, .mat or .npy, or a cube of trainer import.")] = None
    targets: Annotated[int | None, Option("Targets in the measured row, where their number is known.")] = None
    range_m: Annotated[float | None, Option(
        "Of the row of a measured cube [m]; the strongest one.", flag="--range")] = None
    model_error: Annotated[float | None, Option(
        "Of the measured channels after calibration [dB of the row's power]; the cube's own, or -25.")] = None
    workers: Annotated[int, Option(
        "Processes that compute; 0: one a core. The numbers do not depend on it.", least=0, there=0)] = 1
    resume: Annotated[bool, Option("Keep what is finished in --out.")] = False

    def __post_init__(self) -> None:
        super().__post_init__()
        of_row = {"--targets": self.targets, "--range": self.range_m, "--model-error": self.model_error}
        for flag, value in of_row.items():
            if value is not None and self.measured is None:
                raise InputError(flag, f"{value:g} without --measured", "--measured beside it")
# fmt: on
