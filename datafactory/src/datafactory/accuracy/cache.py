"""What was measured once and need not be again: files in the user's cache folder, named by a hash of their inputs."""

from __future__ import annotations

import os
import platform
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from shared.dataset.documents import code_fingerprint, digest, read_json, sealed, unsealed
from shared.dataset.writing import write_json
from shared.physics.errors import InputError
from shared.processes.telling import Announce

Model = TypeVar("Model", bound=BaseModel)


def user_cache() -> Path:
    """The platform's folder for what can be made again (XDG base directories; Library/Caches; LOCALAPPDATA)."""
    given = os.environ.get("XDG_CACHE_HOME") or (os.environ.get("LOCALAPPDATA") if sys.platform == "win32" else None)
    base = Path(given) if given else Path.home() / ("Library/Caches" if sys.platform == "darwin" else ".cache")
    return base / "sparseradar"


def cached(
    folder: Path, inputs: Mapping[str, Any], kind: type[Model], measure: Callable[[Path], Model], announce: Announce
) -> Model:
    """What was kept for these inputs, or else what ``measure`` returns, kept from now on.

    :param inputs: JSON values; the code of the two packages joins them
    :param measure: takes the file that will hold its result
    :param announce: takes a line where the cache is damaged or cannot be written; the run goes on without it
    """
    code = code_fingerprint("shared", "datafactory")
    path = folder / f"{digest({**inputs, 'kind': kind.__name__, 'code': code})}.json"
    if path.exists():
        try:
            return kind.model_validate(unsealed(path, read_json(path, "what was measured before")))
        except (InputError, ValidationError):
            announce(f"{path}: damaged, measured again")
    value = measure(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        # Jobs of an array may share the folder: each writes a file of its own, and the last renames over the others.
        own = path.with_name(f"{path.stem}-{platform.node()}-{os.getpid()}.json")
        write_json(own, sealed(value.model_dump(mode="json")))
        own.replace(path)
    except OSError as error:
        announce(f"{path}: cannot be kept ({error.strerror}); it will be measured again next time")
    return value
