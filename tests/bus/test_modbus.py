import sys
import threading

import pytest
from mbcacq_bus.modbus import ModbusPositioner, ModbusSensor
from mbcacq_bus.registers import Register
from mbcacq_fakes.protocols.bus.modbus import FakeModbus, FakePositioner

from mbcacq.conformance import Channel, PtyProxy
from mbcacq.devices import Aborted, ConfigError, ConnectError, DeviceFault, DeviceTimeout, IdentityError, Positioner, Sensor, create

POSITION = {"address": 10, "type": "float32", "unit": "mm"}
FLAG = {"address": 3, "table": "discrete"}
ACTUAL = {"address": 20, "table": "input", "type": "float32", "unit": "mm"}


def fake(**more):
    return FakeModbus(FakePositioner({"1": 100.0, "2": 152.5}, Register(**POSITION), Register(**FLAG), **more))


def options(server, **more):
    return {
        "host": server.host,
        "port": server.port,
        "timeout_s": 20.0,
        "retries": 0,
        "stations": {1: 100.0, 2: 152.5},
        "position": POSITION,
        "in_position": FLAG,
        **more,
    }


def test_position_goes_out_as_two_big_endian_registers():
    with fake() as server, ModbusPositioner("p", "tripod", options(server)) as positioner:
        positioner.go_to("2", "")
        # Modbus TCP: transaction, protocol 0, length, unit 1 | write 16, address 10, 2 registers, 4 bytes, 152.5 as IEEE 754.
        assert server.received[0][2:] == bytes.fromhex("0000 000b 01 10 000a 0002 04 43188000")
        assert server.sent[0][2:] == bytes.fromhex("0000 0006 01 10 000a 0002")
        assert server.positioner.station == "2"


@pytest.mark.parametrize(
    ("spec", "value", "words"),
    [
        ({"type": "float32", "word_order": "little"}, 152.5, [0x8000, 0x4318]),
        ({"type": "int16", "scale": 0.1}, -12.3, [0xFF85]),
        ({"type": "int32", "scale": 0.001}, 70.0, [0x0001, 0x1170]),
        ({"type": "uint16", "offset": 5.0}, 47.0, [42]),
    ],
)
def test_register_codes(spec, value, words):
    register = Register(address=0, **spec)
    assert register.encode(value) == words
    assert register.decode(words) == pytest.approx(value, abs=1e-9)


def test_a_value_that_does_not_fit_is_refused_before_anything_is_sent():
    with fake() as server:
        spec = {"address": 10, "type": "int16", "scale": 0.001}
        with ModbusPositioner("p", "", options(server, position=spec)) as positioner:
            with pytest.raises(ConfigError, match="station 1.*does not fit a int16"):
                positioner.go_to("1", "")
        assert not server.received


def test_waits_for_the_measured_position_where_there_is_one():
    with fake(actual=Register(**ACTUAL), travel_s=0.15) as server:
        with ModbusPositioner("p", "", options(server, actual=ACTUAL)) as positioner:
            positioner.go_to("1", "")
            assert server.positioner.arrived


def test_stuck_positioner_times_out_and_says_where_it_is():
    with fake(actual=Register(**ACTUAL), stuck=True) as server:
        with ModbusPositioner("p", "", options(server, actual=ACTUAL, move_timeout_s=0.2)) as positioner:
            with pytest.raises(DeviceTimeout, match="did not reach station 1.*at -999 mm"):
                positioner.go_to("1", "")


def test_reported_fault_ends_the_motion():
    fault = {"address": 30}
    with fake(fault_register=Register(**fault), fault=7) as server:
        with ModbusPositioner("p", "", options(server, fault=fault)) as positioner:
            with pytest.raises(DeviceFault, match="fault 7"):
                positioner.go_to("1", "")


def test_stop_from_another_thread_ends_the_wait_and_writes_halt():
    halt = {"address": 5, "table": "coil"}
    with fake(stuck=True) as server, ModbusPositioner("p", "", options(server, halt=halt)) as positioner:
        timer = threading.Timer(0.15, positioner.stop)
        timer.start()
        with pytest.raises(Aborted, match="station 1"):
            positioner.go_to("1", "")
        timer.join()
        positioner.stop()
        assert server.memory["coil"][5] == 1


