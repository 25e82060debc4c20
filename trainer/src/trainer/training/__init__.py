"""``trainer fit``: batches, losses, one step, the run that is kept and its verdict."""
