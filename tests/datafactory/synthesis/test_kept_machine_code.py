"""Kernels give the same bytes just compiled and from the disk, whatever of them was compiled or loaded before."""

from pathlib import Path

import pytest
from manual import ROOT
from processes import python

KERNELS = ("chirp", "along_lines", "truth", "seen", "near_field", "plates", "line_fit")


def digests(folder: Path, *arguments: str) -> dict[str, str]:
    """Digest by kernel, of a process that keeps its machine code in ``folder``."""
    said = python(ROOT / "tests/kernel_bytes.py", *arguments, NUMBA_CACHE_DIR=str(folder))
    return dict(line.split() for line in said.splitlines())


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("kept")


@pytest.fixture(scope="module")
def just_compiled(kept: Path) -> dict[str, str]:
    assert not any(kept.iterdir())
    return digests(kept)


def code_of(kernel: str, folder: Path) -> list[Path]:
    return sorted(folder.rglob(f"*.{kernel}-*.nb?"))


def test_code_just_compiled_and_code_that_was_kept_give_the_same_bytes(kept, just_compiled):
    assert tuple(just_compiled) == KERNELS
    before = code_of("add_doppler_moments", kept)
    assert before
    assert digests(kept) == just_compiled
    assert code_of("add_doppler_moments", kept) == before


@pytest.mark.parametrize("outer_kept", [True, False])
def test_a_function_that_was_compiled_by_itself_changes_no_kernel_that_it_is_a_part_of(kept, just_compiled, outer_kept):
    if not outer_kept:
        for path in code_of("add_doppler_moments", kept):
            path.unlink()
    assert digests(kept, "--inner-first", "truth") == {"truth": just_compiled["truth"]}
