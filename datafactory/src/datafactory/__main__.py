"""``python -m datafactory``, for a machine where the script is not on the path."""

from datafactory.cli.entry import main

main()
