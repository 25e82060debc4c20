"""How captures are read, imported and calibrated with: see :mod:`shared.processes.declared`."""

from collections.abc import Sequence
from dataclasses import field
from numbers import Integral
from pathlib import Path
from typing import Annotated, Literal, get_args

from shared.physics.errors import InputError
from shared.processes.declared import Option, Options, either
from shared.processes.defaults import BOARD_NAMES
from shared.processes.telling import AnnouncingOptions

Order = Literal["iq", "qi"]
LAYOUTS = ("2-lane", "4-lane", "cascade")


Frames = tuple[int, int | None]
"""From the first to before the second, to the last where that is None."""


def _frames(text: str) -> Frames:
    begin, colon, end = text.partition(":")
    try:
        return int(begin or 0), None if colon and begin and not end else int(end)
    except ValueError:
        raise InputError("--frames", f"{text!r}", "BEGIN:END, e.g. 0:10") from None


# Not formatted: an option is read as a whole, in two or three lines.
# fmt: off
class BoardOptions(Options):
    board: Annotated[str, Option(f"{either(BOARD_NAMES)}.", choices=BOARD_NAMES)] = field(kw_only=False)


class Reading(BoardOptions):
    """How a capture is read."""

    radar: Annotated[Path | str | None, Option(
        "The capture's chirps: a radar file with a table 'capture', or a .cfg of the SDK.",
        "Without it those of the board's preset.", typed=str)] = None
    axes: Annotated[str | None, Option("Of an array, e.g. 'chirp (tx rx) sample'; guessed by its lengths.")] = None
    variable: Annotated[str | None, Option("Of several arrays in a file: its name.")] = None
    layout: Annotated[str | None, Option(
        f"Of a .bin: {either(LAYOUTS)}; the board's by default.", choices=LAYOUTS)] = None
    order: Annotated[Order | None, Option(
        "iq, or qi where Q comes first; that of the .cfg by default, iq without.", typed=str,
        choices=get_args(Order))] = None
    frames: Annotated[Frames | None, Option(
        "BEGIN:END, from the first to before the second; all by default.",
        "A pair of numbers, the second of them None for the last frame.", typed=str, read=_frames)] = None
    mirror: Annotated[bool, Option("Exchange left and right of the board.")] = False

    def __post_init__(self) -> None:
        super().__post_init__()
        given: object = self.frames
        pair = list(given) if isinstance(given, tuple | list) else []
        whole = all(isinstance(number, Integral) for number in pair[: 1 if pair[1:] == [None] else 2])
        if given is not None and not (len(pair) == 2 and whole):
            raise InputError("--frames", repr(given), "a pair of whole numbers, e.g. (0, 10)")


class CubeOptions(AnnouncingOptions, BoardOptions):
    capture: Annotated[Path, Option(
        "A .bin of a DCA1000, the folder of a cascade, .npy, .npz, .mat or HDF5.", flag=None)]
    out: Annotated[Path, Option("The cube, a .npz.")]
    calibration: Annotated[Path | None, Option(
        "Of trainer calibrate, or the cascade's calibrateResults.mat.")] = None


class ImportOptions(Reading, CubeOptions):
    """What is imported, and how it is read."""


class ReflectorOptions(AnnouncingOptions, BoardOptions):
    captures: Annotated["Sequence[Path | str]", Option(
        "Captures of a reflector, or a calibrateResults.mat.", typed=list[Path], flag=None, several=True)]
    ranges: Annotated["Sequence[float]", Option(
        "Of the reflector [m]; once for each capture.", typed=list[float], flag="--range", several=True)]
    angles: Annotated["Sequence[float]", Option(
        "Its azimuth [deg], positive to the left.", typed=list[float], flag="--angle", several=True)]
    out: Annotated[Path, Option("The calibration, a .toml.")]
    check: Annotated[Path | None, Option("Another capture: what the calibration leaves of it.")] = None
    check_range: Annotated[float | None, Option("Of its reflector [m].")] = None
    check_angle: Annotated[float | None, Option("Of its reflector [deg].")] = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if not len(self.captures) == len(self.ranges) == len(self.angles):
            told = f"{len(self.captures)} captures, {len(self.ranges)} --range and {len(self.angles)} --angle"
            raise InputError("arguments", told, "one --range and one --angle for each capture")
        if len({value is None for value in (self.check, self.check_range, self.check_angle)}) > 1:
            raise InputError("--check", "without all of the three", "--check, --check-range and --check-angle")


class CalibrateOptions(Reading, ReflectorOptions):
    """What is calibrated with, and how it is read."""
# fmt: on
