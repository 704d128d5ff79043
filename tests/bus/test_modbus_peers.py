"""pymodbus's own client at the fake positioner: what it reads and writes is what our drivers do, in both framings."""

import struct
import time

import pytest
from mbcacq_bus.registers import Register
from mbcacq_fakes.protocols.bus.modbus import FakeModbus, FakePositioner
from pymodbus import FramerType
from pymodbus.client import ModbusTcpClient


@pytest.mark.parametrize("framer", [FramerType.SOCKET, FramerType.RTU], ids=["tcp", "rtu"])
def test_the_client_of_pymodbus_drives_the_fake_positioner(framer):
    positioner = FakePositioner(
        {"1": 100.0, "2": 152.5},
        Register(address=10, type="float32"),
        Register(address=3, table="discrete"),
        Register(address=20, table="input", type="float32"),
        travel_s=0.0,
    )
    identity = Register(address=40, type="uint16")
    with FakeModbus(positioner, [(identity, lambda: 4711.0)], rtu=framer is FramerType.RTU) as fake:
        with ModbusTcpClient(fake.host, port=fake.port, framer=framer, timeout=20.0) as client:
            assert client.read_holding_registers(40, count=1).registers == [4711]
            written = struct.unpack(">HH", struct.pack(">f", 152.5))
            assert not client.write_registers(10, list(written)).isError()
            deadline = time.monotonic() + 600.0
            while not client.read_discrete_inputs(3, count=1).bits[0]:
                assert time.monotonic() < deadline
            high, low = client.read_input_registers(20, count=2).registers
            assert struct.unpack(">f", struct.pack(">HH", high, low)) == (152.5,)
            assert client.read_holding_registers(1023, count=2).isError()  # beyond the table
    assert positioner.station == "2"
