import pytest
from gopxl_scene import tilted_plane
from mbcacq_fakes.protocols.gopxl import FakeGoPxL, FakeGoPxLOptions
from mbcacq_fakes.world.frame import ScannerFrame


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
    return {"address": "127.0.0.1", "control_port": sensor.ports.control}
