"""What of a machine changes the bytes of a shard: versions, and the ray tracer's back end."""

from __future__ import annotations

import platform
import sys
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version

from datafactory.run.provenance import PACKAGES
from shared.physics.errors import InputError

MISSING = "missing"


def surroundings() -> dict[str, str]:
    """Versions by name, told without importing what they are of."""
    found = {"Python": platform.python_version(), "the machine": f"{platform.system()} {platform.machine()}"}
    for name in (*PACKAGES, "scipy"):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = MISSING
    return found


def tracer() -> dict[str, str]:
    """Mitsuba's variant and, on LLVM, the version of the library, of this process; it is made ready if need be.

    :raises InputError: as :func:`datafactory.paths.backend.select_variant`
    """
    from datafactory.paths.backend import LLVM_VARIANT, find_llvm, select_variant

    variant = select_variant()
    return {"the ray tracer": f"{variant} with LLVM {find_llvm()[1]}" if variant == LLVM_VARIANT else variant}


def processor() -> str:
    """The kind of processor, as LLVM calls it: code is compiled for it, so that last digits may depend on it."""
    from llvmlite import binding

    return str(binding.get_host_cpu_name())


def difference(here: Mapping[str, str], there: Mapping[str, str]) -> str:
    """The first thing that differs, in words; empty where nothing does."""
    for name, value in here.items():
        if there.get(name, MISSING) != value:
            return f"{name} is {there.get(name, MISSING)} there, {value} here"
    return ""


def look_around() -> tuple[dict[str, str], str]:
    """Versions, and the kind of processor, of the machine that this runs on."""
    return surroundings(), processor()


def unlike(node: str, found: str) -> InputError:
    """What is said of a node that would make other bytes."""
    return InputError("--engine", f"node {node}: {found}", "the same on all nodes, for the same bytes")


def where() -> str:
    """This interpreter, for a message about a node."""
    return f"{platform.node()} ({sys.executable})"
