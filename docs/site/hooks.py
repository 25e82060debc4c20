"""What MkDocs calls: the menu, the generated reference, the notebooks, links out of the manual."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files
from notebooks import ROOT, page_of
from pages import NOTEBOOKS, navigation, without_links_out
from reference import contents, reference_pages

SHIM = "iframe-worker.js"
"""Lets the search of a page that lies on the disk run without a server."""
log = logging.getLogger("mkdocs.hooks.manual")
"""A warning here fails a strict build."""


def on_config(config: Any) -> Any:
    config.nav = navigation(list(reference_pages()))
    return config


def on_files(files: Files, config: Any) -> Files:
    files.append(File.generated(config, SHIM, abs_src_path=str(Path(__file__).with_name(SHIM))))
    for name, markdown in reference_pages().items():
        files.append(File.generated(config, f"reference/{name}", content=markdown))
    for name in NOTEBOOKS:
        markdown, pictures = page_of(ROOT / "examples" / f"{name}.py")
        files.append(File.generated(config, f"examples/{name}.md", content=markdown))
        for picture in pictures:
            files.append(File.generated(config, f"examples/{name}/{picture.name}", content=picture.read_bytes()))
    return files


def on_page_markdown(markdown: str, page: Any, config: Any, **_: Any) -> str:
    uri = page.file.src_uri
    if uri == "reference/index.md":
        return markdown + contents()
    if uri.startswith(("reference/", "examples/")):
        return markdown
    try:
        return without_links_out(markdown, Path(config.docs_dir) / uri)
    except FileNotFoundError as error:
        log.warning("dead link: %s", error)
        return markdown
