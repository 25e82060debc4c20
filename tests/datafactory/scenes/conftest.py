"""Ground of towns, made once for all tests of scenes."""

import pytest
from town_scenes import BARE, ROAD, TOWN

from datafactory.scenes.ground import Ground, free_ground
from datafactory.scenes.scene import Scene


@pytest.fixture(scope="session")
def street() -> Ground:
    """Between houses, without anything on it."""
    return free_ground(BARE)


@pytest.fixture(scope="session")
def road() -> Ground:
    """The same with a street that is called so."""
    return free_ground(Scene("with road", (*BARE.objects, ROAD)))


@pytest.fixture(scope="session")
def town() -> Ground:
    return free_ground(TOWN)
