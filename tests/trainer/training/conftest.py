"""What the tests of training share."""

from __future__ import annotations

from pathlib import Path

import pytest
from tiny_radar import small_dataset


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return small_dataset(tmp_path_factory.mktemp("fit") / "data")
