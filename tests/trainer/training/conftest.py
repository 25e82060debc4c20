"""What the tests of training share."""

from pathlib import Path

import pytest
from tiny_radar import small_dataset
from tiny_run import run


@pytest.fixture(scope="session")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return small_dataset(tmp_path_factory.mktemp("fit") / "data")


@pytest.fixture(scope="session")
def ordinary(dataset: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a run of TINY on the dataset; nobody writes into it."""
    folder = tmp_path_factory.mktemp("ordinary") / "first"
    run(dataset, folder)
    return folder
