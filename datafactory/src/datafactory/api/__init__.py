"""What a program may call: the functions that :mod:`datafactory` names, and that the commands call."""
