"""Where ``trainer`` begins."""

from functools import partial

from shared.cli.entry import begin

main = partial(begin, "trainer")
