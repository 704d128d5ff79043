"""Everything that goes wrong has a name, and ends with an arm that stands still."""

import socket
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
from kuka_bench import HOME_DEG, LIMITS_DEG, arrive, motion_limits, until_error, wait
from mbcacq_fakes.cell.ports import free_port
from mbcacq_fakes.protocols.krc.server import FakeKrc
from mbcacq_kuka.rsi.driver import KukaRsi

from mbcacq.devices import ConfigError, ConnectError, DeviceFault, DeviceTimeout, MbcacqError, ProtocolError, SafetyStop

FAR = np.radians(HOME_DEG + [150.0, 0.0, 0.0, 0.0, 0.0, 0.0])


def on_the_way(robot):
    robot.move_to(FAR, motion_limits(speed=20.0))
    wait(lambda: np.degrees(robot.state().q[0]) > 5.0)


def stands(krc):
    wait(lambda: krc.state.read().standstill)
    before = krc.state.read().q
    time.sleep(0.05)
    return np.allclose(krc.state.read().q, before, rtol=0, atol=1e-7) and np.degrees(before[0]) < 149.0


@pytest.mark.parametrize(
    ("fault", "kind", "text"),
    [
        ({"silence": 1}, DeviceTimeout, "no telegram for"),
        ({"stop": 1}, DeviceTimeout, "no telegram for"),
        ({"delay_ms": 5}, DeviceFault, "as late or invalid"),
        ({"drop_answers": 1}, DeviceFault, "as late or invalid"),
        ({"ignore": 1}, SafetyStop, "A1 does not follow"),
        ({"malformed": 1}, ProtocolError, "malformed telegram"),
        ({"no_aipos": 1}, ProtocolError, "without AIPos"),
        ({"wrong_ipoc": 1}, ProtocolError, "IPOC went from"),
        ({"jump": 1}, SafetyStop, "A1 jumped by 30."),
    ],
)
def test_a_fault_on_the_way_stops_the_arm(cell, fault, kind, text):
    krc, robot = cell(robot={"silence_s": 1.5} if text == "no telegram for" else {})
    on_the_way(robot)
    krc.inject(**fault)
    error = until_error(robot)
    assert type(error) is kind
    assert text in str(error)
    assert stands(krc)
    with pytest.raises(kind):
        robot.move_to(np.radians(HOME_DEG), motion_limits())
    assert len(robot.cycles()) > 0
    robot.stop()
    robot.close()


@pytest.mark.parametrize("fault", [{"drop": 0.03}, {"drop_answers": 0.03}])
def test_a_few_lost_packets_are_survived_and_never_make_the_arm_jump(cell, fault):
    krc, robot = cell({"log": True, "faults": {}, "speed_deg_s": (95.0,) * 6}, {"late_limit": 99})
    krc.inject(**fault)
    robot.move_to(np.radians(HOME_DEG + [30.0, 0, 0, 0, 0, 0]), motion_limits())
    arrive(robot)
    assert krc.report()["late"] > 3
    assert krc.report()["sessions"] == 1


def test_a_telegram_from_another_port_is_dropped(cell):
    krc, robot = cell()
    krc.inject(foreign=2)
    robot.move_to(np.radians(HOME_DEG + [3.0, 0, 0, 0, 0, 0]), motion_limits())
    arrive(robot)
    columns = robot.cycles().columns
    assert columns["lost_telegrams"][-1] >= 2


@pytest.mark.parametrize("quirk", [{"swap": 1}, {"spaced": 1}, {"upper_type": 1}, {"swap": 1, "spaced": 1, "upper_type": 1}])
def test_quirks_are_no_faults(cell, quirk):
    krc, robot = cell()
    krc.inject(**quirk)
    target = np.radians(HOME_DEG + [3.0, 1.0, 0, 0, 0, 0])
    robot.move_to(target, motion_limits())
    np.testing.assert_allclose(arrive(robot).q, target, atol=2e-4)


