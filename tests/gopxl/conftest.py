import numpy as np
import pytest
from mbcacq_fakes.protocols.gopxl import FakeGoPxL, FakeGoPxLOptions
from mbcacq_fakes.world.frame import ScannerFrame


def tilted_plane(number: int = 0) -> ScannerFrame:
    """20 x 12 points with a hole, another height for every number."""
    y, x = np.mgrid[:12, :20].astype(np.float32)
    xyz = np.stack([x * 0.5 - 4, y * 0.5 - 3, 20 + 0.1 * x - 0.05 * y + 0.5 * number], axis=2)
    xyz[3:6, 7:11] = np.nan
    return ScannerFrame(xyz, (10 * y + x).astype(np.uint8), measurements={1: 12.5})


@pytest.fixture
def sensor():
    asked = []

    def source(exposure_us: float) -> ScannerFrame:
        asked.append(exposure_us)
        return tilted_plane(len(asked))

    with FakeGoPxL(source, FakeGoPxLOptions(discovery_port=0)) as fake:
        fake.asked = asked
        yield fake


@pytest.fixture
def options(sensor):
    return {"address": "127.0.0.1", "control_port": sensor.ports.control, "retries": 1}
