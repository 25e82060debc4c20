"""The page that tells the road names the steps that the code takes."""

from __future__ import annotations

import re

from manual import DOCS, ROOT

FRAME = ROOT / "datafactory/src/datafactory/frame"
AROUND = {"deal", "shard"}
"""Of the chain as the page has it: what stands before and behind the steps that a hook sees."""


def test_the_chain_of_a_frame_has_the_steps_that_a_hook_sees() -> None:
    page = (DOCS / "architecture.md").read_text(encoding="utf-8")
    (chain,) = re.findall(r"^    deal -> .*?\n\n", page, re.MULTILINE | re.DOTALL)
    told = [step.strip() for step in " ".join(chain.split()).split("->")]
    code = "".join((FRAME / name).read_text(encoding="utf-8") for name in ("chain.py", "measurement.py"))
    taken = set(re.findall(r'\bat\(\s*"([^"]+)"', code)) - {"read"}
    assert set(told) - AROUND == taken
