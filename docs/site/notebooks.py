"""The notebooks among the examples as pages: their cells, what these print, the pictures that they write.

``python docs/site/notebooks.py tour`` runs a notebook, ``all`` every one. What came of it is kept in build/notebooks
under the hash of the script, and is not made again before the script changes. The site shows what is kept, and of a
notebook that was not run the cells alone.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import io
import os
import shutil
import sys
from collections.abc import Iterator
from multiprocessing import get_context
from pathlib import Path

from pages import DOCS, NOTEBOOKS

ROOT = DOCS.parent
KEPT = ROOT / "build" / "notebooks"
PAGE = "page.md"
CELL, TEXT = "# %%", "[markdown]"


def cells(script: str) -> Iterator[tuple[int, bool, str]]:
    """The cells of a script: (lines before it, whether it is text, its content)."""
    first, *pieces = script.split(CELL)
    before = first.count("\n")
    for piece in pieces:
        head, _, body = piece.partition("\n")
        is_text = head.strip() == TEXT
        text = "\n".join(line[2:] for line in body.splitlines()) if is_text else body
        yield before + 1, is_text, text.strip("\n")
        before += piece.count("\n")


def kept_folder(script: Path, kept: Path = KEPT) -> Path:
    """Where the page of a script as it stands is kept, once it was run."""
    return kept / f"{script.stem}-{hashlib.sha256(script.read_bytes()).hexdigest()[:16]}"


def page_of(script: Path, kept: Path = KEPT) -> tuple[str, list[Path]]:
    """(Markdown, the pictures that it shows in a folder of the script's name) of a script as it stands."""
    folder = kept_folder(script, kept)
    if folder.is_dir():
        return (folder / PAGE).read_text(encoding="utf-8"), sorted(folder.glob("*.png"))
    note = f"*`examples/{script.name}`, which was not run for this page: `make docs NOTEBOOKS=all` shows its output.*"
    return _joined([_shown(*cell[1:]) for cell in cells(script.read_text(encoding="utf-8"))], note), []


def run(script: Path, kept: Path = KEPT) -> None:
    """Run a script as it stands, in a process of its own, unless its page is kept.

    :raises RuntimeError: the script failed; its own message stands on stderr
    """
    folder = kept_folder(script, kept)
    if folder.is_dir():
        return
    partial = folder.with_suffix(".partial")
    for old in kept.glob(f"{script.stem}-*"):
        shutil.rmtree(old)
    partial.mkdir(parents=True)
    process = get_context("spawn").Process(target=_run_cells, args=(script.resolve(), partial.resolve()))
    process.start()
    process.join()
    if process.exitcode:
        raise RuntimeError(f"{script} failed")
    partial.rename(folder)


def _run_cells(script: Path, folder: Path) -> None:
    """Write the page and the pictures, which the script writes into a folder of its name where EXAMPLES_OUT says."""
    os.chdir(ROOT)
    out = Path(os.environ.get("EXAMPLES_OUT", "build/examples")) / script.stem
    shutil.rmtree(out, ignore_errors=True)
    names: dict[str, object] = {"__name__": "__main__"}
    shown = []
    for before, is_text, content in cells(script.read_text(encoding="utf-8")):
        shown.append(_shown(is_text, content))
        if is_text:
            continue
        code = compile("\n" * before + content, str(script), "exec")  # lines are counted as in the script
        with contextlib.redirect_stdout(io.StringIO()) as said:
            exec(code, names)
        if said.getvalue().strip():
            shown.append(f"```text\n{said.getvalue().rstrip()}\n```")
        for picture in sorted(out.glob("*.png"), key=lambda path: path.stat().st_mtime_ns):
            if not (folder / picture.name).exists():
                shutil.copy(picture, folder)
                shown.append(f"![{picture.stem}]({script.stem}/{picture.name})")
    note = f"*`examples/{script.name}` with its output, as it was when the script was last run.*"
    (folder / PAGE).write_text(_joined(shown, note), encoding="utf-8")


def _shown(is_text: bool, content: str) -> str:
    return content if is_text else f"```python\n{content}\n```"


def _joined(shown: list[str], note: str) -> str:
    """The page, whose first cell is text and begins with the title."""
    title, _, rest = shown[0].partition("\n")
    return "\n\n".join([title, note, rest.strip(), *shown[1:]]) + "\n"


if __name__ == "__main__":
    options = argparse.ArgumentParser(description="Run notebooks of the examples for the site.")
    options.add_argument("names", nargs="+", choices=[*NOTEBOOKS, "all"])
    chosen = options.parse_args().names
    for name in NOTEBOOKS if "all" in chosen else chosen:
        try:
            run(ROOT / "examples" / f"{name}.py")
        except RuntimeError as error:
            sys.exit(f"make docs: {error}")
