"""Kernels: compiled without a folder for their machine code, kept where there is one, and the rule for their calls."""

import importlib
import inspect
import os
import pickle
import shutil
import subprocess
import sys
from collections.abc import Iterable, Iterator
from functools import partial
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any

import pytest
from numba.core.dispatcher import Dispatcher
from processes import python

import datafactory
import shared
import trainer

PACKAGES = [Path(package.__file__ or "").parent for package in (shared, datafactory, trainer)]
OURS = [package.name for package in PACKAGES]
KERNEL = """
from shared.physics.compiled import compiled

@compiled(error_model="numpy")
def tripled(value):
    return 3 * value
"""
HEIGHTS = """
import numpy as np
from datafactory.scenes.ground import height_map
from datafactory.scenes.scene import Scene, SceneObject
from datafactory.synthesis.cube import cube_of_paths
from datafactory.synthesis.truth import truth_moments
corners = np.array([[0.0, 0, 1], [4, 0, 1], [0, 4, 1]])
flat = SceneObject("flat", corners, np.array([[0, 1, 2]], dtype=np.int32))
print(height_map(Scene("one", (flat,)), 1.0).surface[0, 0])
"""


def run(script: str, folder: Path, home: Path, **more: str) -> str:
    """What a script prints in an interpreter whose own code lies in ``folder`` and whose home is ``home``."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("NUMBA_", "XDG_"))}
    environment = {**kept, "PYTHONPATH": str(folder), "HOME": str(home), **more}
    done = subprocess.run(
        [sys.executable, "-c", script], env=environment, cwd=folder, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


OUTER = """
from part import plus
from shared.physics.compiled import compiled, is_kept

@compiled(error_model="numpy")
def outer(value):
    return plus(value)

print(is_kept(outer), outer(1))
"""
PART = """
from shared.physics.compiled import compiled

STEP = {step}

@compiled(cache=False, error_model="numpy")
def plus(value):
    return value + STEP
"""
BY_TYPE = """
from numba.extending import overload

STEP = {step}

def plus(value):
    return value + STEP

@overload(plus)
def _plus(value):
    return lambda value: value + STEP
"""


@pytest.mark.parametrize("part", [PART, BY_TYPE])
def test_kept_code_is_compiled_anew_where_a_function_that_it_calls_has_changed(part: str, tmp_path: Path) -> None:
    """Another file than the caller's, which numba does not look at."""
    (tmp_path / "outer.py").write_text(OUTER)
    said = []
    for step in (1, 1, 15):  # one of two digits: Python takes a file of the same second and size for the same
        (tmp_path / "part.py").write_text(part.format(step=step))
        said.append(run("import outer", tmp_path, tmp_path / "home"))
    assert said == ["False 2", "True 2", "False 16"]


def test_kept_code_that_names_a_class_which_is_gone_is_compiled_anew(tmp_path: Path) -> None:
    """numba reads the whole index before it looks whether it is of these sources."""
    (tmp_path / "kernel.py").write_text(KERNEL)
    told = partial(run, "import kernel; print(kernel.tripled(2))", tmp_path, tmp_path / "home")
    assert told() == "6"
    (index,) = tmp_path.rglob("*.nbi")
    with index.open("rb") as kept:
        version = pickle.dumps(pickle.load(kept))
    index.write_bytes(version + b"ckernel\nGone\n.")
    assert told() == "6"
    assert b"Gone" not in index.read_bytes()


@pytest.fixture
def unwritable(tmp_path: Path) -> Path:
    """A folder in which nothing can be made, not even by root: its parent is a file."""
    (tmp_path / "file").write_text("")
    return tmp_path / "file" / "home"


@pytest.fixture
def read_only(tmp_path: Path) -> Path:
    """A copy of the packages in which no cache can be written: every ``__pycache__`` is a file."""
    folder = tmp_path / "site-packages"
    for package in PACKAGES:
        shutil.copytree(package, folder / package.name, ignore=shutil.ignore_patterns("__pycache__"))
    (folder / "kernel.py").write_text(KERNEL)
    for place in [folder, *(path for path in folder.rglob("*") if path.is_dir())]:
        (place / "__pycache__").write_text("")
    return folder


def test_a_read_only_installation_compiles_in_every_process(read_only: Path, unwritable: Path) -> None:
    before = sorted(read_only.rglob("*"))
    assert run(HEIGHTS, read_only, unwritable) == "1.0"
    assert run("import kernel; print(kernel.tripled(14))", read_only, unwritable) == "42"
    assert sorted(read_only.rglob("*")) == before


def test_no_kernel_goes_round_the_decorator() -> None:
    for package in PACKAGES:
        for path in package.rglob("*.py"):
            assert path.name == "compiled.py" or "njit" not in path.read_text(encoding="utf-8"), path


def kernels() -> list[Dispatcher]:
    """All of the packages."""
    found = {}
    for package in PACKAGES:
        for path in sorted(package.rglob("*.py")):
            text = path.read_text(encoding="utf-8")
            if "physics.compiled import" in text or "small_matrices import" in text:
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


def test_no_kernel_takes_over_flags_of_its_caller_and_what_is_inlined_is_not_kept():
    for kernel in kernels():
        assert (kernel.stats.cache_path is None) or not kernel.targetoptions["forceinline"], name(kernel)
        assert {"fastmath", "error_model", "forceinline"} <= set(kernel.targetoptions), name(kernel)


def test_what_numba_inlines_is_called_once_and_neither_it_nor_its_caller_has_flags():
    """It takes on the flags of its caller, and is optimised in its stead."""
    every = kernels()
    lines = [kernel for kernel in every if kernel.targetoptions.get("inline", "never") != "never"]
    assert {"_fit", "_merge", "describe"} <= {name(kernel).split(".")[-1] for kernel in lines}
    for kernel in lines:
        callers = [outer for outer, inner in calls(every) if inner is kernel]
        assert len(callers) == 1, name(kernel)
        assert [one.targetoptions["fastmath"] for one in (kernel, *callers)] == [False, False], name(kernel)


PRODUCTS = """
import re
import numpy as np
from shared.physics.compiled import compiled

def product(a, b):
    return a * b

for options in ({"fastmath": {"contract", "reassoc"}}, {}):
    kernel = compiled(cache=False, **options)(product)
    kernel(np.complex64(1j), np.complex64(2.0))
    (code,) = kernel.inspect_llvm().values()
    print(len(re.findall(r"fmul (?:reassoc|contract)", code)), len(re.findall(r"fmul float", code)))
"""


def test_a_kernel_rounds_complex_products_as_its_own_flags_say_whichever_was_compiled_before() -> None:
    (fast, _), (none, plain) = (map(int, line.split()) for line in python("-c", PRODUCTS).splitlines())
    assert fast > 0
    assert none == 0
    assert plain > 0
