"""The decorators of every numba kernel, kept so that a kernel gives the same bytes in every process.

:func:`compiled` is for functions that Python calls. Their machine code is kept on disk. numba looks for a folder that
it can write: ``NUMBA_CACHE_DIR``, then ``__pycache__`` beside the source, then the user's cache folder. Where there is
none, as in a read-only installation, it refuses to make the function. Such a function is compiled in every process
instead. numba compiles anew where the function's own file has changed; the functions that it calls stand in other
files, and an update that changes only those would run old code. So the sources of all of them are part of its stamp.

:func:`inlined` is for functions that are only compiled into others. The rule: **where the caller or the function has
fast-math flags, the function is inlined.** For a call between two kernels finds one of two machine codes:

* the function's own, optimised by itself, in the process that compiled it or loaded it earlier;
* the copy in the caller's kept code, optimised once more among its callers, in any other process.

Without fast-math flags both are the same to the last bit, because LLVM may change no rounding. With them the optimiser
chooses which product is fused with which sum, and the two differ in the last digits: the first frame after an
installation, which compiles, from all later ones. An inlined function has no call and no second copy.

Functions without such flags may call each other, which compiles faster where they are long or called at many places.

numba lets a function without flags of its own take over those of the caller that is compiled first. Both decorators
rule that out by giving all of them. The parts of its own that it compiles once a process, as the product of complex
numbers, take over fast-math flags likewise: whether a Cholesky factor was rounded as written depended on which kernel
the process had compiled before. Here each set of flags has parts of its own.

``tests/shared/physics/test_compiled.py`` holds the sources to the rule,
``tests/datafactory/synthesis/test_kept_machine_code.py`` the results.
"""

from __future__ import annotations

import hashlib
import inspect
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from types import FunctionType
from typing import Any

import numba
from numba.core.cpu import CPUContext

_OWN = {"error_model": "python", "fastmath": False, "forceinline": False}
"""What numba would take over from the first caller: its own defaults."""


_PARTS: dict[frozenset[str], dict[Any, Any]] = {}
"""numba's own compiled parts, by fast-math flags."""


def _keep_parts_apart(compile_part: Callable[..., Any]) -> Callable[..., Any]:
    @wraps(compile_part)
    def compiled_part(self: CPUContext, *arguments: Any, **named: Any) -> Any:
        # A function that is being compiled has a context of its own, with its flags.
        self.cached_internal_func = _PARTS.setdefault(frozenset(getattr(self.fastmath, "flags", ())), {})
        return compile_part(self, *arguments, **named)

    return compiled_part


CPUContext.compile_subroutine = _keep_parts_apart(CPUContext.compile_subroutine)


def compiled(cache: bool = True, **options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Decorate a function to be compiled by numba without Python objects.

    :param cache: keep the machine code on disk; False for functions without fast-math flags that only others call
    :param options: of :func:`numba.njit`
    """

    def decorate(function: Callable[..., Any]) -> Any:
        kernel = inspect.unwrap(function)  # numba cannot compile the wrapper of a type checker
        if cache:
            try:
                return _stamped(numba.njit(cache=True, **{**_OWN, **options})(kernel))
            except RuntimeError as error:
                if "cannot cache function" not in str(error):
                    raise
        return numba.njit(**{**_OWN, **options})(kernel)

    return decorate


def inlined(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Decorate a function to become a part of every kernel that calls it, optimised by itself beforehand.

    LLVM inlines it, not numba: numba would do so before the optimisation, with the caller's flags; loops that
    vectorise by themselves then often do not. Where neither has flags, and there is one caller, numba may
    (:data:`trainer.estimators.small_matrices.part_of_one`).
    """
    return compiled(cache=False, **{**options, "forceinline": True})


def is_kept(kernel: Any) -> bool:
    """Whether machine code of this function is on disk, so that a call need not compile."""
    file = getattr(getattr(kernel, "_cache", None), "_cache_file", None)
    return file is not None and bool(file._load_index())


def _stamped(kernel: Any) -> Any:
    """The function, its kept code bound to the sources of all functions that it calls, and the constants they use."""
    file = getattr(getattr(kernel, "_cache", None), "_cache_file", None)
    if file is None:  # numba runs without its compiler
        return kernel
    sources, constants = {__file__}, set()
    found, left = {kernel.py_func}, [kernel.py_func]
    while left:
        function: FunctionType = left.pop()
        sources.add(function.__code__.co_filename)
        for name in function.__code__.co_names:
            value: Any = function.__globals__.get(name)
            called = inspect.unwrap(getattr(value, "py_func", value))
            # What is no kernel may stand for one by its arguments' types (``numba.extending.overload``).
            if isinstance(called, FunctionType) and called not in found:
                found.add(called)
                left.append(called)
            elif isinstance(value, int | float | complex | tuple):
                constants.add(f"{name} = {value!r}")
    digest = hashlib.sha256("\n".join(sorted(constants)).encode())
    for source in sorted(sources):
        digest.update(Path(source).read_bytes())
    file._source_stamp = f"{file._source_stamp} {digest.hexdigest()}"
    load = file._load_index

    def load_index() -> Any:
        try:
            return load()
        except (AttributeError, ImportError):  # it names a class that stood elsewhere in older sources
            return {}

    file._load_index = load_index
    return kernel
