"""The choice of the Mitsuba variant and of libLLVM, with fake libraries and without initialising Dr.Jit."""

import re
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from processes import python

from datafactory.paths import backend
from shared.physics.errors import InputError


@pytest.fixture(autouse=True)
def unset_variable(monkeypatch):
    """No library given, and whatever a test sets is undone: deleting an absent variable alone would restore nothing."""
    monkeypatch.setenv(backend.LLVM_VARIABLE, "")
    monkeypatch.delenv(backend.LLVM_VARIABLE)


def fake_library(folder, name):
    path = folder / name
    path.write_bytes(b"not a library")
    return path


@pytest.mark.parametrize(
    ("name", "version"),
    [
        ("libLLVM-15.so.1", "15"),
        ("libLLVM-15.0.6.so", "15.0.6"),
        ("libLLVM.so.23.1", "23.1"),
        ("libLLVM-19.dylib", "19"),
    ],
)
def test_version_is_read_off_the_name(tmp_path, name, version):
    assert backend.llvm_version(fake_library(tmp_path, name)) == version


def test_version_is_read_off_the_file_that_a_link_names(tmp_path):
    fake_library(tmp_path, "libLLVM.so.21.1")
    (tmp_path / "libLLVM.so").symlink_to("libLLVM.so.21.1")
    assert backend.llvm_version(tmp_path / "libLLVM.so") == "21.1"


def test_a_library_says_of_itself_what_its_name_says():
    """The subprocess's answer, which counts where a name has no version, against the name of a real library."""
    try:
        path, version = backend.find_llvm()
    except InputError as error:
        pytest.skip(f"this machine has no libLLVM: {error}")
    asked = backend._script_output(backend._LLVM_PROBE, str(path))
    assert asked is not None
    assert asked.split(".")[0] == version.split(".")[0]


@pytest.mark.parametrize(
    ("name", "device", "message"),
    [
        ("libLLVM-15.so.1", None, "DRJIT_LIBLLVM_PATH: found 15 at .*expected LLVM 17 or newer"),
        ("libLLVM-16.so", None, "DRJIT_LIBLLVM_PATH: found 16 at .*expected LLVM 17 or newer"),
        ("none", None, "DRJIT_LIBLLVM_PATH: no file"),
        ("libLLVM-20.so", None, r"mitsuba: .* cannot be loaded: .*expected pip install mitsuba"),
        ("libLLVM-20.so", "gpu", "--device: 'gpu'; expected one of cpu, cuda"),
    ],
)
def test_what_cannot_be_loaded_or_asked_for_is_refused_in_one_line(tmp_path, monkeypatch, name, device, message):
    path = tmp_path / name if name == "none" else fake_library(tmp_path, name)
    monkeypatch.setenv(backend.LLVM_VARIABLE, str(path))
    monkeypatch.setitem(sys.modules, "mitsuba", None)
    with pytest.raises(InputError, match=message):
        backend.select_variant(*([device] if device else []))


def test_no_library_at_all_is_refused(monkeypatch):
    monkeypatch.setattr(backend, "_candidates", lambda: iter(()))
    with pytest.raises(InputError, match="LLVM: no libLLVM was found; expected LLVM 17 or newer"):
        backend.find_llvm()


def test_an_old_library_is_passed_over_for_a_newer_one(tmp_path, monkeypatch):
    files = [fake_library(tmp_path, "libLLVM-15.so.1"), fake_library(tmp_path, "libLLVM.so.19.1")]
    monkeypatch.setattr(backend, "_candidates", lambda: iter(files))
    assert backend.find_llvm() == (files[1], "19.1")


def test_this_environments_library_goes_before_the_systems(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "prefix", str(tmp_path))
    (tmp_path / "lib").mkdir()
    ours = fake_library(tmp_path / "lib", "libLLVM.so.23.1")
    assert backend.find_llvm() == (ours, "23.1")


class FakeMitsuba(SimpleNamespace):
    """Keeps the variant that is set, as the real module does."""

    current: str | None = None

    def variant(self):
        return self.current

    def set_variant(self, name):
        self.current = name


def test_llvm_is_chosen_and_its_path_set_before_mitsuba_is_asked(tmp_path, monkeypatch):
    library = fake_library(tmp_path, "libLLVM.so.22.1")
    monkeypatch.setattr(backend, "_candidates", lambda: iter([library]))
    monkeypatch.setattr(sys, "platform", "linux")
    seen = []

    class Watching(FakeMitsuba):
        def set_variant(self, name):
            seen.append((name, backend.os.environ.get(backend.LLVM_VARIABLE)))
            super().set_variant(name)

    monkeypatch.setitem(sys.modules, "mitsuba", Watching())
    assert backend.select_variant() == backend.LLVM_VARIANT
    assert backend.select_variant() == backend.LLVM_VARIANT
    assert seen == [(backend.LLVM_VARIANT, str(library))]