def test_a_request_that_gives_way_to_a_stop_is_an_end_by_that_stop(monkeypatch):
    """The stop comes between two looks at the position: the next request is not sent, since the one that halts goes first."""
    with fake(stuck=True) as server, ModbusPositioner("p", "", options(server)) as positioner:
        link, read = positioner._link, positioner._link.read

        def stopped_meanwhile(register):
            positioner.stop()
            link._hurry.set()
            return read(register)

        monkeypatch.setattr(link, "read", stopped_meanwhile)
        with pytest.raises(Aborted, match="station 1"):
            positioner.go_to("1", "")


def test_silent_device_and_absent_device_are_different_errors():
    with fake() as server:
        positioner = ModbusPositioner("p", "", options(server, timeout_s=0.4))
        positioner.connect()
        server.silent = True
        with pytest.raises(DeviceTimeout):
            positioner.go_to("1", "")
        positioner.close()
    with pytest.raises(ConnectError, match="does not answer"):
        ModbusPositioner("p", "", options(server)).connect()


def test_unknown_address_is_a_device_fault_with_advice():
    with fake() as server:
        with ModbusPositioner("p", "", options(server, in_position={"address": 60000, "table": "input"})) as positioner:
            with pytest.raises(DeviceFault, match="there is no such address.*check the registers"):
                positioner.go_to("1", "")


class Gateway(FakeModbus):
    """Answers every request for a unit by an exception."""

    exception = 0

    def _trace(self, sending, data):
        data = super()._trace(sending, data)
        return data[:4] + b"\x00\x03" + data[6:7] + bytes([data[7] | 0x80, self.exception]) if sending and self.exception else data


@pytest.mark.parametrize(("code", "reason"), [(10, "no path to that unit"), (11, "behind the gateway does not answer")])
def test_a_gateway_without_that_unit_is_no_matter_of_registers(code, reason):
    with Gateway(FakePositioner({"1": 100.0, "2": 152.5}, Register(**POSITION), Register(**FLAG))) as server:
        with ModbusPositioner("p", "", options(server, device_id=7)) as positioner:
            server.exception = code
            with pytest.raises(DeviceFault, match=rf"{reason}; check the device id \(7 in the plan\)"):
                positioner.go_to("1", "")


def test_the_wrong_box_is_refused():
    model = Register(address=100)
    with FakeModbus(values=[(model, lambda: 4711.0)]) as server:
        good = {"where": {"address": 100}, "equals": 4711}
        values = {"t": {"address": 100}}
        link = {"host": server.host, "port": server.port, "values": values}
        with ModbusSensor("s", "", {**link, "identity": good}) as sensor:
            assert sensor.read() == {"t": 4711.0}
        with pytest.raises(IdentityError, match="4711, not as 12"):
            ModbusSensor("s", "", {**link, "identity": {**good, "equals": 12}}).connect()


def test_a_drive_that_is_off_is_not_sent_anywhere():
    ready = Register(address=6, table="coil")
    with fake() as server, ModbusPositioner("p", "", options(server, ready=ready.model_dump())) as positioner:
        with pytest.raises(DeviceFault, match="not ready to go to station 1; switch its drive on"):
            positioner.go_to("1", "")
        assert server.positioner.target is None
        server.values.append((ready, lambda: 1.0))
        positioner.go_to("1", "")
        assert server.positioner.station == "1"


def test_a_station_beyond_the_limits_is_refused_before_connecting():
    with pytest.raises(ConfigError, match=r"station 2 at 152\.5 is outside the limits 0\.\.150"):
        ModbusPositioner(
            "p", "", {"host": "h", "stations": {1: 1.0, 2: 152.5}, "position": POSITION, "in_position": FLAG, "limits": [0, 150]}
        )


