"""What tests of plans depend on."""

import pytest


@pytest.fixture(scope="module")
def one_thread(variant: str) -> None:
    from datafactory.paths.backend import set_threads

    set_threads(1)
