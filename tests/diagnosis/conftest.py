"""A simulated plan that makes every effect observable, shared by the tests of this folder."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))


@pytest.fixture(scope="session")
def plan():
    import simulated

    return simulated.plan()
