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
    from shared.radar import validated
    from trainer.evaluation.evaluate import evaluate as run_evaluate
    from trainer.evaluation.experiments.bench import EvaluationConfig
    from trainer.evaluation.experiments.measured_input import read_measured
    from trainer.run.pretrained import pretrained_run

    fields = {name: value for name, value in vars(asked).items() if name in EvaluationConfig.model_fields}
    fields["runs"] = (*asked.run, *map(pretrained_run, asked.pretrained))
    config = validated(EvaluationConfig, fields, "trainer evaluate")
    row = None
    if asked.measured is not None:
        row = read_measured(asked.measured, asked.targets, asked.range_m, asked.model_error)
    console = plain_console()
    with bars(console) as advance:
        run_evaluate(asked.dataset, asked.out, config, row, asked.resume, asked.workers, console.print, advance)
