"""Run the catalogue of hard cases and print it as a table; docs/notes/hardcases.md has the worst of each.

    python tests/hardcases/run.py [-k WORD]

Options are pytest's. Exit status 1 if any bound is broken. A case that hangs ends the run with a traceback.
"""

import sys
from pathlib import Path

import pytest

HANG_SECONDS = 300
"""No case takes a twentieth of it, compilation included."""


class Table:
    """Prints the rows of the cases that were measured."""

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        terminalreporter.write_line("| case | hazard | bound | measured |\n|---|---|---|---|")
        for report in (*terminalreporter.getreports("passed"), *terminalreporter.getreports("failed")):
            for _, row in report.user_properties if report.when == "call" else ():
                terminalreporter.write_line(row)


if __name__ == "__main__":
    hang = (f"faulthandler_timeout={HANG_SECONDS}", "faulthandler_exit_on_timeout=true")
    options = ["-q", "-k", "test_hard_case", *(word for option in hang for word in ("-o", option)), *sys.argv[1:]]
    sys.exit(pytest.main([str(Path(__file__).parent), *options], [Table()]))
