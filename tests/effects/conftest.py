"""The independent cell and its recording, shared by the tests of this folder."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))


@pytest.fixture(scope="session")
def world():
    from independent_cell import World

    return World.drawn()


@pytest.fixture(scope="session")
def context(world):
    import recorded

    return recorded.context(world)
