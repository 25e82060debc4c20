"""What is imaged, by what, and what is written: see :mod:`shared.processes.declared`."""

import math
from collections.abc import Sequence
from dataclasses import field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from shared.physics.errors import InputError
from shared.processes.declared import Option, Options, common, either
from shared.processes.telling import AnnouncingOptions
from trainer.defaults import CELLS, ESTIMATOR_NAMES, FALSE_ALARMS, FORMATS, LEAST_FALSE_ALARMS, PEAKS
from trainer.run.pretrained import pretrained_names, pretrained_run, require_run

if TYPE_CHECKING:
    from shared.dataset.locations import Location


def _velocity(text: str) -> tuple[float, float]:
    try:
        forward, left = (float(part) for part in text.split(","))
    except ValueError:
        raise InputError("--velocity", repr(text), "two numbers [m/s], e.g. 8.3,0") from None
    return forward, left


# Not formatted: an option is read as a whole, in two or three lines.
# fmt: off
class ImageOptions(Options):
    paths: Annotated["Sequence[Location | str]", Option(
        "Run folder of trainer fit, unless --pretrained or --method; then a dataset, also s3://, hf:// or https://, "
        "or a cube as .npy or .npz.", typed=list[str], place="[RUN] INPUT", flag=None,
        several=True)] = field(kw_only=False)
    out: Annotated[Path, Option("Folder of the images; new or empty.")] = field(kw_only=False)
    pretrained: Annotated[str | None, Option(
        f"A network that comes with the package, in place of RUN: {either(pretrained_names())}.",
        choices=pretrained_names())] = None
    method: Annotated[str | None, Option(
        f"A classical estimator in place of a network, for any array: {either(ESTIMATOR_NAMES)}.",
        choices=ESTIMATOR_NAMES)] = None
    radar: Annotated[str | None, Option("Radar of a .npy cube: a preset or a TOML file.")] = None
    split: Annotated[str | None, Option("Of a dataset: train, validation, test or all; test by default.")] = None
    pictures: Annotated[bool, Option("A PNG for each frame.", "With DaS beside it.")] = True
    points: Annotated[bool, Option("Also the targets as a list: a column 'detections', the strongest first.")] = False
    points_format: Annotated[str, Option(
        "Of the list: parquet, the column alone; csv or pcd, files for other tools as well.",
        choices=FORMATS)] = FORMATS[0]


class PointsRequest(Options):
    """Which points are listed."""

    false_alarms: Annotated[float, Option(
        "Of the list: expected lines of a frame of noise alone.")] = FALSE_ALARMS
    cells: Annotated[str, Option(
        "Of the list: peaks, three of a range bin; all, of a cube, what passes OS-CFAR.", choices=CELLS)] = PEAKS

    def __post_init__(self) -> None:
        super().__post_init__()
        if not LEAST_FALSE_ALARMS <= self.false_alarms < math.inf:
            expected = f"a finite number of at least {LEAST_FALSE_ALARMS:g}, of lines a frame"
            raise InputError("--false-alarms", f"{self.false_alarms}", expected)


class PredictRequest(AnnouncingOptions, PointsRequest, ImageOptions):
    """Which frames are imaged, by what, and what is written."""

    animation: Annotated[bool, Option(
        "Also animation.gif: images and detections, frame by frame; with --points.")] = False
    velocity: Annotated[tuple[float, float] | None, Option(
        "Of the vehicle at the radar, forward and to the left [m/s]; by default what the data say, else what a frame "
        "shows. For likes-view-ego, and for 'moving' of --points.", typed=str, metavar="VX,VY", read=_velocity)] = None
    mounting_yaw_deg: Annotated[float, Option(
        "By how much the radar is turned to the left on the vehicle [degree].", flag="--mounting-yaw")] = 0.0

    @property
    def source(self) -> "Location | str":
        """The dataset or cube."""
        return self.paths[-1]

    @property
    def run(self) -> Path | None:
        """Folder of the network; None with a method."""
        if self.method is not None:
            return None
        return Path(str(self.paths[0])) if self.pretrained is None else pretrained_run(self.pretrained)

    @property
    def listed(self) -> PointsRequest:
        """Which points, where any are listed."""
        return common(PointsRequest, self)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.pretrained and self.method:
            raise InputError("--method", f"{self.method!r} beside --pretrained {self.pretrained}", "one of both")
        if len(self.paths) != (1 if self.pretrained or self.method else 2):
            expected = "INPUT alone with --pretrained or --method, else RUN INPUT"
            raise InputError("arguments", f"{len(self.paths)} paths", expected)
        if self.run is not None:
            require_run(self.run)
        if self.points_format != "parquet" and not self.points:
            raise InputError("--points-format", f"{self.points_format!r} without --points", "--points beside it")
        if self.listed != PointsRequest() and not self.points:
            raise InputError("--cells, --false-alarms", "without --points", "--points beside them")
        if self.animation and not self.points:
            raise InputError("--animation", "without --points", "--points beside it")
        if not all(map(math.isfinite, (*(self.velocity or ()), self.mounting_yaw_deg))):
            raise InputError("--velocity", f"{self.velocity}, yaw {self.mounting_yaw_deg}", "finite numbers")
        if self.mounting_yaw_deg and self.velocity is None:
            raise InputError("--mounting-yaw", "without --velocity", "--velocity beside it")


class ExportOptions(Options):
    """Which network is written where."""

    run: Annotated[Path, Option(
        f"Run folder of trainer fit, or a network that comes with the package: {either(pretrained_names())}.",
        flag=None)] = field(kw_only=False)
    out: Annotated[Path, Option("File to write, ending in .onnx.")] = field(kw_only=False)
# fmt: on
