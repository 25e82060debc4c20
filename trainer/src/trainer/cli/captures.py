"""``trainer import`` and ``trainer calibrate``."""

from __future__ import annotations

from shared.cli.console import plain_console
from shared.cli.options import asking
from trainer.captures.options import CalibrateOptions, ImportOptions


@asking(ImportOptions)
def import_(asked: ImportOptions) -> None:
    """The raw samples of a board as a cube that predict and evaluate read."""
    from trainer.captures.importing import import_capture

    import_capture(**{**vars(asked), "announce": plain_console().print})


@asking(CalibrateOptions)
def calibrate(asked: CalibrateOptions) -> None:
    """Gain, phase and delay of a board's channels from captures of a reflector whose place is known."""
    from trainer.captures.calibrating import calibrate as run_calibrate

    run_calibrate(**{**vars(asked), "announce": plain_console().print})
