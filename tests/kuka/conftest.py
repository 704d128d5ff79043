"""A fake controller and a driver in front of it, on a port of their own."""

import pytest
from eki_bench import DH, EKI_LIMITS_DEG, SPEED_DEG_S, START_DEG, settings
from kuka_bench import HOME_DEG, LIMITS_DEG
from mbcacq_fakes.cell.ports import free_port
from mbcacq_fakes.protocols.krc.server import FakeEkiController, FakeKrc
from mbcacq_kuka.eki.driver import KukaEki
from mbcacq_kuka.rsi.driver import KukaRsi

PATIENT = {"silence_s": 20.0, "connect_timeout_s": 20.0}  # a busy computer may give a fake no turn for seconds


@pytest.fixture
def cell():
    """cell(krc={...}, robot={...}) -> (krc, robot), running; everything is closed afterwards."""
    opened = []

    def start(krc=None, robot=None):
        port = free_port()
        fake = FakeKrc(
            **{"client": ("127.0.0.1", port), "realtime": False, "limits_deg": LIMITS_DEG, "start_deg": tuple(HOME_DEG), **(krc or {})}
        )
        driver = KukaRsi("arm", "test", {"limits_deg": LIMITS_DEG, "port": port, **PATIENT, **(robot or {})})
        opened.extend([fake.start(), driver])
        driver.connect()
        return fake, driver

    yield start
    for device in reversed(opened):
        device.stop() if isinstance(device, FakeKrc) else device.close()


@pytest.fixture
def eki_cell():
    """eki_cell(system, controller={...}, robot={...}, connect=True) -> (controller, driver); everything is closed afterwards."""
    opened = []

    def start(system="kss", controller=None, robot=None, connect=True):
        given = settings(system, **{"start_deg": START_DEG, "realtime": False, **(controller or {})}).to_json()
        fake = FakeEkiController(**given)
        opened.append(fake.stop)
        fake.start()
        options = {
            "address": "127.0.0.1",
            "port": fake.port,
            "limits_deg": EKI_LIMITS_DEG,
            "speed_deg_s": SPEED_DEG_S,
            "kinematics": DH,
            **PATIENT,
            "reconnect_s": 30.0,
            **(robot or {}),
        }
        driver = KukaEki("arm", "KR 10 R1100-2", options)
        opened.append(driver.close)
        if connect:
            driver.connect()
        return fake, driver

    yield start
    for close in reversed(opened):
        close()
