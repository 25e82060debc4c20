"""The rule of :mod:`shared.physics.compiled`: where fast-math flags are involved, a kernel's functions are inlined."""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Iterable, Iterator
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any

from numba.core.dispatcher import Dispatcher

import datafactory
import shared
import trainer
from shared.physics.compiled import compiled, inlined

PACKAGES = [Path(package.__file__ or "").parent for package in (shared, datafactory, trainer)]
OURS = [package.name for package in PACKAGES]


def kernels() -> list[Dispatcher]:
    """All of the packages."""
    found = {}
    for package in PACKAGES:
        for path in sorted(package.rglob("*.py")):
            if "physics.compiled import" in path.read_text(encoding="utf-8"):
                place = path.relative_to(package.parent).with_suffix("")
                for value in vars(importlib.import_module(".".join(place.parts))).values():
                    if isinstance(value, Dispatcher):
                        found[id(value)] = value
    return list(found.values())


def called(function: Any) -> Iterator[Dispatcher]:
    """The kernels whose names a function reads, of its module or of one it imports; through plain functions too."""
    values = [function.__globals__[name] for name in function.__code__.co_names if name in function.__globals__]
    modules = [vars(value) for value in values if isinstance(value, ModuleType)]
    values += [module[name] for module in modules for name in function.__code__.co_names if name in module]
    for value in values:
        if isinstance(value, Dispatcher):
            yield value
        elif isinstance(value, FunctionType) and value.__module__.split(".")[0] in OURS:
            yield from called(inspect.unwrap(value))  # tests put the wrapper of a type checker around it


def calls(of: Iterable[Dispatcher]) -> list[tuple[Dispatcher, Dispatcher]]:
    """Caller and function, of every call between kernels."""
    return [(outer, inner) for outer in of for inner in called(outer.py_func)]


def broken(outer: Dispatcher, inner: Dispatcher) -> bool:
    """Whether a call has fast-math flags on either side and is not inlined."""
    fast = outer.targetoptions["fastmath"] or inner.targetoptions["fastmath"]
    return bool(fast) and not inner.targetoptions["forceinline"]


def name(kernel: Dispatcher) -> str:
    return f"{kernel.py_func.__module__}.{kernel.py_func.__name__}"


def test_functions_of_fast_kernels_are_inlined():
    found = calls(kernels())
    names = {(name(outer).split(".")[-1], name(inner).split(".")[-1]) for outer, inner in found}
    assert {("add_moments", "rx_lengths"), ("_rx_legs", "phasor"), ("_along_edges", "_integral_from_foot")} <= names
    assert [f"{name(outer)} calls {name(inner)}" for outer, inner in found if broken(outer, inner)] == []


def test_no_kernel_takes_over_flags_of_its_caller():
    for kernel in kernels():
        assert {"fastmath", "error_model", "forceinline"} <= set(kernel.targetoptions), name(kernel)
        assert "inline" not in kernel.targetoptions, name(kernel)


def test_only_functions_that_python_calls_are_kept():
    for kernel in kernels():
        inner = kernel.targetoptions["forceinline"]
        assert (kernel.stats.cache_path is None) or not inner, name(kernel)


@compiled()
def _strict(value):
    return value * value + value


@compiled(fastmath={"contract"})
def _fast(value):
    return value * value + value


@inlined(fastmath={"contract"})
def _folded(value):
    return value * value + value


@compiled()
def _outer(value):
    return _strict(value) + _fast(value) + _folded(value)


@compiled(fastmath={"contract"})
def _fast_outer(value):
    return _strict(value) + _folded(value)


def test_a_call_that_breaks_the_rule_is_found():
    found = calls([_outer, _fast_outer])
    assert len(found) == 5
    wrong = [(outer, inner) for outer, inner in found if broken(outer, inner)]
    assert wrong == [(_outer, _fast), (_fast_outer, _strict)]