def test_a_clamped_correction_stops_the_arm(cell):
    krc, robot = cell({"clamp_deg": 15.0})
    robot.move_to(FAR, motion_limits())
    error = until_error(robot)
    assert type(error) is SafetyStop
    assert "A1 does not follow" in str(error)
    assert stands(krc)
    assert np.degrees(krc.state.read().q[0]) == pytest.approx(15.0, abs=1e-5)


def test_the_correction_monitor_of_the_controller_ends_the_run(cell):
    krc, robot = cell({"monitor_deg": 20.0, "rearm_s": 600.0}, {"silence_s": 1.5})
    robot.move_to(FAR, motion_limits())
    assert type(until_error(robot)) is DeviceTimeout
    assert krc.state.read().fault == "permissible overall correction exceeded"
    assert stands(krc)


def test_a_controller_slower_than_the_plan_ends_the_run(cell):
    krc, robot = cell({"speed_deg_s": (30.0,) * 6, "rearm_s": 600.0}, {"silence_s": 1.5})
    robot.move_to(FAR, motion_limits())
    assert type(until_error(robot)) is DeviceTimeout
    assert krc.state.read().fault == "overspeed: command velocity"


def test_a_wrong_sen_type_is_found(cell):
    port = free_port()
    with FakeKrc(client=("127.0.0.1", port), realtime=False) as krc:
        robot = KukaRsi("arm", "", {"limits_deg": LIMITS_DEG, "port": port, "sen_type": "Other"})
        with pytest.raises(ConnectError, match=r"discards every answer .* sen_type 'Other'"):
            robot.connect()
        assert krc.report()["answers"] == 0


def test_a_wrong_name_of_the_correction_is_found(cell):
    krc, robot = cell({"correction": "AKorr"})
    robot.move_to(FAR, motion_limits())
    error = until_error(robot)
    assert type(error) is SafetyStop
    assert "no axis has moved at all" in str(error)
    assert "correction 'AK'" in str(error)


def test_a_few_telegrams_and_then_silence_are_no_firewall():
    port = free_port()
    robot = KukaRsi("arm", "", {"limits_deg": LIMITS_DEG, "port": port, "connect_timeout_s": 1.0})

    def one_telegram():
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
            sock.settimeout(20.0)
            sock.connect(("127.0.0.1", port))
            for _ in range(10_000):  # until somebody listens there: before, the system says so
                try:
                    sock.send(b'<Rob Type="KUKA"><AIPos A1="0" A2="0" A3="0" A4="0" A5="0" A6="0"/><IPOC>4</IPOC></Rob>')
                    sock.recv(2048)
                    return
                except ConnectionRefusedError:
                    time.sleep(0.005)

    sender = threading.Thread(target=one_telegram)
    sender.start()
    with pytest.raises(ConnectError, match=r"came from 127\.0\.0\.1:\d+ .* and then none.* smartPAD") as caught:
        robot.connect()
    sender.join()
    assert "firewall" not in str(caught.value)


def test_nobody_there():
    robot = KukaRsi("arm", "", {"limits_deg": LIMITS_DEG, "port": free_port(), "connect_timeout_s": 0.2})
    with pytest.raises(ConnectError, match=r"start the RSI program .* firewall"):
        robot.connect()
    robot.stop()
    robot.close()


def test_the_port_is_taken():
    port = free_port()
    with FakeKrc(client=("127.0.0.1", port)), KukaRsi("arm", "", {"limits_deg": LIMITS_DEG, "port": port}):
        second = KukaRsi("arm", "", {"limits_deg": LIMITS_DEG, "port": port})
        with pytest.raises(ConnectError, match=f"cannot listen on 127.0.0.1:{port}"):
            second.connect()


def test_a_controller_with_another_cycle():
    port = free_port()
    with FakeKrc(client=("127.0.0.1", port), cycle_ms=12):
        robot = KukaRsi("arm", "", {"limits_deg": LIMITS_DEG, "port": port})
        with pytest.raises(ProtocolError, match="IPOC advances by 12 a telegram, expected 4"):
            robot.connect()


def test_a_configuration_without_joint_angles():
    port = free_port()
    with FakeKrc(client=("127.0.0.1", port), layout=("RIst", "Delay")):
        robot = KukaRsi("arm", "", {"limits_deg": LIMITS_DEG, "port": port})
        with pytest.raises(ProtocolError, match="add DEF_AIPos to the SEND section"):
            robot.connect()


