"""An answer that comes after its time-out is never taken for that to another question, on any line or connection.

What is late leaves its device once whoever asked has given it up, not after a time: a busy machine changes nothing. LIMIT_S is what these
tests wait; answers that are not late have many tries. Lines of text and of Modbus RTU have time and answers of their own (scripted_line).
"""

import struct
import termios
import threading

import pytest
import serial
from late_peers import LatePeer, crc, line_cut, rtu_cut, rtu_registers
from mbcacq_bus.modbus import ModbusPositioner, ModbusSensor
from mbcacq_bus.serial import SerialSensor
from mbcacq_bus.serial_link import SerialConnection, SerialLink
from scripted_line import ScriptedLine, ScriptedRtu

from mbcacq.devices import DeviceTimeout

VALUES = {"robot_C": 301, "air_C": 215, "bar_C": 184}
WANTED = {"robot_C": 30.1, "air_C": 21.5, "bar_C": 18.4}
REGISTERS = {name: {"address": k, "scale": 0.1, "unit": "C"} for k, name in enumerate(VALUES)}
HELD = dict(enumerate(VALUES.values()))
LIMIT_S, TRIES = 0.2, 20


SOON, SLOW, LATE = 0.02, 0.9 * LIMIT_S, 1.5 * LIMIT_S  # s after the question, on the clock of a scripted line


def rtu(monkeypatch, delays, answer=None, retries=2):
    """A scripted line with a device that answers the n-th request after ``delays[n]`` s, and an open sensor on it."""
    answer, due = answer or rtu_registers(HELD), dict(delays)
    line = ScriptedRtu(lambda request: (due.get(len(line.heard) - 1, SOON), answer(request)))
    line.install(monkeypatch)
    options = {"serial": "COM3", "parity": "N", "timeout_s": LIMIT_S, "retries": retries, "values": REGISTERS}
    sensor = ModbusSensor("s", "", options)
    sensor._link._hurry = line.stopped()
    return line, sensor


def test_an_answer_that_comes_while_the_line_is_left_alone_is_dropped(monkeypatch):
    line, sensor = rtu(monkeypatch, {1: LATE, 2: SLOW})
    with sensor:
        for _ in range(3):
            assert sensor.read() == pytest.approx(WANTED)
    assert len(line.heard) > 9  # one was asked again


def test_after_one_answer_that_comes_behind_the_next_question_every_register_keeps_its_own_value(monkeypatch):
    """It comes later than a line is left alone for, so that the next question is already asked."""
    line, sensor = rtu(monkeypatch, {1: 2.5 * LIMIT_S, 2: 0.6 * LIMIT_S, 3: SLOW})
    with sensor:
        for _ in range(3):
            assert sensor.read() == pytest.approx(WANTED)
    assert len(line.heard) > 10  # and both were asked again


def test_a_line_that_gave_up_once_is_in_step_again(monkeypatch):
    """One try, and it is answered, but long after it was given up, when the next register is to be read."""
    line, sensor = rtu(monkeypatch, {0: 9.5 * LIMIT_S}, retries=0)
    with sensor:
        with pytest.raises(DeviceTimeout, match=r"gave no valid answer as unit 1 .* while reading holding 0"):
            sensor.read()
        line.sleep(8.0 * LIMIT_S)
        assert sensor._link.read(sensor._options.values["air_C"]) == pytest.approx(21.5)
        assert sensor.read() == pytest.approx(WANTED)


@pytest.mark.parametrize(
    "foreign",
    [
        struct.pack(">BBBH", 9, 3, 2, 999),  # another unit
        struct.pack(">BBBH", 1, 4, 2, 999),  # another function
        struct.pack(">BBBHH", 1, 3, 4, 999, 999),  # another length
    ],
    ids=["unit", "function", "length"],
)
def test_an_answer_of_another_unit_function_or_length_is_none(monkeypatch, foreign):
    answer, first = rtu_registers(HELD), [foreign + crc(foreign)]
    _, sensor = rtu(monkeypatch, {}, lambda request: first.pop() if first else answer(request))
    with sensor:
        assert sensor.read() == pytest.approx(WANTED)


def test_a_late_answer_of_modbus_tcp_ends_with_its_connection():
    """Gateways that mix up the numbers of transactions are known; a connection of its own cannot be mixed up."""

    def answer(request: bytes) -> bytes:
        number, _, _, unit, function, address, _ = struct.unpack(">HHHBBHH", request)
        return struct.pack(">HHHBBBH", number, 0, 5, unit, function, 2, HELD[address])

    with LatePeer(answer, lambda pending: 12, {1: lambda: peer.connections > 1}) as peer:
        options = {"host": peer.host, "port": peer.port, "timeout_s": LIMIT_S, "retries": TRIES, "values": REGISTERS}
        with ModbusSensor("s", "", options) as sensor:
            for _ in range(3):
                assert sensor.read() == pytest.approx(WANTED)
        assert peer.connections >= 2


