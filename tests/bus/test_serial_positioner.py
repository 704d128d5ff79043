"""A lift or turntable on a serial line, described by its words; on a real terminal device, and on a TCP port."""

import sys
import threading

import pytest
from mbcacq_bus.serial_positioner import SerialPositioner, SerialPositionerOptions
from mbcacq_fakes.protocols.bus.serial_line import SerialLine
from mbcacq_fakes.protocols.bus.serial_positioner import FakeSerialPositioner
from scripted_line import ScriptedLine

from mbcacq.devices import (
    Aborted,
    ConfigError,
    ConnectError,
    DeviceFault,
    DeviceTimeout,
    IdentityError,
    Positioner,
    ProtocolError,
    create,
    parse_options,
)

WORDS = {
    "stations": {1: 0.0, 2: 152.5},
    "unit": "mm",
    "scale": 0.01,
    "timeout_s": 20.0,
    "move": {"send": "MA {raw:.0f}\r\n", "reply": "OK"},
    "position": {"send": "?P\r\n", "reply": r"P=(?P<raw>[-+]?\d+)"},
    "ready": {"send": "?S\r\n", "reply": "S=READY"},
    "fault": {"send": "?S\r\n", "reply": r"S=FAULT (?P<code>\d+)"},
    "halt": {"send": "ST\r\n"},
    "identity": {"ask": "*IDN?\r\n", "expect": "LIFT 3000"},
}

needs_terminal = pytest.mark.skipif(sys.platform == "win32", reason="Windows has no pseudo-terminals")


def fake(pty=True, travel_s=0.05, **changes):
    options = parse_options(SerialPositionerOptions, "x", {"port": "x", **WORDS, **changes})
    return FakeSerialPositioner(options, travel_s=travel_s, pty=pty)


def driver(line, **changes):
    return SerialPositioner("p", "lift", {"port": line.url, **WORDS, **changes})


@pytest.mark.parametrize("pty", [pytest.param(True, marks=needs_terminal), False], ids=["terminal", "tcp"])
def test_drives_there_in_the_devices_own_units(pty):
    with fake(pty) as line, driver(line) as positioner:
        positioner.go_to("2", "")
        assert line.motion.station == "2"
        assert "MA 15250" in line.heard  # 152.5 mm in hundredths
        assert line.heard[0] == "*IDN?"
        positioner.go_to("1", "")
        assert line.motion.station == "1"
        assert [(f.name, f.unit) for f in positioner.describe().fields] == [("position", "mm")]
    assert isinstance(create("positioners", "serial", "lift", {"port": "x", **WORDS}), Positioner)


@needs_terminal
def test_waits_until_it_stands_there():
    with fake(travel_s=0.4) as line, driver(line) as positioner:
        positioner.go_to("2", "")
        assert line.motion.arrived


@needs_terminal
def test_a_ready_flag_that_is_not_lowered_yet_is_not_believed():
    """Without a position to compare, the flag of the motion before must not pass for that of this one."""
    with fake(travel_s=0.3, position=None) as line:
        line.motion.began = 0.0
        with driver(line, position=None, ready_delay_s=0.1) as positioner:
            positioner.go_to("2", "")
            assert line.motion.arrived


@needs_terminal
def test_stuck_it_says_where_it_is():
    with fake() as line:
        line.motion.stuck = True
        with driver(line, move_timeout_s=0.2) as positioner:
            with pytest.raises(DeviceTimeout, match=r"did not reach station 2 \(152.5 mm\).*at 0 mm"):
                positioner.go_to("2", "")


@needs_terminal
def test_a_fault_is_reported_with_its_code():
    with fake() as line, driver(line) as positioner:
        line.motion.fault = 17
        with pytest.raises(DeviceFault, match="fault 17 on the way to station 2"):
            positioner.go_to("2", "")
        assert not any(heard.startswith("MA") for heard in line.heard)  # noticed before it was sent anywhere


@needs_terminal
def test_a_refused_order_is_no_arrival():
    with SerialLine(lambda heard: {"*IDN?": "LIFT 3000", "?S": "S=READY"}.get(heard, "ERR range"), pty=True) as line:
        with driver(line, fault=None) as positioner:
            with pytest.raises(DeviceFault, match="answered 'ERR range' to 'MA 15250'"):
                positioner.go_to("2", "")