def test_a_driver_that_died_leaves_a_correction_and_the_next_one_refuses_to_jump():
    port = free_port()
    options = {"limits_deg": LIMITS_DEG, "port": port}
    with FakeKrc(client=("127.0.0.1", port), realtime=False, timeout=100000, start_deg=tuple(HOME_DEG), limits_deg=LIMITS_DEG) as krc:
        robot = KukaRsi("arm", "", options | {"stop_at_close": False})
        robot.connect()
        robot.move_to(np.radians(HOME_DEG + [5.0, 0, 0, 0, 0, 0]), motion_limits())
        arrive(robot)
        robot.close()
        second = KukaRsi("arm", "", options)
        with pytest.raises(ConnectError, match=r"AIPos and ASPos differ by 5.00°"):
            second.connect()
        assert np.degrees(krc.state.read().q[0]) == pytest.approx(5.0)


def test_the_program_dies_and_the_arm_is_braked():
    port = free_port()
    program = f"""
import os, time, numpy as np
from mbcacq.devices import MotionLimits
from mbcacq_kuka.rsi.driver import KukaRsi
robot = KukaRsi("arm", "", {{"limits_deg": {LIMITS_DEG!r}, "port": {port}}})
robot.connect()
robot.move_to(np.array({FAR.tolist()!r}), MotionLimits(*(np.radians(np.full(6, v)) for v in (20.0, 200.0, 2000.0))))
while np.degrees(robot.state().q[0]) < 5.0:
    time.sleep(0.001)
os._exit(9)
"""
    with FakeKrc(client=("127.0.0.1", port), realtime=False, start_deg=tuple(HOME_DEG), limits_deg=LIMITS_DEG, log=True) as krc:
        assert subprocess.run([sys.executable, "-c", program], timeout=900).returncode == 9
        wait(lambda: krc.report()["sessions"] >= 2)
        assert krc.state.read().standstill
        assert 5.0 < np.degrees(krc.state.read().q[0]) < 145.0
        log = krc.log()
        moving = log["q"][log["ipoc"] <= log["ipoc"][log["accepted"]][-1]]
        assert np.abs(np.diff(moving, 2, axis=0)).max() / 0.004**2 < 210.0  # braked, not dropped: within the acceleration limit


def test_the_cycle_process_dies(cell):
    krc, robot = cell()
    on_the_way(robot)
    robot._process._process.kill()
    error = until_error(robot)
    assert type(error) is DeviceFault
    assert "ended unexpectedly" in str(error)
    assert stands(krc)


def test_not_connected():
    robot = KukaRsi("arm", "", {"limits_deg": LIMITS_DEG})
    assert robot.describe().kind == "robot"
    assert not robot.describe().verified_on_hardware
    robot.stop()
    assert len(robot.cycles()) == 0
    with pytest.raises(ConnectError, match="call connect first"):
        robot.state()
    with pytest.raises(MbcacqError):
        robot.move_to(FAR, motion_limits())
    robot.close()


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({}, "limits_deg"),
        ({"limits_deg": [[0, 1]]}, "limits_deg"),
        ({"limits_deg": [[5, -5]] * 6}, "lower limit"),
        ({"limits_deg": LIMITS_DEG, "prot": 1}, "unknown option 'prot'"),
        ({"limits_deg": LIMITS_DEG, "port": 70000}, "port"),
        ({"limits_deg": LIMITS_DEG, "cycle_ms": 8}, "cycle_ms"),
        ({"limits_deg": LIMITS_DEG, "silence_s": 0}, "silence_s"),
        ({"limits_deg": LIMITS_DEG, "correction_limit_deg": [1, 2]}, "correction_limit_deg"),
        ({"limits_deg": LIMITS_DEG, "sen_type": 'a"b'}, "sen_type"),
    ],
)
def test_wrong_options_are_refused_before_anything_is_opened(options, text):
    with pytest.raises(ConfigError, match=text):
        KukaRsi("arm", "", options)
