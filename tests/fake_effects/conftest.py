import pytest
from elastic_cell import looking


@pytest.fixture(scope="session")
def looking_q():
    return looking(30)
