"""The suite itself: each kind of bad driver is caught by the check that is there for it, and proxies do what they say."""

from __future__ import annotations

import re
import socket
import sys
import time
from contextlib import contextmanager

import pytest
from bench_bus import serial_sensor
from mbcacq_bus.serial import SerialSensor

from mbcacq.conformance import CHECKS, Channel, DriverBench, Fault, Hang, PtyProxy, TcpProxy, UdpProxy, bounded, check, counted, ended
from mbcacq.devices import DeviceTimeout, MbcacqError

BY_NAME = {each.__name__: each for each in CHECKS}

needs_terminal = pytest.mark.skipif(sys.platform == "win32", reason="Windows has no pseudo-terminals")


class Foreign(SerialSensor):
    def read(self):
        try:
            return super().read()
        except DeviceTimeout:
            raise KeyError("air_C") from None


class Waits(SerialSensor):
    def read(self):
        try:
            return super().read()
        except DeviceTimeout:
            time.sleep(60)


class MakesUp(SerialSensor):
    def read(self):
        try:
            return super().read()
        except MbcacqError:
            return {"air_C": 55.0, "humidity": 40.0}


class Believes(SerialSensor):
    def connect(self):
        self._link._identity = None
        super().connect()


class TakesAll(SerialSensor):
    """Does not look at its options."""


class StopsOnce(SerialSensor):
    stopped = False

    def stop(self):
        if self.stopped:
            raise RuntimeError("already stopped")
        self.stopped = True


class Mute(SerialSensor):
    def connect(self):
        try:
            super().connect()
        except MbcacqError as error:
            raise type(error)("failed") from None


class NoDescription(SerialSensor):
    describe = None


class WorksAlone(SerialSensor):
    def read(self):
        return {"air_C": 20.0, "humidity": 40.0}


@pytest.mark.parametrize(
    ("driver", "name", "words"),
    [
        (Foreign, "silence_is_an_error_in_time", r"raised KeyError .*none of mbcacq's errors"),
        (Waits, "silence_is_an_error_in_time", r"did not end within 2 s; it hangs at(.|\n)*time.sleep"),
        (MakesUp, "silence_is_an_error_in_time", "it reads .*'air_C': 55.0"),
        (WorksAlone, "refuses_to_work_unconnected", "it works without a connection"),
        (Believes, "refuses_the_wrong_device", "instead of an IdentityError"),
        (TakesAll, "refuses_an_unknown_option", "instead of a ConfigError"),
        (StopsOnce, "stop_and_close_are_always_allowed", "RuntimeError: already stopped"),
        (Mute, "names_an_absent_device", "a message is one sentence"),
        (NoDescription, "describes_itself_unconnected", "it is no Sensor: a method is missing"),
    ],
)
def test_a_bad_driver_is_caught(driver, name, words):
    made = []

    def bad(sensor):
        made.append(sensor)
        sensor.__class__ = driver
        return sensor

    @contextmanager
    def stand():
        with serial_sensor() as good:
            make, wrong = good.make, good.wrong
            good.make = lambda **o: bad(make(**{k: v for k, v in o.items() if driver is not TakesAll or k != "no_such_option"}))
            good.wrong = lambda: bad(wrong())
            try:
                yield good
            finally:
                for sensor in made:
                    SerialSensor.stop(sensor)
                    SerialSensor.close(sensor)

    result = check(DriverBench("bad", "sensor", stand, limit_s=2.0), BY_NAME[name])
    assert result.status == "failed"
    assert re.search(words, result.detail), result.detail


def test_a_step_that_hangs_is_given_up_and_placed():
    with pytest.raises(Hang, match="did not end within 0.05 s"):
        bounded("sleeping", lambda: time.sleep(1.0), 0.05)
    with pytest.raises(ZeroDivisionError):
        bounded("dividing", lambda: 1 / 0, 5.0)
    assert bounded("adding", lambda: 1 + 1, 5.0) == 2


@pytest.mark.parametrize(
    ("action", "arrives"),
    [
        ("drop", [b"ab\n", b"ef\n"]),
        ("duplicate", [b"ab\n", b"cd\n", b"cd\n", b"ef\n"]),
        ("truncate", [b"ab\n", b"c", b"ef\n"]),
        ("close", [b"ab\n", b"c"]),
        ("delay", [b"ab\n", b"cd\n", b"ef\n"]),
        ("split", [b"ab\n", b"cd\n", b"ef\n"]),
        ("join", [b"ab\n", b"cd\nef\n"]),
    ],
)
def test_a_fault_befalls_one_message_only(action, arrives):
    with socket.create_server(("127.0.0.1", 0)) as device, TcpProxy(Channel("line"), device.getsockname(), cut=ended(b"\n")) as proxy:
        proxy.channel.fault = Fault("device", 1, action, seconds=0.05)
        with socket.create_connection(proxy.address) as driver:
            there, _ = device.accept()
            with there:
                there.sendall(b"ab\ncd\nef\n")
                if action != "close":
                    there.shutdown(socket.SHUT_WR)
                driver.settimeout(60.0)
                got = b"".join(iter(lambda: driver.recv(100), b""))
    assert got == b"".join(arrives)
    assert proxy.channel.struck == 1


