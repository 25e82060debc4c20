"""The one place that chooses the Mitsuba variant by device, and the libLLVM that it compiles with.

Call :func:`select_variant` before anything imports ``sionna.rt``. That package sets a variant of its own at import, and
Dr.Jit then loads the first libLLVM of the system. With LLVM 15 or 16, Dr.Jit 1.5 aborts the process on AVX-512
machines, without an exception. This module therefore initialises Dr.Jit only after it has found a usable library.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from datafactory.defaults import CPU, CUDA, DEVICES
from shared.physics.errors import InputError

CUDA_VARIANT = "cuda_ad_mono_polarized"
METAL_VARIANT = "metal_ad_mono_polarized"
LLVM_VARIANT = "llvm_ad_mono_polarized"
VARIANTS = (CUDA_VARIANT, METAL_VARIANT, LLVM_VARIANT)

MINIMUM_LLVM = 17
"""Measured: 17 to 23 work, 15 and 16 abort on AVX-512 machines."""

LLVM_VARIABLE = "DRJIT_LIBLLVM_PATH"
INSTALL_LLVM = "LLVM 17 or newer: pip install karellen-llvm-core wheel-axle-runtime" + (
    " (Linux x86-64), or brew install llvm (macOS)" if sys.platform != "linux" else ""
)

_PROBE_SECONDS = 20.0

# The driver's C interface, then OptiX (libnvoptix), which Mitsuba needs to trace rays: it comes with the driver, but
# not with every container. The first line says how far it came, the second which device is there.
_CUDA_PROBE = """
import ctypes, sys
names = ("nvcuda.dll", "nvoptix.dll") if sys.platform == "win32" else ("libcuda.so.1", "libnvoptix.so.1")
try:
    driver = ctypes.CDLL(names[0])
except OSError:
    sys.exit(print("driver"))
count, device, name = ctypes.c_int(0), ctypes.c_int(0), ctypes.create_string_buffer(256)
if driver.cuInit(0) or driver.cuDeviceGetCount(ctypes.byref(count)) or count.value < 1:
    sys.exit(print("device"))
driver.cuDeviceGet(ctypes.byref(device), 0)
driver.cuDeviceGetName(name, 256, device)
try:
    ctypes.CDLL(names[1])
except OSError:
    sys.exit(print("optix", name.value.decode(errors="replace"), sep="\\n"))
