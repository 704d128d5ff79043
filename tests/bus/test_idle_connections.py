"""An unattended run: devices that close an idle connection, an hour between two stations, by a clock that the test turns."""

import struct
import time

import pytest
from late_peers import Clock, IdleCloser, LatePeer, line_cut, rtu_cut, rtu_registers
from mbcacq_bus import serial_link
from mbcacq_bus.idle import IdlePoll
from mbcacq_bus.modbus import ModbusPositioner, ModbusSensor
from mbcacq_bus.serial import SerialSensor
from mbcacq_bus.serial_positioner import SerialPositioner

from mbcacq.devices import DeviceTimeout, IdentityError

HELD = {0: 215, 3: 1, 10: 0, 40: 4711}
HOUR_S = 3600.0


def tcp_answer(request: bytes) -> bytes:
    number, _, _, unit, function, address, count = struct.unpack_from(">HHHBBHH", request)
    if function == 16:
        return struct.pack(">HHHBBHH", number, 0, 6, unit, function, address, count)
    if function == 2:
        return struct.pack(">HHHBBBB", number, 0, 4, unit, function, 1, HELD[address])
    return struct.pack(f">HHHBBB{count}H", number, 0, 3 + 2 * count, unit, function, 2 * count, *(HELD[address + k] for k in range(count)))


def tcp_cut(pending: bytes) -> int:
    return 6 + int.from_bytes(pending[4:6], "big") if len(pending) >= 6 else 0


def idle_for(peer, clock, seconds):
    """Let the time pass, and wait until the peer has closed its connection."""
    closed, clock.now = peer.closed, clock.now + seconds
    deadline = time.monotonic() + 600.0
    while peer.closed == closed:
        assert time.monotonic() < deadline
        time.sleep(0.005)
    time.sleep(0.05)  # for the end of the connection to arrive


@pytest.fixture
def clock():
    return Clock()


def test_a_positioner_is_moved_after_an_hour_on_a_connection_opened_again(clock):
    options = {"stations": {1: 5.0, 2: 7.0}, "position": {"address": 10}, "in_position": {"address": 3, "table": "discrete"}}
    identity = {"where": {"address": 40}, "equals": 4711}
    with IdleCloser(tcp_answer, tcp_cut, clock) as peer:
        link = {"host": peer.host, "port": peer.port, "timeout_s": 20.0, "idle_poll_s": 0.0, "identity": identity}
        with ModbusPositioner("p", "", {**link, **options}) as positioner:
            positioner.go_to("1", "")
            idle_for(peer, clock, HOUR_S)
            positioner.go_to("2", "")
            written = [request[-2:] for request in peer.requests if request[7] == 16]
            assert written == [b"\x00\x05", b"\x00\x07"]  # each once
            assert peer.connections == 2


def test_another_box_at_the_address_is_noticed_before_it_is_moved(clock):
    options = {"stations": {1: 5.0}, "position": {"address": 10}, "in_position": {"address": 3, "table": "discrete"}}
    held = dict(HELD)
    with IdleCloser(lambda r: tcp_answer(r) if held[40] == 4711 else tcp_answer(r)[:-2] + b"\x00\x01", tcp_cut, clock) as peer:
        link = {"host": peer.host, "port": peer.port, "timeout_s": 20.0, "idle_poll_s": 0.0}
        with ModbusPositioner("p", "", {**link, **options, "identity": {"where": {"address": 40}, "equals": 4711}}) as positioner:
            held[40] = 1
            idle_for(peer, clock, HOUR_S)
            with pytest.raises(IdentityError, match="identifies itself as 1, not as 4711"):
                positioner.go_to("1", "")
            assert not [request for request in peer.requests if request[7] == 16]


@pytest.mark.parametrize("rtu", [False, True], ids=["tcp", "serial server"])
def test_a_sensor_is_read_after_an_hour(clock, rtu):
    answer, cut = (rtu_registers(HELD), rtu_cut) if rtu else (tcp_answer, tcp_cut)
    with IdleCloser(answer, cut, clock) as peer:
        link = {"serial": peer.url} if rtu else {"host": peer.host, "port": peer.port}
        values = {"air_C": {"address": 0, "scale": 0.1}}
        with ModbusSensor("s", "", {**link, "values": values, "timeout_s": 20.0, "idle_poll_s": 0.0}) as sensor:
            assert sensor.read() == pytest.approx({"air_C": 21.5})
            idle_for(peer, clock, HOUR_S)
            assert sensor.read() == pytest.approx({"air_C": 21.5})


def test_a_line_of_text_is_used_after_an_hour(clock, monkeypatch):
    monkeypatch.setattr(serial_link, "_QUIET", 0.01)  # it waits long for an answer, and not so long for silence
    said = {b"GO 5": b"OK\n", b"GO 7": b"OK\n", b"READY?": b"1\n", b"T?": b"T=21\n"}
    with IdleCloser(lambda request: said[request.strip()], line_cut, clock) as peer:
        options = {
            "port": peer.url,
            "stations": {1: 5.0, 2: 7.0},
            "move": {"send": "GO {raw:.0f}\n", "reply": "OK"},
            "ready": {"send": "READY?\n", "reply": "1"},
            "timeout_s": 20.0,
            "idle_poll_s": 0.0,
        }
        with SerialPositioner("p", "", options) as positioner:
            positioner.go_to("1", "")
            idle_for(peer, clock, HOUR_S)
            positioner.go_to("2", "")
            assert [r.strip() for r in peer.requests if r.startswith(b"GO")] == [b"GO 5", b"GO 7"]
    with IdleCloser(lambda request: said[request.strip()], line_cut, clock) as peer:
        with SerialSensor("s", "", {"port": peer.url, "line": r"T=(?P<air_C>\d+)", "ask": "T?\n", "timeout_s": 20.0}) as sensor:
            assert sensor.read() == {"air_C": 21.0}
            idle_for(peer, clock, HOUR_S)
            assert sensor.read() == {"air_C": 21.0}


def test_a_write_whose_connection_breaks_is_not_sent_twice():
    """Whether it has begun to move cannot be known."""
    options = {"stations": {1: 5.0}, "position": {"address": 10}, "in_position": {"address": 3, "table": "discrete"}}
    with LatePeer(tcp_answer, tcp_cut, {0: lambda: False}) as peer:
        peer.idle = lambda: bool(peer.requests)
        with ModbusPositioner("p", "", {"host": peer.host, "port": peer.port, "timeout_s": 20.0, **options}) as positioner:
            with pytest.raises(DeviceTimeout, match="broke the connection while writing holding 10"):
                positioner.go_to("1", "")
            assert len(peer.requests) == 1


def test_a_connection_that_nobody_uses_is_polled_and_one_in_use_is_not():
    asked = []
    quiet = IdlePoll(lambda: asked.append("quiet"), lambda: 0.0, 0.001)
    busy = IdlePoll(lambda: asked.append("busy"), lambda: time.monotonic() + 1e6, 0.001)
    never = IdlePoll(lambda: asked.append("never"), lambda: 0.0, 0.0)
    for poll in (quiet, busy, never):
        poll.start()
    deadline = time.monotonic() + 600.0
    while len(asked) < 5 and time.monotonic() < deadline:
        time.sleep(0.005)
    for poll in (quiet, busy, never):
        poll.stop()
    assert set(asked) == {"quiet"}