@needs_terminal
def test_stop_halts_and_ends_the_wait():
    with fake(travel_s=30.0) as line, driver(line) as positioner:
        timer = threading.Timer(0.2, positioner.stop)
        timer.start()
        with pytest.raises(Aborted, match="station 2"):
            positioner.go_to("2", "")
        timer.join()
        positioner.stop()
        deadline = threading.Event()
        for _ in range(100):
            if line.halted:
                break
            deadline.wait(0.02)
        assert line.halted >= 1


@needs_terminal
def test_the_wrong_device_silence_and_absence_are_different_errors(scripted):
    with fake(identity={"ask": "*IDN?\r\n", "expect": "OTHER 1"}) as line:
        with pytest.raises(IdentityError, match="answered 'OTHER 1' where 'LIFT 3000' was expected"):
            driver(line, timeout_s=3.0).connect()
    with pytest.raises(ConnectError, match="cannot be opened"):
        SerialPositioner("p", "", {"port": "/dev/does-not-exist", **WORDS}).connect()
    with pytest.raises(IdentityError, match=r"cannot be identified.*answered nothing to '\*IDN\?'"):
        scripted(lambda heard: None)


@pytest.fixture
def scripted(monkeypatch):
    """Makes a positioner on a line of the test, whose answers come at once unless they are (s, bytes)."""
    opened = []

    def make(answer, **changes):
        def reply(heard):
            said = answer(heard)
            return said if said is None or isinstance(said, tuple) else (0.01, said)

        line = ScriptedLine(reply)
        line.install(monkeypatch)
        opened.append(SerialPositioner("p", "lift", {"port": "COM3", **WORDS, **changes}))
        opened[-1]._stopped = opened[-1]._link._stopped = line.stopped()
        opened[-1].connect()
        return line, opened[-1]

    yield make
    for positioner in opened:
        positioner.close()  # on a clock that is not moved its polling would never wait


@pytest.mark.parametrize(
    ("said", "error", "words"),
    [
        (b"OK", DeviceTimeout, "half a line"),
        (b"\xff\x00#", DeviceTimeout, "half a line"),
        (b"\xff\x00#\r\n", DeviceFault, "answered"),
        (b"x" * 3000, ProtocolError, "without an end of line"),
        (None, DeviceTimeout, "answered nothing"),
    ],
)
def test_noise_on_the_line_is_an_error_and_never_a_position(scripted, said, error, words):
    line, positioner = scripted(lambda heard: b"LIFT 3000\r\n" if heard == "*IDN?" else said, fault=None, timeout_s=4.0)
    with pytest.raises(error, match=words):
        positioner.go_to("2", "")
    assert line.heard[-1] == "MA 15250"


def test_a_line_that_is_cut_is_lost():
    with fake(pty=False) as line, driver(line, fault=None, timeout_s=2.0) as positioner:
        line.corrupt = lambda data: None
        with pytest.raises(DeviceTimeout, match="was lost|answered nothing"):
            positioner.go_to("2", "")


def test_an_answer_that_came_too_late_is_not_taken_for_the_next_one(scripted):
    places = iter([(1.5, b"P=15250\r\n")])
    said = {"*IDN?": b"LIFT 3000\r\n", "?S": b"S=READY\r\n"}
    _, positioner = scripted(
        lambda heard: next(places, b"P=0\r\n") if heard == "?P" else said.get(heard, b"OK\r\n"),
        fault=None,
        timeout_s=1.0,
        move_timeout_s=0.5,
    )
    with pytest.raises(DeviceTimeout, match="answered nothing"):
        positioner.go_to("2", "")
    with pytest.raises(DeviceTimeout, match="at 0 mm"):
        positioner.go_to("2", "")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"ready": None, "position": None}, "give ready or position"),
        ({"move": {"send": "GO\r"}}, "needs {raw} or {value}"),
        ({"move": {"send": "GO {place}\r"}}, "no text with {raw} or {value}"),
        ({"limits": (0, 100)}, "station 2 at 152.5 mm is outside the limits 0..100"),
        ({"position": {"send": "?", "reply": r"P=(\d+)"}}, "position.reply needs a named group"),
        ({"ready": {"send": "?", "reply": "("}}, "ready.reply is not a regular expression"),
        ({"speed": 3}, "speed"),
        ({"scale": 0}, "scale must not be zero"),
    ],
)
def test_a_wrong_description_is_one_sentence(change, words):
    with pytest.raises(ConfigError) as error:
        SerialPositioner("p", "", {"port": "x", **WORDS, **change})
    assert words in str(error.value)
    assert "\n" not in str(error.value)
