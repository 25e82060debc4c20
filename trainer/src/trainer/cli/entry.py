"""Where ``trainer`` begins: an interrupt is one line also while the command line itself is being loaded."""

from __future__ import annotations

import signal
import sys

INTERRUPTED = 130
"""Exit status after Ctrl-C or a request to end: 128 and the number of SIGINT."""


def main() -> None:
    """Run the command line; a request to end (SIGTERM) is answered like Ctrl-C, so that workers end with it."""
    try:
        signal.signal(signal.SIGTERM, signal.default_int_handler)
        from trainer.cli.app import main as run

        run()
    except KeyboardInterrupt:
        print("trainer: interrupted", file=sys.stderr)
        sys.exit(INTERRUPTED)
