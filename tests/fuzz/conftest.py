"""Files of arrays are read by forks of one process: thousands of damaged ones, where each starts Python anew otherwise.

Every file still has a process of its own, with the bounds and the exit status of the command's.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from trainer.captures import reading

FORKING = """
import json, os, sys, traceback
import h5py, numpy, scipy.io
from reading_process import main

for line in sys.stdin:
    *arguments, said = json.loads(line)
    child = os.fork()
    if not child:
        os.dup2(os.open(said, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), 2)
        status = 1
        try:
            status = main(*arguments)
        except BaseException:
            traceback.print_exc()
        finally:
            sys.stderr.flush()
            os._exit(status)
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
"""


@pytest.fixture(scope="module", autouse=True)
def forked_reader(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    said = tmp_path_factory.mktemp("reader") / "said"
    command = [sys.executable, "-c", FORKING]
    with (
        subprocess.Popen(
            command, cwd=Path(reading.READER).parent, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        ) as process,
        pytest.MonkeyPatch.context() as patch,
    ):
        asked, ended = process.stdin, process.stdout
        assert asked is not None
        assert ended is not None

        def run_reader(*arguments: str) -> tuple[int, bytes]:
            asked.write(json.dumps([*arguments, str(said)]) + "\n")
            asked.flush()
            return int(ended.readline()), said.read_bytes()

        patch.setattr(reading, "run_reader", run_reader)
        yield
        asked.close()
