"""``trainer evaluate``."""

from __future__ import annotations

from shared.cli.console import plain_console
from shared.cli.options import asking
from trainer.evaluation.options import EvaluateOptions


@asking(EvaluateOptions)
def evaluate(asked: EvaluateOptions) -> None:
    """Hold runs and classical estimators against each other: metrics, figures, and a page to look at."""
    # torch and matplotlib take seconds to import, and trainer --help should not.
    from shared.cli.progress import bars
    from trainer.evaluation.evaluate import evaluate as run_evaluate

    console = plain_console()
    with bars(console) as advance:
        run_evaluate(**{**vars(asked), "announce": console.print, "progress": advance})
