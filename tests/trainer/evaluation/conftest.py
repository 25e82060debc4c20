"""One evaluation of all experiments for the tests that look at it."""

import numpy as np
import pytest
from small_evaluation import make_data, make_run, run_all

from shared.dataset.folder import open_dataset
from trainer.evaluation.experiments.measured_input import half_wavelength_line
from trainer.run.folder import Fingerprint


@pytest.fixture(scope="session")
def inputs(tmp_path_factory):
    """(dataset, run, array file, measured snapshot)."""
    folder = tmp_path_factory.mktemp("inputs")
    data = make_data(folder / "data")
    fingerprint = Fingerprint.of(data, open_dataset(data).records, {})
    run = make_run(folder / "run", datasets=(fingerprint,))
    (folder / "thin.toml").write_text("rx = [0, 1, 2, 5]\n")
    generator = np.random.default_rng(5)
    line = half_wavelength_line(np.arange(40))
    noise = 0.03 * (generator.standard_normal((40, 2)) @ np.array([1.0, 1.0j]))
    np.save(folder / "pair.npy", line.manifold(np.sin(np.deg2rad([-4.0, 5.0]))) @ np.array([1.0, 0.8j]) + noise)
    return data, run, folder / "thin.toml", folder / "pair.npy"


@pytest.fixture(scope="session")
def evaluation(inputs, tmp_path_factory):
    out = tmp_path_factory.mktemp("evaluation") / "out"
    return run_all(inputs, out), out