def test_what_is_held_goes_to_no_other_connection():
    """A connection that is idle, or about to end, must not send what another one's message waits to be joined with."""
    with socket.create_server(("127.0.0.1", 0)) as device, TcpProxy(Channel("line"), device.getsockname()) as proxy:
        with socket.create_connection(proxy.address) as idle, socket.create_connection(proxy.address) as asking:
            ends = {}
            for driver, text in ((idle, b"first\n"), (asking, b"second\n")):
                driver.sendall(text)
                there, _ = device.accept()
                there.settimeout(60.0)
                ends[there.recv(100)] = there
            proxy.channel.set("join", "driver")
            asking.sendall(b"cloud\n")
            assert ends[b"second\n"].recv(100) == b"cloud\n"
            for there in ends.values():
                there.close()


def test_what_is_held_arrives_although_its_sender_ends():
    with socket.create_server(("127.0.0.1", 0)) as device, TcpProxy(Channel("line"), device.getsockname()) as proxy:
        proxy.channel.set("join", "driver")
        with socket.create_connection(proxy.address) as driver:
            driver.sendall(b"cloud\n")
        there, _ = device.accept()
        with there:
            there.settimeout(60.0)
            assert there.recv(100) == b"cloud\n"


def test_garbage_has_the_same_length_and_the_same_seed_gives_the_same():
    one, two = Channel("a", seed=3), Channel("b", seed=3)
    for channel in (one, two):
        channel.set("garbage")
    (first,), (second,) = one.pass_on("device", bytes(40)), two.pass_on("device", bytes(40))
    assert first == second != bytes(40)
    assert len(first) == 40
    assert one.pass_on("device", b"next") == [b"next"]


def test_a_flipped_bit_is_one_bit_and_another_seed_flips_another():
    flipped = []
    for seed in range(20):
        channel = Channel("a")
        channel.set("flip", seed=seed)
        (message,) = channel.pass_on("device", b"21.5 C\n")
        flipped.append(int.from_bytes(message, "big") ^ int.from_bytes(b"21.5 C\n", "big"))
    assert {bits.bit_count() for bits in flipped} == {1}
    assert len(set(flipped)) > 10


@needs_terminal
def test_datagrams_and_serial_lines_pass_too():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as driver, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as device:
        for sock in (driver, device):
            sock.bind(("127.0.0.1", 0))
            sock.settimeout(60.0)
        with UdpProxy(Channel("rsi"), driver.getsockname()) as proxy:
            device.sendto(b"telegram", proxy.address)
            data, back = driver.recvfrom(100)
            driver.sendto(b"answer", back)
            assert (data, device.recv(100)) == (b"telegram", b"answer")
            assert proxy.channel.count == {"device": 1, "driver": 1}
    with socket.create_server(("127.0.0.1", 0)) as device, PtyProxy(Channel("line"), device.getsockname(), cut=ended(b"\n")) as proxy:
        there, _ = device.accept()
        with there, open(proxy.path, "r+b", buffering=0) as port:
            there.sendall(b"T=1\n")
            assert port.read(100) == b"T=1\n"
            port.write(b"T?\n")
            there.settimeout(60.0)
            assert there.recv(100) == b"T?\n"


def test_a_plug_that_is_pulled_while_the_line_is_made_ends_no_proxy(monkeypatch):
    """The connection may be closed between its making and its use; the line is then made again."""
    connect, made = socket.create_connection, []

    def pulled_at_once(*arguments):
        made.append(connect(*arguments))
        if len(made) == 1:
            made[0].close()
        return made[-1]

    with socket.create_server(("127.0.0.1", 0)) as device:
        monkeypatch.setattr(socket, "create_connection", pulled_at_once)
        with PtyProxy(Channel("line"), device.getsockname(), cut=ended(b"\n")) as proxy:
            device.accept()[0].close()
            there, _ = device.accept()
            with there, open(proxy.path, "r+b", buffering=0) as port:
                there.sendall(b"T=1\n")
                assert port.read(100) == b"T=1\n"


@pytest.mark.parametrize(
    ("data", "size"), [(b"", 0), (b"\x05\0\0", 0), (b"\x05\0\0\0", 0), (b"\x05\0\0\0x", 5), (b"\x05\0\0\0xy", 5), (b"\0\0\0\0", 4)]
)
def test_a_length_field_cuts_messages(data, size):
    assert counted()(data) == size
    assert counted(at=4, size=2, order="big", plus=6)(b"\0\1\0\0\0\2ab") == 8
