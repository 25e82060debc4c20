"""The public names of a package, each imported when it is first used (PEP 562).

``import datafactory`` and ``datafactory --help`` then load nothing that computes.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any

from shared.processes.strangers import OURS, refuse_namesake

VERSION = "__version__"


def lazy_names(
    package: str, distribution: str, modules: Mapping[str, str]
) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """(``__getattr__``, ``__dir__``) for the ``__init__`` of a package.

    A name that was imported once is an attribute like any other. ``__version__`` is that of the installed distribution.

    :param distribution: whose metadata hold the version
    :param modules: public name -> module that defines it under this name; a name that is a subpackage -> the package
    :raises ImportError: somebody else's distribution of the package's name is installed over ours
    """
    if package in OURS:
        refuse_namesake(package)

    def find(name: str) -> Any:
        if name == VERSION:
            from importlib.metadata import version

            value: Any = version(distribution)
        elif name in modules:
            module = import_module(modules[name])
            value = module if module.__name__ == f"{package}.{name}" else getattr(module, name)
        else:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        setattr(sys.modules[package], name, value)
        return value

    def names() -> list[str]:
        return sorted({*vars(sys.modules[package]), *modules, VERSION})

    return find, names
