"""Where ``datafactory`` begins."""

from functools import partial

from shared.processes.interrupt import begin

main = partial(begin, "datafactory")
