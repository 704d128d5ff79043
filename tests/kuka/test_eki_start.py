"""A controller is made ready over EKI, and the wrong robot is never moved."""

import threading

import numpy as np
import pytest
from kuka_bench import HOME_DEG, LIMITS_DEG, arrive, motion_limits
from mbcacq_fakes.cell.ports import free_port
from mbcacq_fakes.protocols.krc.eki import FakeEki
from mbcacq_fakes.protocols.krc.server import FakeKrc
from mbcacq_kuka.rsi.driver import KukaRsi
from mbcacq_kuka.rsi.options import parse

from mbcacq.devices import DeviceFault, IdentityError, same_model


def test_rsi_is_started_over_eki():
    port = free_port()
    krc = FakeKrc(client=("127.0.0.1", port), realtime=False, sen_type="KROSHU", start_deg=tuple(HOME_DEG), limits_deg=LIMITS_DEG)
    starting = threading.Thread(target=krc.start)
    with FakeEki(model="#KR210R2700_2 C4 FLR", on_start=lambda mode, cycle: starting.start()) as eki:
        try:
            with KukaRsi("arm", "KUKA KR 210 R2700-2", {"limits_deg": LIMITS_DEG, "port": port, "eki": f"127.0.0.1:{eki.port}"}) as robot:
                target = np.radians(HOME_DEG + [2.0, 0, 0, 0, 0, 0])
                robot.move_to(target, motion_limits())
                np.testing.assert_allclose(arrive(robot).q, target, atol=2e-4)
        finally:
            if starting.ident is not None:
                starting.join()
            krc.stop()
    assert eki.requests == [(0, -1, -1), (6, -1, -1), (8, -1, 1), (4, 1, -1), (1, -1, -1)]


def test_what_kukas_program_is_configured_for_is_the_default():
    plain = parse("arm", {"limits_deg": LIMITS_DEG})
    started = parse("arm", {"limits_deg": LIMITS_DEG, "eki": "172.31.1.147"})
    chosen = parse("arm", {"limits_deg": LIMITS_DEG, "eki": "172.31.1.147", "sen_type": "Mine", "port": 50000})
    assert [(o.sen_type, o.port) for o in (plain, started, chosen)] == [("ImFree", 49152), ("KROSHU", 59152), ("Mine", 50000)]


def test_another_robot_is_not_started():
    with FakeEki(model="#KR6R900_2 C5") as eki:
        robot = KukaRsi("arm", "KR 210 R2700-2", {"limits_deg": LIMITS_DEG, "port": free_port(), "eki": f"127.0.0.1:{eki.port}"})
        with pytest.raises(IdentityError, match="drives a '#KR6R900_2 C5', the plan is for 'KR 210 R2700-2'"):
            robot.connect()
    assert [r[0] for r in eki.requests] == [0]


def test_an_emergency_stop_is_named():
    with FakeEki() as eki:
        eki.emergency_stop = True
        robot = KukaRsi("arm", "", {"limits_deg": LIMITS_DEG, "port": free_port(), "eki": f"127.0.0.1:{eki.port}"})
        with pytest.raises(DeviceFault, match="emergency stop"):
            robot.connect()


@pytest.mark.parametrize(
    ("wanted", "reported", "same"),
    [
        ("kr210_r2700_2", "#KR210R2700_2 C4 FLR", True),
        ("KUKA KR 16 R2010-2", "#KR16R2010_2 C4 FLR", True),
        ("KR 16-2", "#KR16_2 C2", True),
        ("KR 210 R2700-2", "#KR210R3100_2 C4 FLR", False),
        ("KR 6 R900-2", "#KR6R700_2 C5", False),
        ("KR 10", "KR 1000 titan", False),
        ("KR 10", "#KR10R1100_2 C5", True),
    ],
)
def test_model_names(wanted, reported, same):
    assert same_model(wanted, reported) is same
