import pytest
from gopxl_scene import VOLUME, tilted_plane
from mbcacq_fakes.protocols.gopxl import FakeGoPxL, FakeGoPxLOptions
from mbcacq_fakes.world.frame import ScannerFrame


@pytest.fixture
def sensor():
    """The first scan of a driver is exposed twice: its second exposure is plane 1."""
    asked = []

    def source(exposure_us: float) -> ScannerFrame:
        asked.append(exposure_us)
        return tilted_plane(len(asked) - 1)

    with FakeGoPxL(source, FakeGoPxLOptions(discovery_port=0, volume=VOLUME)) as fake:
        fake.asked = asked
        yield fake


@pytest.fixture
def options(sensor):
    return {"address": "127.0.0.1", "control_port": sensor.ports.control}
