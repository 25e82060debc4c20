"""``trainer import`` and ``trainer calibrate``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from shared.physics.errors import InputError

Board = Annotated[str, typer.Option(help="iwr1443, iwr1642, iwr1843, awr2944, mmwcas or mmwcas-azimuth.")]
RadarFile = Annotated[
    str | None, typer.Option(help="The capture's chirps: a radar file with a table 'capture', or a .cfg of the SDK.")
]
Axes = Annotated[str | None, typer.Option(help="Of an array, e.g. 'chirp (tx rx) sample'; guessed by its lengths.")]
Variable = Annotated[str | None, typer.Option(help="Of several arrays in a file: its name.")]
Layout = Annotated[str | None, typer.Option(help="Of a .bin: 2-lane, 4-lane or cascade; the board's by default.")]
SampleOrder = Annotated[str, typer.Option(help="iq, or qi where Q comes first.")]
Frames = Annotated[str | None, typer.Option(help="BEGIN:END, from the first to before the second; all by default.")]
Mirror = Annotated[bool, typer.Option("--mirror", help="Exchange left and right of the board.")]


def import_(
    capture: Annotated[
        Path, typer.Argument(help="A .bin of a DCA1000, the folder of a cascade, .npy, .npz, .mat or HDF5.")
    ],
    board: Board,
    out: Annotated[Path, typer.Option(help="The cube, a .npz.")],
    radar: RadarFile = None,
    calibration: Annotated[
        Path | None, typer.Option(help="Of trainer calibrate, or the cascade's calibrateResults.mat.")
    ] = None,
    axes: Axes = None,
    variable: Variable = None,
    layout: Layout = None,
    order: SampleOrder = "iq",
    frames: Frames = None,
    mirror: Mirror = False,
) -> None:
    """The raw samples of a board as a cube that predict and evaluate read."""
    from trainer.captures.importing import import_capture
    from trainer.captures.samples import Reading

    reading = Reading(board, radar, axes, variable, layout, _order(order), _frames(frames), mirror)
    import_capture(capture, out, reading, calibration)


def calibrate(
    captures: Annotated[list[Path], typer.Argument(help="Captures of a reflector, or a calibrateResults.mat.")],
    board: Board,
    ranges: Annotated[list[float], typer.Option("--range", help="Of the reflector [m]; once for each capture.")],
    angles: Annotated[list[float], typer.Option("--angle", help="Its azimuth [deg], positive to the left.")],
    out: Annotated[Path, typer.Option(help="The calibration, a .toml.")],
    check: Annotated[Path | None, typer.Option(help="Another capture: what the calibration leaves of it.")] = None,
    check_range: Annotated[float | None, typer.Option(help="Of its reflector [m].")] = None,
    check_angle: Annotated[float | None, typer.Option(help="Of its reflector [deg].")] = None,
    radar: RadarFile = None,
    axes: Axes = None,
    variable: Variable = None,
    layout: Layout = None,
    order: SampleOrder = "iq",
    frames: Frames = None,
    mirror: Mirror = False,
) -> None:
    """Gain, phase and delay of a board's channels from captures of a reflector whose place is known."""
    from trainer.captures.calibrating import Place
    from trainer.captures.calibrating import calibrate as run_calibrate
    from trainer.captures.samples import Reading

    if not len(captures) == len(ranges) == len(angles):
        told = f"{len(captures)} captures, {len(ranges)} --range and {len(angles)} --angle"
        raise InputError("arguments", told, "one --range and one --angle for each capture")
    places = [Place(*place) for place in zip(captures, ranges, angles, strict=True)]
    checked = None
    if check is not None or check_range is not None or check_angle is not None:
        if check is None or check_range is None or check_angle is None:
            raise InputError("--check", "without all of the three", "--check, --check-range and --check-angle")
        checked = Place(check, check_range, check_angle)
    reading = Reading(board, radar, axes, variable, layout, _order(order), _frames(frames), mirror)
    run_calibrate(places, out, reading, checked)


def _order(text: str) -> Literal["iq", "qi"]:
    if text not in ("iq", "qi"):
        raise InputError("--order", f"{text!r}", "iq or qi")
    return "iq" if text == "iq" else "qi"


def _frames(text: str | None) -> tuple[int, int] | None:
    if text is None:
        return None
    begin, _, end = text.partition(":")
    try:
        return int(begin or 0), int(end)
    except ValueError:
        raise InputError("--frames", f"{text!r}", "BEGIN:END, e.g. 0:10") from None
