"""What this machine has, what is missing, and the command that mends it.

Nothing here imports a package that might abort: versions come from the installed metadata, and the Mitsuba variant is
tried in a process of its own.
"""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
import sys
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version

from datafactory.defaults import INSTALL_TORCH
from datafactory.paths.backend import CudaDevice, cuda_device, find_llvm
from shared.physics.errors import InputError
from shared.processes.lazy import OURS, remedy, strangers
from shared.processes.machine import usable_cores, usable_memory

MINIMUM_MEMORY_GIB = 4.0
"""A rule of thumb, not a measurement: one worker's interpreter, scene, paths and cube."""
MINIMUM_DISK_GIB = 5.0
"""About 2 500 frames: a stored frame is 1.9 MB (3 x 630 x 48 complex64 and 630 x 450 float32), uncompressed."""

_GIB = 1024.0**3
_TRIAL_SECONDS = 120.0

# Compile a kernel and trace one ray: the two things that fail on a broken set-up.
_TRIAL = """
import sys
from datafactory.paths.backend import select_variant
variant = select_variant(*sys.argv[1:])
import drjit as dr
import mitsuba as mi
assert int(dr.sum(dr.arange(mi.UInt32, 8))[0]) == 28
scene = mi.load_dict({"type": "scene", "ball": {"type": "sphere"}})
hit = scene.ray_intersect(mi.Ray3f(mi.Point3f(-3, 0, 0), mi.Vector3f(1, 0, 0)))
assert abs(float(hit.t[0]) - 2) < 1e-4
print(variant)
"""


# Whether torch can use a CUDA device: in a process of its own, for a broken driver may end it.
_TORCH_TRIAL = """
from datafactory.synthesis.cube import synthesis_problem
print(synthesis_problem() or "")
"""


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at.

    :param item: what
    :param value: what was found, in words
    :param ok: whether that will do
    :param remedy: the command or step that mends it; "" where nothing is to be mended
    :param required: whether the data factory cannot work without it
    """

    item: str
    value: str
    ok: bool
    remedy: str = ""
    required: bool = True


def examine() -> list[Finding]:
    """Look at everything the data factory needs; nothing is raised for anything that is missing."""
    disk = shutil.disk_usage(os.getcwd())
    return [
        Finding("Python", platform.python_version(), True),
        *examine_names(),
        *(_package(name) for name in ("numba", "usd-core", "mitsuba", "drjit", "sionna-rt", "pyarrow")),
        _package("torch", required=False),
        *_gpu(cuda_device()),
        _llvm(),
        _variant(),
        Finding("CPU cores", f"{usable_cores()} usable of {os.cpu_count()}", True, required=False),
        _amount("memory", usable_memory(), MINIMUM_MEMORY_GIB, "fewer --workers, or a larger machine"),
        _amount("free disk space", disk.free, MINIMUM_DISK_GIB, "make room, or give --out on another disk"),
    ]


def examine_names() -> list[Finding]:
    """One line for each of our packages that somebody else's distribution is installed over; one line where none is."""
    found = {package: names for package in OURS if (names := strangers(package))}
    if not found:
        return [Finding("package names", ", ".join(OURS), True)]
    return [
        Finding(
            f"package {package}", f"{', '.join(names)} is installed over {OURS[package]}", False, remedy(package, names)
        )
        for package, names in found.items()
    ]


def _package(name: str, required: bool = True) -> Finding:
    try:
        return Finding(name, version(name), True, required=required)
    except PackageNotFoundError:
        return Finding(name, "missing", False, f"pip install {name}", required)


def _gpu(device: CudaDevice) -> list[Finding]:
    """What GPU there is; where there is one, whether it traces and makes signals. Nothing needs one."""
    if not device.name:
        return [Finding("GPU", f"none: {device.problem}; --device cpu", True, required=False)]
    problem, remedy = device.problem, device.remedy
    if not problem:
        problem, _ = _outcome(_TRIAL, "cuda")
        remedy = "a newer NVIDIA driver, then try again" if problem else ""
    lacking, said = _outcome(_TORCH_TRIAL)
    lacking = lacking or said
    usable = f"{device.name}: --device cuda"
    return [
        Finding("GPU, tracing", problem or usable, not problem, remedy, required=False),
        Finding("GPU, signals", lacking or usable, not lacking, INSTALL_TORCH if lacking else "", required=False),
    ]


def _llvm() -> Finding:
    # On macOS Metal may do without: whether anything works at all is the variant's line.
    try:
        path, found = find_llvm()
    except InputError as error:
        needed = sys.platform == "linux"
        return Finding("LLVM", str(error), False, "pip install karellen-llvm-core wheel-axle-runtime", required=needed)
    return Finding("LLVM", f"{found} at {path}", True)


def _variant() -> Finding:
    problem, said = _outcome(_TRIAL)
    if problem:
        return Finding("Mitsuba variant", problem, False, "mend LLVM (lines above), then try again")
    return Finding("Mitsuba variant", said, True)


def _outcome(script: str, *arguments: str) -> tuple[str, str]:
    """Why a script failed in an interpreter of its own, "" if it did not, and the last line that it printed."""
    command = [sys.executable, "-c", script, *arguments]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=_TRIAL_SECONDS, check=False)
    except subprocess.TimeoutExpired:
        return f"no answer within {_TRIAL_SECONDS:g} s", ""
    if done.returncode < 0:
        return f"the trial was ended by signal {-done.returncode}", ""
    if done.returncode > 0:
        return (done.stderr.strip().splitlines() or ["no message"])[-1], ""
    return "", (done.stdout.strip().splitlines() or [""])[-1]


def _amount(item: str, found_bytes: int, minimum_gib: float, remedy: str) -> Finding:
    gib = found_bytes / _GIB
    ok = gib >= minimum_gib
    return Finding(item, f"{gib:.1f} GiB", ok, "" if ok else f"at least {minimum_gib:g} GiB: {remedy}", required=False)