def test_a_halt_does_not_wait_for_a_line_to_fall_silent():
    options = {
        "stations": {1: 100.0},
        "position": {"address": 10},
        "in_position": {"address": 0},
        "halt": {"address": 5},
        "timeout_s": LIMIT_S,
        "parity": "N",
    }
    with LatePeer(rtu_registers({0: 0}), rtu_cut, {}) as peer, ModbusPositioner("p", "", {"serial": peer.url, **options}) as positioner:
        positioner._link.keep_in_step()
        positioner.stop()
        assert [request[:6] for request in peer.requests] == [bytes.fromhex("01 10 0005 0001")]


def test_a_late_line_is_not_taken_for_the_answer_to_the_next_question(monkeypatch):
    said, delays = {"POS?": b"POS=152.5\n", "READY?": b"1\n"}, iter([0.6])
    line = ScriptedLine(lambda heard: (next(delays, 0.01), said[heard]))
    line.install(monkeypatch)
    link = SerialLink("lift", SerialConnection.model_validate({"port": "COM3", "timeout_s": LIMIT_S}), line.stopped())
    link.open()
    with pytest.raises(DeviceTimeout, match=r"answered nothing to 'POS\?'"):
        link.ask("POS?\n")
    assert [link.ask("READY?\n"), link.ask("POS?\n"), link.ask("READY?\n")] == ["1", "POS=152.5", "1"]
    link.close()


def test_a_late_line_is_no_new_reading_of_a_sensor_that_is_asked():
    count, given_up = iter(range(100)), threading.Event()
    with LatePeer(lambda request: b"T=%d\n" % next(count), line_cut, {0: given_up.is_set}) as peer:
        options = {"port": peer.url, "line": r"T=(?P<count>\d+)", "ask": "T?\n", "timeout_s": 0.5}
        with SerialSensor("s", "", options) as sensor:
            with pytest.raises(DeviceTimeout):
                sensor.read()
            given_up.set()
            assert [sensor.read() for _ in range(3)] == [{"count": 1.0}, {"count": 2.0}, {"count": 3.0}]


class ClosedMeanwhile:
    """A port that another thread closes between a look at it and a question: pyserial's own answer to that."""

    def __init__(self):
        self.looks = iter([0])

    @property
    def in_waiting(self):
        for waiting in self.looks:
            return waiting
        raise serial.PortNotOpenError

    def close(self):
        pass


def test_a_line_closed_while_it_is_asked_is_reported_as_lost():
    link = SerialLink("lift", SerialConnection.model_validate({"port": "COM3", "timeout_s": LIMIT_S}))
    link._port = ClosedMeanwhile()
    with pytest.raises(DeviceTimeout, match="was lost"):
        link.ask("POS?\n")


class LostPort:
    """A port that raises what libraries do where it is lost or another thread closes it: nothing of that is an OSError."""

    def __init__(self, error):
        self._error, self.timeout = error, 0.0

    @property
    def in_waiting(self):
        return 0

    def write(self, data):
        raise self._error

    def read_until(self, end, most):
        raise self._error

    def recv(self, most):
        raise self._error

    def flush(self):
        pass

    def close(self):
        pass


@pytest.mark.parametrize(
    "error", [TypeError("no descriptor"), ValueError("descriptor -1"), termios.error(5, "lost"), AttributeError("None")]
)
def test_whatever_a_library_raises_of_a_lost_port_is_reported_as_lost(error):
    link = SerialLink("lift", SerialConnection.model_validate({"port": "COM3", "timeout_s": LIMIT_S}))
    link._port = LostPort(error)
    with pytest.raises(DeviceTimeout, match="was lost"):
        link.ask("POS?\n")
    sensor = SerialSensor("s", "", {"port": "COM3", "line": r"T=(?P<air_C>\d+)", "ask": "T?\n", "timeout_s": LIMIT_S})
    sensor._link._port = LostPort(error)
    with pytest.raises(DeviceTimeout, match="was lost"):
        sensor.read()


@pytest.mark.parametrize(
    "error", [TypeError("no descriptor"), ValueError("descriptor -1"), termios.error(5, "lost"), AttributeError("None")]
)
def test_whatever_a_library_raises_under_a_modbus_request_is_a_broken_connection(error):
    def lost(request):
        raise AssertionError("never asked")

    options = {"stations": {1: 5.0}, "position": {"address": 10}, "in_position": {"address": 3}, "timeout_s": 20.0, "parity": "N"}
    with LatePeer(lost, rtu_cut, {}) as peer, ModbusPositioner("p", "", {"serial": peer.url, **options}) as positioner:
        positioner._link._transport._client.write_registers = lambda *_, **__: (_ for _ in ()).throw(error)
        with pytest.raises(DeviceTimeout, match="broke the connection while writing holding 10"):
            positioner.go_to("1", "")


def test_what_was_closed_while_it_was_asked_is_not_opened_again():
    class Closing(LostPort):
        @property
        def in_waiting(self):
            link.close()
            raise serial.PortNotOpenError

    link = SerialLink("lift", SerialConnection.model_validate({"port": "loop://", "timeout_s": LIMIT_S}))
    link._wanted, link._port = True, Closing(OSError())
    with pytest.raises(DeviceTimeout, match="was closed"):
        link.ask("POS?\n")
    assert not link.connected
