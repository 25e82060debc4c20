"""JSON documents that are read back: whether a file holds one, and whether its values are those that were written.

A sealed document holds a SHA-256 of its own entries, so that a flipped digit in it is not read as another number.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

from shared.dataset.locations import Location, sha256_of
from shared.physics.errors import InputError

DIGEST = "sha256"
"""Entry of a sealed document with the SHA-256 of the others."""
MADE = "made"
"""Entry that may differ between equal runs; no reader depends on it, and no checksum covers it."""


def digest(value: object) -> str:
    """SHA-256 of a value of plain JSON types, in hexadecimal."""
    return hashlib.sha256(json.dumps(value, sort_keys=True, allow_nan=False).encode()).hexdigest()


@cache
def code_fingerprint(*packages: str) -> str:
    """Of the sources of packages, so that changed code never meets what other code computed."""
    sources = dict[str, str]()
    for package in packages:
        for folder in import_module(package).__path__:
            root = Path(folder)
            sources |= {f"{package}/{path.relative_to(root)}": sha256_of(path) for path in sorted(root.rglob("*.py"))}
    return digest(sources)


def read_json(path: Location, expected: str) -> Any:
    """The JSON value of a file.

    :param expected: what the file should be, for the message
    :raises InputError: missing, not JSON, nested too deeply
    """
    try:
        return json.loads(path.read_bytes())
    except (ValueError, RecursionError, OSError) as error:
        raise InputError(path, f"not readable as JSON: {error}", expected) from error


def sealed(document: Mapping[str, Any]) -> dict[str, Any]:
    """The document as plain JSON values, with the checksum of its entries."""
    plain = json.loads(json.dumps(document, allow_nan=False))
    return {**plain, DIGEST: _of_entries(plain)}


def unsealed(path: Location, document: Any) -> dict[str, Any]:
    """The entries of a document without the checksum; one of an earlier release has none, and is not checked.

    :param path: of its file
    :raises InputError: no entries, or entries that were changed
    """
    if not isinstance(document, dict):
        raise InputError(path, f"holds {type(document).__name__}, no entries", "one as it was written")
    entries = {name: value for name, value in document.items() if name != DIGEST}
    if DIGEST in document and document[DIGEST] != (found := _of_entries(entries)):
        raise InputError(path, f"its entries have sha256 {found}, it says {document[DIGEST]}", "one as it was written")
    return entries


def _of_entries(document: Mapping[str, Any]) -> str:
    entries = {name: value for name, value in document.items() if name not in (DIGEST, MADE)}
    return digest(entries)
