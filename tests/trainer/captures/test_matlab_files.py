"""Complex arrays of MATLAB files, held against SciPy, which writes and reads them too."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
import scipy.io

from shared.physics.errors import InputError
from trainer.captures.matlab_files import read_complex_arrays


@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (86, 1), (3, 4, 5), (1, 0)])
@pytest.mark.parametrize("dtype", [np.complex64, np.complex128])
def test_arrays_are_those_that_scipy_wrote(tmp_path: Path, packed: bool, shape: tuple[int, ...], dtype: type) -> None:
    generator = np.random.default_rng(1)
    values = (generator.standard_normal((*shape, 2)) @ np.array([1.0, 1.0j])).astype(dtype)
    others = {"real": np.arange(5.0), "text": "a name", "cell": np.array([1, "b"], object), "record": {"x": 1j}}
    scipy.io.savemat(tmp_path / "a.mat", {**others, "z": values}, do_compression=packed)
    if not values.size:
        return
    found = read_complex_arrays(tmp_path / "a.mat")
    assert list(found) == ["z"]
    np.testing.assert_array_equal(found["z"], values)


def test_whole_numbers_stored_shortly_and_the_other_order_of_bytes_are_read(tmp_path: Path) -> None:
    """As MATLAB stores what fits into a byte; by hand from the format's description."""

    def element(kind: int, data: bytes) -> bytes:
        return struct.pack(">II", kind, len(data)) + data + bytes(-len(data) % 8)

    flags, lengths = element(6, struct.pack(">II", 0x0806, 0)), element(5, struct.pack(">ii", 1, 3))
    name = struct.pack(">HH4s", 1, 1, b"z")
    parts = element(2, bytes([1, 2, 3])) + struct.pack(">HH4s", 3, 1, bytes([255, 4, 5]))
    header = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x01\x00MI"
    (tmp_path / "b.mat").write_bytes(header + element(14, flags + lengths + name + parts))
    np.testing.assert_array_equal(read_complex_arrays(tmp_path / "b.mat")["z"], [[1 - 1j, 2 + 4j, 3 + 5j]])


def test_a_file_that_was_cut_short_is_refused(tmp_path: Path) -> None:
    for packed in (False, True):
        scipy.io.savemat(tmp_path / "c.mat", {"z": np.ones(40, complex)}, do_compression=packed)
        content = (tmp_path / "c.mat").read_bytes()
        for size in (0, 100, 128 + 4, 160, len(content) - 9):
            (tmp_path / "c.mat").write_bytes(content[:size])
            with pytest.raises(InputError, match=r"c\.mat: not readable"):
                read_complex_arrays(tmp_path / "c.mat")
