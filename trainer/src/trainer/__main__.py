"""``python -m trainer``, for a machine where the script is not on the path."""

from trainer.cli.entry import main

main()