def test_a_probe_beyond_what_it_can_read_is_broken():
    arm = {"address": 4, "type": "int16", "scale": 0.1, "valid": [-20, 80]}
    with FakeModbus(values=[(Register(**arm), lambda: 850.0)]) as server:
        with ModbusSensor("s", "", {"host": server.host, "port": server.port, "values": {"robot_C": arm}}) as sensor:
            with pytest.raises(DeviceFault, match="850 for robot_C"):
                sensor.read()


@pytest.mark.skipif(sys.platform == "win32", reason="no pseudo-terminals")
def test_rtu_over_a_terminal_device_and_the_cable_pulled():
    with fake() as server:
        server.stop()
    with FakeModbus(server.positioner, rtu=True) as server:
        with PtyProxy(Channel("line"), server.address) as cable:
            link = {k: v for k, v in options(server).items() if k not in ("host", "port")}
            with ModbusPositioner("p", "", {**link, "serial": cable.path, "parity": "N", "baudrate": 115200}) as positioner:
                positioner.go_to("2", "")
                # unit 1 | write 16, address 10, 2 registers, 4 bytes, 152.5 as IEEE 754 | CRC
                assert server.received[0][:11] == bytes.fromhex("01 10 000a 0002 04 43188000")
                assert server.positioner.station == "2"
                cable.stop()
                with pytest.raises(DeviceTimeout, match=r"broke the connection|was lost|gave no valid answer"):
                    positioner.go_to("1", "")


@pytest.mark.parametrize("rtu", [False, True], ids=["tcp", "rtu"])
def test_temperatures_over_tcp_and_over_rtu_on_a_serial_server(rtu):
    air = Register(address=0, table="input", type="int16", scale=0.1, unit="C")
    arm = Register(address=4, table="holding", type="float32", word_order="little", unit="C")
    spec = {"air_C": air.model_dump(), "robot_C": arm.model_dump()}
    with FakeModbus(values=[(air, lambda: -3.2), (arm, lambda: 27.25)], rtu=rtu) as server:
        link = {"serial": f"socket://{server.host}:{server.port}"} if rtu else {"host": server.host, "port": server.port}
        with ModbusSensor("s", "", {**link, "values": spec}) as sensor:
            assert sensor.read() == pytest.approx({"air_C": -3.2, "robot_C": 27.25})
            answer = server.sent[0]
            assert (answer[:-2] if rtu else answer[6:]) == bytes.fromhex("01 04 02 ffe0")
            assert [(f.name, f.unit) for f in sensor.describe().fields] == [("air_C", "C"), ("robot_C", "C")]


def test_a_broken_probe_is_no_number():
    arm = Register(address=4, type="float32")
    with FakeModbus(values=[(arm, lambda: float("nan"))]) as server:
        with ModbusSensor(
            "s", "", {"host": server.host, "port": server.port, "values": {"robot_C": {"address": 4, "type": "float32"}}}
        ) as s:
            with pytest.raises(DeviceFault, match="nan for robot_C"):
                s.read()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"adress": 1}, "adress"),
        ({"host": None}, "either host or serial"),
        ({"position": {"address": 10, "table": "input"}}, "cannot be written"),
        ({"position": {"address": 70000}}, "position.address"),
    ],
)
def test_wrong_options_are_one_sentence(change, words):
    base = {"host": "127.0.0.1", "stations": {1: 0.0}, "position": POSITION, "in_position": FLAG}
    with pytest.raises(ConfigError, match=words):
        ModbusPositioner("p", "", {**base, **change})


def test_registered_under_their_names():
    base = {"host": "127.0.0.1", "stations": {1: 0.0}, "position": POSITION, "in_position": FLAG}
    assert isinstance(create("positioners", "modbus", "", base), Positioner)
    assert isinstance(create("sensors", "modbus", "", {"host": "h", "values": {"t": {"address": 0}}}), Sensor)
    assert isinstance(create("positioners", "manual", "", {}), Positioner)
    assert isinstance(create("sensors", "serial", "", {"port": "loop://", "line": "(?P<t>.*)"}), Sensor)
