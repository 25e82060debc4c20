"""The pages of notebooks: cells, what they print and draw; run once, and again only if the script changes."""

from __future__ import annotations

from pathlib import Path

import pytest
from notebooks import page_of, run

SCRIPT = """# %% [markdown]
# # A title
#
# Some words.

# %%
from __future__ import annotations

import os
from pathlib import Path

out = Path(os.environ["EXAMPLES_OUT"]) / "small"
out.mkdir(parents=True)
with (out.parent / "runs.txt").open("a") as file:
    file.write("run\\n")


# %%
def later(value: Undefined) -> None: ...


(out / "dot.png").write_bytes(b"a picture")
print("printed")
"""


@pytest.fixture
def script(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("EXAMPLES_OUT", str(tmp_path / "out"))
    path = tmp_path / "small.py"
    path.write_text(SCRIPT, encoding="utf-8")
    return path


def test_a_page_has_text_code_output_and_pictures_of_the_script_as_it_was_run(script: Path, tmp_path: Path) -> None:
    kept = tmp_path / "kept"
    run(script, kept)
    run(script, kept)
    assert (tmp_path / "out" / "runs.txt").read_text() == "run\n"
    page, pictures = page_of(script, kept)
    assert page.startswith("# A title\n\n*`examples/small.py` with its output")
    assert page.endswith("```text\nprinted\n```\n\n![dot](small/dot.png)\n")
    assert [picture.read_bytes() for picture in pictures] == [b"a picture"]
    script.write_text(SCRIPT.replace("printed", "another"), encoding="utf-8")
    page, pictures = page_of(script, kept)
    assert "which was not run" in page
    assert ("```text" in page, pictures) == (False, [])
    run(script, kept)
    assert "```text\nanother\n```" in page_of(script, kept)[0]


def test_a_script_that_fails_leaves_no_page(script: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    script.write_text(SCRIPT + "raise ValueError('no')\n", encoding="utf-8")
    with pytest.raises(RuntimeError, match=r"small\.py failed"):
        run(script, tmp_path / "kept")
    line = SCRIPT.count("\n") + 1
    assert f'small.py", line {line}' in capfd.readouterr().err
    assert "which was not run" in page_of(script, tmp_path / "kept")[0]