print("usable", name.value.decode(errors="replace"), sep="\\n")
"""
_CUDA_PROBLEMS = {
    "driver": (
        "there is no NVIDIA driver (libcuda cannot be loaded)",
        "an NVIDIA GPU with its driver, in a container with --gpus all; or --device cpu",
    ),
    "device": (
        "the NVIDIA driver finds no device",
        "nvidia-smi without an error, in a container with --gpus all; or --device cpu",
    ),
    "optix": (
        "the NVIDIA driver comes without OptiX (libnvoptix cannot be loaded), which traces rays",
        "the driver's whole package, in a container NVIDIA_DRIVER_CAPABILITIES=all; or --device cpu",
    ),
}

# LLVMGetVersion has been exported since LLVM 16; a library without it is older.
_LLVM_PROBE = """
import ctypes, sys
parts = [ctypes.c_uint(0) for _ in range(3)]
ctypes.CDLL(sys.argv[1]).LLVMGetVersion(*(ctypes.byref(part) for part in parts))
print(*(part.value for part in parts), sep=".")
"""


def _script_output(script: str, *arguments: str) -> str | None:
    """The output of a script in an interpreter of its own, or None if it fails; this process survives its crash."""
    command = [sys.executable, "-I", "-S", "-c", script, *arguments]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=_PROBE_SECONDS, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout.strip() if done.returncode == 0 else None


@dataclass(frozen=True)
class CudaDevice:
    """The GPU that CUDA would use, and whether rays can be traced on it.

    :param name: of the first visible one; empty where there is none
    :param problem: why rays cannot be traced on it; empty where they can
    :param remedy: what would be right
    """

    name: str = ""
    problem: str = ""
    remedy: str = ""


@lru_cache(maxsize=1)
def cuda_device() -> CudaDevice:
    """What the NVIDIA driver says, asked in a subprocess, without Dr.Jit, once a process."""
    said = _script_output(_CUDA_PROBE) if sys.platform in ("linux", "win32") else "driver"
    outcome, _, name = (said or "device").partition("\n")
    return CudaDevice(name, *_CUDA_PROBLEMS.get(outcome, ("", "")))


def llvm_version(path: Path) -> str | None:
    """Version of a libLLVM, e.g. ``"15.0.6"``; None if it cannot be told.

    On every Linux the file name holds it (``libLLVM-15.so.1``, ``libLLVM.so.23.1``, after following links). Otherwise a
    subprocess loads the library and calls ``LLVMGetVersion``, so that this process never holds two LLVMs.
    """
    for name in (path.resolve().name, path.name):
        found = re.fullmatch(r"libLLVM(?:-|\.so\.)(\d+(?:\.\d+)*)(?:\.so.*|\.dylib|git)?", name)
        if found:
            return found.group(1)
    return _script_output(_LLVM_PROBE, str(path)) if path.is_file() else None


def _candidates() -> Iterator[Path]:
    """Libraries in order of preference: this environment's, then the system's, newest first."""
    yield from sorted(Path(sys.prefix, "lib").glob("libLLVM*.so*"))
    found = [
        path
        for pattern in (
            "usr/lib/*-linux-gnu/libLLVM*.so*",
            "usr/lib/llvm-*/lib/libLLVM*.so*",
            "usr/lib64/libLLVM*.so*",
            "usr/lib/libLLVM*.so*",
            "usr/local/lib/libLLVM*.so*",
            "opt/homebrew/opt/llvm/lib/libLLVM.dylib",
            "usr/local/opt/llvm/lib/libLLVM.dylib",
        )
        for path in Path("/").glob(pattern)
    ]
    yield from sorted(found, key=lambda path: (-_major_version(llvm_version(path)), str(path)))


def _major_version(version: str | None) -> int:
    return int(version.split(".")[0]) if version else 0


def find_llvm() -> tuple[Path, str]:
    """Path and version of a libLLVM that Dr.Jit can use, found without initialising Dr.Jit.

    ``DRJIT_LIBLLVM_PATH`` decides alone where it is set; else this environment's ``lib`` (where the wheel
    karellen-llvm-core puts its library), then the system's.

    :raises InputError: if there is none, or only one older than 17
    """
    given = os.environ.get(LLVM_VARIABLE)
    if given and not Path(given).is_file():
        raise InputError(LLVM_VARIABLE, f"no file {given}", "a libLLVM, or the variable unset")
    refused: list[str] = []
    for path in [Path(given)] if given else _candidates():
        version = llvm_version(path)
        if version and _major_version(version) >= MINIMUM_LLVM:
            return path, version
        refused.append(_too_old(path, version))
    if given:
        raise InputError(LLVM_VARIABLE, refused[0], f"{INSTALL_LLVM}, and the variable unset")
    raise InputError("LLVM", refused[0] if refused else "no libLLVM was found", INSTALL_LLVM)


def _too_old(path: Path, version: str | None) -> str:
    if version is None:
        return f"the version of {path} cannot be told"
    return f"found {version} at {path}; Dr.Jit aborts with LLVM 15 and 16 and knows none older"


def select_variant(device: str | None = None) -> str:
    """Choose and set the Mitsuba variant of a device: LLVM on the CPU (on macOS Metal, where Mitsuba has it), or CUDA.

    Idempotent: a variant of ours that is already set stays, for Sionna registers its materials with the first one.
    ``DRJIT_LIBLLVM_PATH`` is set for this process and its children before Dr.Jit reads it, i.e. before the first array
    on the LLVM backend; code that used that backend earlier has loaded its own library, and this function cannot change
    it any more.

    :param device: ``"cpu"`` or ``"cuda"``; None for the one that this process has, ``"cpu"`` where it has none
    :return: the variant's name, now set
    :raises InputError: if the device is not usable, or there is no usable libLLVM, with the command that mends it; if
        this process already traces on another device
    """
    if device not in (None, *DEVICES):
        raise InputError("--device", repr(device), f"one of {', '.join(DEVICES)}")
    already = sys.modules.get("mitsuba")
    if already is not None and already.variant() in VARIANTS:
        variant = str(already.variant())
        if device is not None and (variant == CUDA_VARIANT) != (device == CUDA):
            raise InputError("--device", f"{device}, where this process traces with {variant}", "one device a process")
        return variant
    if (device or CPU) == CUDA:
        if (found := cuda_device()).problem:
            raise InputError("--device", f"{device}: {found.problem}", found.remedy)
        return _set_variant(CUDA_VARIANT)
    if sys.platform == "darwin" and METAL_VARIANT in _compiled_variants():
        return _set_variant(METAL_VARIANT)
    path, _ = find_llvm()
    os.environ[LLVM_VARIABLE] = str(path)
    return _set_variant(LLVM_VARIANT)


def traces_on_the_processor() -> bool:
    """Whether the variant of this process computes on the processor, so that processor time is what tracing takes."""
    return select_variant() == LLVM_VARIANT


def _compiled_variants() -> list[str]:
    import mitsuba

    return list(mitsuba.variants())


def _set_variant(variant: str) -> str:
    # Imported late: ``datafactory doctor`` uses this module on machines where Mitsuba is missing or does not load.
    try:
        import mitsuba

        mitsuba.set_variant(variant)
    except ImportError as error:
        raise InputError("mitsuba", f"{variant} cannot be loaded: {error}", "pip install mitsuba drjit") from None
    return variant


def set_threads(count: int) -> None:
    """Let Dr.Jit's LLVM backend use ``count`` threads (no effect on CUDA).

    :raises InputError: as :func:`select_variant`
    """
    select_variant()  # Dr.Jit loads its LLVM with the first thread, and would take another than ours
    import drjit

    drjit.set_thread_count(count)
