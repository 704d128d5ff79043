"""Threads of numerical libraries do not help here: the suite runs one process a core. And no test is about how busy the machine is."""

import os
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

settings.register_profile("busy", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("busy")

SHARED = Path(__file__).resolve().parents[2] / "shared"  # measured data and facts, beside a checkout; not part of the repository


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder of measured data and facts. Tests that ask for it are skipped where it is missing."""
    if not SHARED.is_dir():
        pytest.skip(f"the measured data are not in {SHARED}")
    return SHARED


@pytest.fixture(scope="session")
def shared_data(shared: Path) -> Path:
    return shared / "data"


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the tests that need data from outside the repository: pytest -m "not shared_data" leaves them out."""
    for item in items:
        if "shared" in getattr(item, "fixturenames", ()):
            item.add_marker(pytest.mark.shared_data)
