"""``trainer import`` and ``trainer calibrate``."""

from __future__ import annotations

from shared.cli.options import asking
from trainer.captures.options import CalibrateOptions, ImportOptions


@asking(ImportOptions)
def import_(asked: ImportOptions) -> None:
    """The raw samples of a board as a cube that predict and evaluate read."""
    from trainer.captures.importing import import_capture

    import_capture(asked.capture, asked.out, asked, asked.calibration)


@asking(CalibrateOptions)
def calibrate(asked: CalibrateOptions) -> None:
    """Gain, phase and delay of a board's channels from captures of a reflector whose place is known."""
    from trainer.captures.calibrating import Place
    from trainer.captures.calibrating import calibrate as run_calibrate

    places = [Place(*place) for place in zip(asked.captures, asked.ranges, asked.angles, strict=True)]
    check = None
    if asked.check is not None and asked.check_range is not None and asked.check_angle is not None:
        check = Place(asked.check, asked.check_range, asked.check_angle)
    run_calibrate(places, asked.out, asked, check)
