"""A measured snapshot: what is known of one, what is read, what is refused."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.io
from small_evaluation import REFERENCE

from shared.physics.errors import InputError
from trainer.estimators.das import DelayAndSum
from trainer.evaluation.experiments.measured import look_at, reference_lines
from trainer.evaluation.experiments.measured_input import half_wavelength_line, read_measured, read_snapshot
from trainer.metrics.peaks import strongest_peaks


def test_a_measured_pair_is_found_where_it_stands(evaluation):
    rows = {
        (row["method"], row["array"], row["metric"]): row["value"]
        for row in evaluation[0].to_pylist()
        if row["experiment"] == "measured"
    }
    assert rows["ml", "reference", "angle 1 [deg]"] == pytest.approx(-4.0, abs=0.1)
    assert rows["ml", "reference", "angle 2 [deg]"] == pytest.approx(5.0, abs=0.1)
    assert rows["iaa", "all 40", "both within 1 deg"] == 1.0
    assert ("das", "thin of 8", "angle 1 [deg]") in rows


@pytest.mark.skipif(not REFERENCE.is_dir(), reason="the reference data's measured snapshot is not beside the checkout")
def test_the_real_snapshot_shows_what_is_known_of_it():
    """Numbers of the README beside the file: two-source ML -0.006 and 6.985 degrees on all 86 elements."""
    measured = read_snapshot(REFERENCE / "realData_demo.mat")
    assert len(measured) == 86
    known = read_measured(REFERENCE / "realData_demo.mat", targets=2)
    np.testing.assert_allclose(np.rad2deg(np.arcsin(reference_lines(known)[0])), [-0.006, 6.985], atol=2e-3)
    axis = np.sin(np.deg2rad(np.arange(-20.0, 20.0, 0.02)))
    line = half_wavelength_line(np.arange(48))
    image = DelayAndSum().image(measured[None, :48], line, axis, 0.0)
    np.testing.assert_allclose(np.rad2deg(np.arcsin(strongest_peaks(image, axis, 2)[0])), [-0.08, 7.00], atol=0.03)


@pytest.mark.skipif(not REFERENCE.is_dir(), reason="the reference data's measured snapshot is not beside the checkout")
def test_every_method_on_the_real_snapshot_has_the_stated_angles():
    """10 elements, smoothed MUSIC of two targets: -0.16 and 6.68 degrees; every method on all 86: the reference."""
    known = read_measured(REFERENCE / "realData_demo.mat", targets=2)
    everything = known.elements
    chosen = replace(known, elements={name: everything[name] for name in ("all 86", "first 10")})
    angles = {(row.method, row.array, row.metric): row.value for row in look_at(chosen).rows}
    for metric, ten, reference in (("angle 1 [deg]", -0.16, -0.006), ("angle 2 [deg]", 6.68, 6.985)):
        assert angles["music-fbss", "first 10", metric] == pytest.approx(ten, abs=0.02)
        for method in {method for method, array, _ in angles if array == "all 86"}:
            # A line stands in a bin of 0.03 degrees; the grid of omp and the widest main lobes are no finer than this.
            assert angles[method, "all 86", metric] == pytest.approx(reference, abs=0.08), method


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.npy", np.ones(40), "complex vectors"),
        ("a.npy", np.ones((3, 3), complex), "complex vectors"),
        ("a.npy", np.ones(4, complex), "4 elements; expected more than 4"),
        ("a.npy", np.full(40, np.nan + 0j), "40 elements; expected more than 4 finite"),
        ("a.npy", b"no array", "not readable"),
        ("a.mat", {"x": np.ones(40, complex), "y": np.ones(40, complex)}, "complex vectors"),
        ("a.mat", b"MATLAB 7.3 MAT-file, which is HDF5" + bytes(200), "not readable"),
        ("a.txt", b"1+2j", "a .mat or .npy file"),
    ],
)
def test_a_snapshot_that_is_none_is_refused(tmp_path, name, content, message):
    path = tmp_path / name
    if isinstance(content, bytes):
        path.write_bytes(content)
    elif isinstance(content, dict):
        scipy.io.savemat(path, content)
    else:
        np.save(path, content)
    with pytest.raises(InputError, match=message):
        read_snapshot(path)
