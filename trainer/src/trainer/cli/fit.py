"""``trainer fit``."""

from __future__ import annotations

import shlex

from shared.cli.console import plain_console
from shared.cli.options import asking
from trainer.training.options import FitRequest


@asking(FitRequest)
def fit(asked: FitRequest) -> None:
    """Train a network on datasets of the factory."""
    # Lightning takes seconds to import, and trainer --help should not.
    from shared.dataset.locations import locate
    from trainer.training.fit import fit as run_fit
    from trainer.training.processes import is_first

    announce = plain_console().print
    run_fit(**{**vars(asked), "announce": announce})
    if not is_first():
        return
    # The located name is shown: a URI as given may hold a key.
    data, run = shlex.quote(str(locate(asked.datasets[0]))), shlex.quote(str(asked.out))
    announce(f"run in {asked.out}; curves: tensorboard --logdir {run}; next: trainer predict {run} {data} --out DIR")
