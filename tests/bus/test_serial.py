import socket
import sys
import threading
import time

import pytest
from mbcacq_bus.serial import SerialSensor
from mbcacq_fakes.protocols.bus.serial_sensor import FakeSerialSensor
from scripted_line import ScriptedLine

from mbcacq.devices import ConfigError, ConnectError, DeviceFault, DeviceTimeout, IdentityError, ProtocolError

LINE = r"T=(?P<air_C>[-+0-9.]+) R=(?P<robot_C>[-+0-9.]+)"

needs_terminal = pytest.mark.skipif(sys.platform == "win32", reason="Windows has no pseudo-terminals")


def test_streamed_lines_become_named_values():
    with FakeSerialSensor(lambda: "T=21.5 R=28.0") as fake:
        with SerialSensor("s", "probe", {"port": fake.url, "line": LINE, "units": {"air_C": "C"}}) as sensor:
            assert sensor.read() == {"air_C": 21.5, "robot_C": 28.0}
            assert [(f.name, f.unit) for f in sensor.describe().fields] == [("air_C", "C"), ("robot_C", "")]


@needs_terminal
def test_raw_numbers_are_scaled_and_a_broken_probe_is_named_on_a_terminal_device():
    spec = {
        "line": r"T=(?P<air_C>[-+0-9.]+) R=(?P<robot_C>[-+0-9.]+)",
        "scale": {"air_C": 0.1},
        "offset": {"air_C": -5.0},
        "valid": {"robot_C": [-20, 80]},
    }
    said = ["T=255 R=31"]
    with FakeSerialSensor(lambda: said[0], pty=True) as fake:
        assert fake.url.startswith("/dev/")
        with SerialSensor("s", "", {"port": fake.url, **spec}) as sensor:
            assert sensor.read() == pytest.approx({"air_C": 20.5, "robot_C": 31.0})
            said[0] = "T=255 R=850"
            deadline = time.monotonic() + 600.0
            while time.monotonic() < deadline and sensor._values["robot_C"] != 850:
                time.sleep(0.01)
            with pytest.raises(DeviceFault, match="850 for robot_C; is its probe connected"):
                sensor.read()
    with pytest.raises(ConfigError, match="scale names 'air', which line does not"):
        SerialSensor("s", "", {"port": "x", "line": LINE, "scale": {"air": 0.1}})


def test_a_line_cut_in_half_is_not_taken():
    """The first bytes after opening may be the end of a line: '1.5' of 'T=21.5' would be a wrong temperature."""
    opened = threading.Event()
    with socket.create_server(("127.0.0.1", 0)) as listener:

        def speak():
            client, _ = listener.accept()
            with client:
                opened.wait(5)
                client.sendall(b"1.5\r\n22.")
                client.sendall(b"75\r\n")
                client.recv(1)

        thread = threading.Thread(target=speak)
        thread.start()
        port = listener.getsockname()[1]
        with SerialSensor("s", "", {"port": f"socket://127.0.0.1:{port}", "line": r"(?P<value>[0-9.]+)"}) as sensor:
            opened.set()
            assert sensor.read() == {"value": 22.75}
        thread.join()


def test_polled_sensor_and_identity(monkeypatch):
    with FakeSerialSensor(lambda: "unasked", answers={"READ?": "T=1.25 R=-3", "*IDN?": "ACME,PT100,7"}) as fake:
        fake.silent = True
        spec = {"port": fake.url, "line": LINE, "ask": "READ?\n", "identity": {"ask": "*IDN?\n", "expect": "ACME,.*"}}
        with SerialSensor("s", "", spec) as sensor:
            assert sensor.read() == {"air_C": 1.25, "robot_C": -3.0}
    ScriptedLine(lambda heard: (0.01, b"ACME,PT100,7\n")).install(monkeypatch)
    wrong = {**spec, "identity": {"ask": "*IDN?\n", "expect": "OTHER.*"}, "timeout_s": 20.0}
    with pytest.raises(IdentityError, match="ACME,PT100,7"):
        SerialSensor("s", "", wrong).connect()


def test_silence_garbage_and_loss_are_named():
    with FakeSerialSensor(lambda: "???") as fake:
        sensor = SerialSensor("s", "", {"port": fake.url, "line": LINE, "timeout_s": 0.3})
        sensor.connect()
        with pytest.raises(DeviceTimeout, match="nothing that matches"):
            sensor.read()
        fake.stop()
        with pytest.raises((ProtocolError, DeviceTimeout)):
            sensor.read()
        sensor.close()
        sensor.close()


def test_a_matching_line_without_a_number_is_an_error_not_a_value():
    with FakeSerialSensor(lambda: "T=-- R=nan") as fake:
        with SerialSensor("s", "", {"port": fake.url, "line": r"T=(?P<air_C>\S+) R=(?P<robot_C>\S+)", "timeout_s": 20.0}) as sensor:
            with pytest.raises(ProtocolError, match="not every group is a number"):
                sensor.read()


def test_wrong_port_and_wrong_pattern():
    with pytest.raises(ConnectError, match="cannot be opened"):
        SerialSensor("s", "", {"port": "/dev/does-not-exist", "line": LINE}).connect()
    with pytest.raises(ConfigError, match="named groups"):
        SerialSensor("s", "", {"port": "x", "line": "T=.*"})
    with pytest.raises(ConfigError, match="not a regular expression"):
        SerialSensor("s", "", {"port": "x", "line": "(?P<a>"})
