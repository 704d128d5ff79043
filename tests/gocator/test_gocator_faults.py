"""Everything that can go wrong on the wire ends in a named error in bounded time, and the next scan is a good one."""

from __future__ import annotations

import socket
import threading

import pytest
from mbcacq_fakes.protocols.faults import Faults
from mbcacq_fakes.protocols.gocator import FAULTS, actions
from mbcacq_gocator import wire
from mbcacq_gocator.driver import Gocator

from mbcacq.devices import ConnectError, DeviceFault, DeviceTimeout, IdentityError, ProtocolError

SNAPSHOT, INFO, STATES, TIME = 0x4528, 0x4010, 0x4525, 0x100A


@pytest.fixture
def scanner(driver) -> Gocator:
    made = driver(timeout_s=1.0, reply_limit_s=1.0)
    made.connect()
    return made


@pytest.mark.parametrize(
    ("fault", "value", "error", "words"),
    [
        ("stamp_only", True, DeviceTimeout, r"1 data set\(s\) came with only a stamp; in the job, open Output > Ethernet"),
        ("no_data", True, DeviceTimeout, "no scan within 1 s"),
        ("old_stamp", True, DeviceTimeout, r"only 1 older data set\(s\) came"),
        ("stall", True, DeviceTimeout, r"stopped after \d+ of \d+ bytes"),
        ("short_message", True, ProtocolError, "surface point cloud message .* announces an array of"),
        ("garbage", True, ProtocolError, "something else answers at this port, or the stream is out of step"),
        ("close_data", True, ConnectError, "closed the connection for the Gocator's scan; it may have restarted"),
        ("close_in_message", True, ConnectError, r"closed the connection for the Gocator's scan in the middle of it \(\d+ of \d+ bytes\)"),
        ("silent", {SNAPSHOT}, DeviceTimeout, "reply to 'snapshot' did not come in time"),
        ("silent", {TIME}, DeviceTimeout, "reply to 'time stamp' did not come in time"),
        ("close_control", {SNAPSHOT}, ConnectError, "closed the connection for the Gocator's reply to 'snapshot'"),
        ("wrong_reply", {SNAPSHOT}, ProtocolError, r"answered 'snapshot' \(0x4528\) with a reply to 0x4529"),
        ("status", {SNAPSHOT: -981}, DeviceFault, r"refused 'snapshot': busy \(-981\)"),
        ("status", {SNAPSHOT: -1000}, DeviceFault, "not possible in the sensor's present state"),
        ("status", {SNAPSHOT: -4711}, DeviceFault, r"unknown status \(-4711\)"),
        ("status", {SNAPSHOT: 0}, DeviceFault, r"failed \(0\)"),
    ],
)
def test_fault_while_scanning(fake, scanner, fault, value, error, words):
    assert len(scanner.capture().points)
    fake.faults.set(fault, value)
    with pytest.raises(error, match=f"scanner 'front': .*{words}"):
        scanner.capture()
    fake.faults.clear()
    scan = scanner.capture()
    assert len(scan.points) == 12 * 20 - 12
    assert scan.frame == fake.state.exposures - 1  # and not a late one


@pytest.mark.parametrize(
    ("fault", "value", "error", "words"),
    [
        (
            "refuse_connections",
            True,
            ConnectError,
            "control port at 127.0.0.1:.* cannot be reached .*refused.*check its power, cable and address",
        ),
        ("protocol_version", (100, 4), IdentityError, r"speaks Gocator protocol 100.4, this driver 101.x"),
        ("model", "2510", IdentityError, "asks for Gocator 3210 but the sensor is a 2510"),
        ("silent", {0}, DeviceTimeout, "reply to 'version probe' did not come in time"),
        ("silent", {INFO}, DeviceTimeout, "reply to 'system info' did not come in time"),
        ("status", {STATES: -981}, DeviceFault, r"refused 'states': busy \(-981\)"),
        ("close_control", {INFO}, ConnectError, "closed the connection"),
        ("wrong_reply", {INFO}, ProtocolError, "answered 'system info'"),
    ],
)
def test_fault_while_connecting(fake, driver, fault, value, error, words):
    fake.faults.set(fault, value)
    if fault == "refuse_connections":
        while any(_accepts(port) for port in fake.ports):
            pass
    scanner = driver("3210", reply_limit_s=1.0)
    with pytest.raises(error, match=words):
        scanner.connect()
    assert scanner.describe().serial == ""
    fake.faults.clear()
    while not all(_accepts(port) for port in fake.ports):
        pass
    scanner.connect()


def _accepts(port: int) -> bool:
    try:
        socket.create_connection(("127.0.0.1", port), timeout=1).close()
    except OSError:
        return False
    return True


@pytest.mark.parametrize(("other", "version"), [((101, 8), True), ((101, 99), True), ((100, 99), False), ((102, 0), False)])
def test_only_the_major_protocol_version_counts(fake, driver, other, version):
    fake.faults.set("protocol_version", other)
    scanner = driver()
    if version:
        scanner.connect()
    else:
        with pytest.raises(IdentityError):
            scanner.connect()


def test_unknown_message_types_are_passed_over(fake, scanner):
    fake.faults.set("unknown_type")
    assert len(scanner.capture().points) == 228


def test_stamp_only_sets_before_the_scan_are_waited_through(fake, driver):
    """The vendor's and other clients take the first set and show an empty cloud."""
    fake.faults.set("stamp_only", times=3)
    scanner = driver(mode="trigger", timeout_s=20)
    scanner.connect()
    scans = []
    thread = threading.Thread(target=lambda: scans.append(scanner.capture()))
    thread.start()
    while fake.state.exposures < 4 and thread.is_alive():
        if fake.state.running:
            actions.trigger(fake.state)
        thread.join(0.02)
    thread.join(20)
    assert len(scans[0].points) == 228


def test_sensor_that_restarts_between_scans_is_found_again(fake, scanner):
    scanner.capture()
    fake.state.drop_connections()
    assert len(scanner.capture().points) == 228


@pytest.mark.skipif(not hasattr(socket, "TCP_KEEPIDLE"), reason="this system names it otherwise")
def test_a_connection_that_nobody_uses_is_probed_before_a_firewall_forgets_it(fake):
    with wire.connect("127.0.0.1", fake.ports.control, "control", 20.0) as sock:
        assert sock.getsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE)
        assert sock.getsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPIDLE) <= 60


def test_sensor_that_stays_away_is_an_error(fake, scanner):
    scanner.capture()
    fake.stop()
    with pytest.raises(ConnectError, match="cannot be reached"):
        scanner.capture()


def test_losing_health_loses_only_health(fake, scanner):
    fake.faults.set("mute_health")
    fake.state.health.close()
    assert len(scanner.capture().points) == 228


def test_no_health_port_is_named(fake, driver):
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))
        with pytest.raises(ConnectError, match=f"health port at 127.0.0.1:{unused.getsockname()[1]}"):
            driver(health_port=unused.getsockname()[1]).connect()


def test_faults_wear_off_and_are_known_by_name():
    faults = Faults(FAULTS)
    faults.set("stall", times=2)
    assert [faults.use("stall") for _ in range(3)] == [True, True, None]
    faults.set("status", {1: -5})
    assert (faults.use("status", 1), faults.use("status", 2)) == (-5, None)
    with pytest.raises(ValueError, match="there is no fault 'typo'"):
        faults.set("typo")
    assert all(isinstance(text, str) for text in FAULTS.values())
