"""Where shards may be made: constants alone, so that ``--help`` imports nothing that computes."""

LOCAL, RAY = "local", "ray"
ENGINES = (LOCAL, RAY)
