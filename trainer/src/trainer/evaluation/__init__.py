"""``trainer evaluate``: experiments, their cells and worker processes, the report."""
