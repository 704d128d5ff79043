"""Why a port cannot be opened, in the system's own words."""

import os
import sys

import pytest
from mbcacq_bus.modbus import ModbusSensor
from mbcacq_bus.serial import SerialSensor
from mbcacq_bus.serial_positioner import SerialPositioner

from mbcacq.devices import ConnectError

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="no pseudo-terminals")


def modbus(port, **more):
    return ModbusSensor("s", "", {"serial": port, "values": {"x": {"address": 0}}, **more})


def sensor(port, **more):
    return SerialSensor("s", "", {"port": port, "line": "(?P<x>.*)", **more})


def positioner(port, **more):
    words = {"stations": {1: 1.0}, "move": {"send": "GO {raw}\n"}, "ready": {"send": "R\n", "reply": "1"}}
    return SerialPositioner("p", "", {"port": port, **words, **more})


@pytest.mark.parametrize("device", [modbus, sensor, positioner])
def test_a_missing_a_busy_and_a_refusing_port(device, tmp_path):
    with pytest.raises(ConnectError, match=r"/dev/ttyNOWHERE.*No such file or directory"):
        device("/dev/ttyNOWHERE").connect()
    (tmp_path / "file").write_text("")
    with pytest.raises(ConnectError, match=r"(Inappropriate ioctl|Could not configure port)"):
        device(str(tmp_path / "file")).connect()
    ours, theirs = os.openpty()
    try:
        port = os.ttyname(theirs)
        with device(port, parity="N"):
            with pytest.raises(ConnectError, match="Could not exclusively lock port.*no other program has it"):
                device(port, parity="N").connect()
    finally:
        os.close(ours)
        os.close(theirs)
    ours, theirs = os.openpty()
    try:
        # A pseudo-terminal of Linux has no parity. POSIX hides that as long as the same call changes the baud rate, say.
        if sys.platform == "linux":
            with pytest.raises(ConnectError, match=r"8E1\): Invalid argument; check"):
                device(os.ttyname(theirs), parity="E").connect()
    finally:
        os.close(ours)
        os.close(theirs)
