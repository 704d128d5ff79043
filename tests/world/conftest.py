import numpy as np
import pytest
from mbcacq_fakes.world.arm import paper_errors
from mbcacq_fakes.world.world import Deviations
from small_cell import facts


@pytest.fixture(scope="session")
def cell_facts():
    return facts()


@pytest.fixture
def deviations():
    return Deviations(paper_errors(), np.full(6, 5e-6))