USABLE = backend.CudaDevice("a GPU")


@pytest.fixture
def with_gpu(tmp_path, monkeypatch):
    """Linux with a GPU, and with LLVM."""
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setenv(backend.LLVM_VARIABLE, str(fake_library(tmp_path, "libLLVM-20.so")))
    monkeypatch.setattr(backend, "cuda_device", lambda: USABLE)
    monkeypatch.setitem(sys.modules, "mitsuba", FakeMitsuba())


def test_cuda_is_chosen_where_it_is_asked_for_and_needs_no_llvm(monkeypatch, with_gpu):
    monkeypatch.setattr(backend, "find_llvm", lambda: pytest.fail("LLVM is not needed with CUDA"))
    assert backend.select_variant("cuda") == backend.CUDA_VARIANT
    assert backend.select_variant() == backend.CUDA_VARIANT, "the process keeps its device"
    assert not backend.traces_on_the_processor()


def test_the_processor_is_chosen_where_nothing_is_asked_for(with_gpu):
    # The same command gives the same bytes on a machine with a GPU as on one without.
    assert backend.select_variant() == backend.LLVM_VARIANT
    assert backend.traces_on_the_processor()


@pytest.mark.parametrize(("first", "then"), [("cpu", "cuda"), ("cuda", "cpu")])
def test_a_process_does_not_change_its_device(with_gpu, first, then):
    variant = backend.select_variant(first)
    assert backend.select_variant(first) == variant
    with pytest.raises(InputError, match=f"--device: {then}, where this process traces with {variant}"):
        backend.select_variant(then)


@pytest.mark.parametrize(
    ("said", "name", "problem"),
    [
        ("driver", "", "there is no NVIDIA driver"),
        ("device", "", "finds no device"),
        ("optix\nNVIDIA H100", "NVIDIA H100", "without OptiX"),
        ("usable\nNVIDIA H100", "NVIDIA H100", ""),
        (None, "", "finds no device"),  # the driver ended the probe
    ],
)
def test_what_the_driver_says_of_its_device(monkeypatch, said, name, problem):
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setattr(backend, "_script_output", lambda script: said)
    backend.cuda_device.cache_clear()
    try:
        found = backend.cuda_device()
    finally:
        backend.cuda_device.cache_clear()
    assert found.name == name
    assert problem in found.problem
    assert bool(problem) == bool(found.problem) == bool(found.remedy)
    monkeypatch.setattr(backend, "cuda_device", lambda: found)
    monkeypatch.setitem(sys.modules, "mitsuba", FakeMitsuba())
    if problem:
        with pytest.raises(InputError, match=f"--device: cuda: .*{problem}"):
            backend.select_variant("cuda")
    else:
        assert backend.select_variant("cuda") == backend.CUDA_VARIANT


def test_no_other_module_names_a_variant_or_a_type_of_one_back_end():
    """What a module computes with follows the variant that is set: ``mi.Float`` of Mitsuba, no ``drjit.llvm``."""
    root = Path(backend.__file__).parents[1]
    named = re.compile(
        r"(llvm|cuda|metal|scalar)_(ad_)?(mono|rgb|spectral)|drjit\.(llvm|cuda|scalar)|\bdr\.(llvm|cuda)\b"
    )
    guilty = [path for path in sorted(root.rglob("*.py")) if named.search(path.read_text())]
    assert guilty == [Path(backend.__file__)]


def test_a_probe_that_crashes_or_fails_harms_nothing():
    assert backend._script_output("import os; os.abort()") is None
    assert backend._script_output("raise SystemExit(3)") is None
    assert backend._script_output("import sys; print(sys.argv[1])", "word") == "word"


def test_sionna_keeps_the_chosen_variant():
    """In a process of its own, for the variant is global: select, then import Sionna, then compute."""
    script = (
        "from datafactory.paths.backend import select_variant, set_threads, VARIANTS\n"
        "set_threads(1)\n"  # Dr.Jit loads an LLVM with its first thread: set_threads chooses the library too
        "chosen = select_variant()\n"
        "import drjit, mitsuba, sionna.rt\n"
        "assert mitsuba.variant() == chosen and chosen in VARIANTS, mitsuba.variant()\n"
        "assert drjit.thread_count() == 1\n"
        "print(int(drjit.sum(drjit.arange(mitsuba.UInt32, 8))[0]))\n"
    )
    assert python("-c", script).strip() == "28"
