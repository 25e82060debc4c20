"""The names of our packages: what they make public, and whether a stranger's package has taken the name.

A public name is imported when it is first used (PEP 562): ``import datafactory`` and ``datafactory --help`` load
nothing that computes. Nor do they load :mod:`importlib.metadata`, which would be a twelfth of that help's time.

The public index has distributions that install ``shared`` or ``trainer``. The one that is installed later writes over
the files of the other, without a word. Each of ours asks here when it begins.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from typing import Any

VERSION = "__version__"


OURS = {"shared": "sparseradar-shared", "datafactory": "sparseradar-datafactory", "trainer": "sparseradar-trainer"}
"""Distribution by import name."""


def lazy_names(
    package: str, modules: Mapping[str, Sequence[str]]
) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """(``__getattr__``, ``__dir__``) for the ``__init__`` of a package.

    A name that was imported once is an attribute like any other. ``__version__`` is that of the installed distribution.

    :param modules: module -> public names that it defines; a subpackage -> its own name
    :raises ImportError: somebody else's distribution of the package's name is installed over ours
    """
    if package in OURS:
        refuse_namesake(package)
    module_of = {name: module for module, names in modules.items() for name in names}

    def find(name: str) -> Any:
        if name == VERSION:
            from importlib import metadata

            value: Any = metadata.version(OURS[package.partition(".")[0]])
        elif name in module_of:
            module = import_module(module_of[name])
            value = module if module.__name__ == f"{package}.{name}" else getattr(module, name)
        else:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        setattr(sys.modules[package], name, value)
        return value

    def listed() -> list[str]:
        return sorted({*vars(sys.modules[package]), *module_of, VERSION})

    return find, listed


def strangers(package: str) -> list[str]:
    """Names of all installed distributions that bring a package of this name, ours apart.

    It reads the records of every distribution, a tenth of a second.
    """
    from importlib import metadata

    found = metadata.packages_distributions().get(package, [])
    return sorted({name for name in found if name.lower().replace("_", "-") != OURS[package]})


def remedy(package: str, names: list[str]) -> str:
    """The commands that bring ours back."""
    ours = OURS[package]
    return f"pip uninstall -y {' '.join(names)} && pip install --force-reinstall --no-deps {ours}"


def refuse_namesake(package: str) -> None:
    """Say in one line that a stranger's package is installed over ours: a question of a millisecond.

    :raises ImportError: a distribution of the package's very name is installed
    """
    if not any(_holds_distribution(folder, package) for folder in sys.path):
        return
    from importlib import metadata

    try:
        name = str(metadata.metadata(package)["Name"])
    except metadata.PackageNotFoundError:
        return
    raise ImportError(
        f"the distribution {name!r} is installed over {OURS[package]!r}, both bring the package {package!r}; "
        f"mend it: {remedy(package, [name])}"
    )


def _holds_distribution(folder: str, name: str) -> bool:
    """Whether an import folder may have the metadata of a distribution of this name."""
    try:
        files = os.listdir(folder or ".")
    except OSError:
        return False
    begins, ends = (f"{name}-", f"{name}."), (".dist-info", ".egg-info")
    return any(file.lower().startswith(begins) and file.endswith(ends) for file in files)
