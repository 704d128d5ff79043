"""Positioners and sensors on Modbus and serial lines, in front of their fakes."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from mbcacq_bus.modbus import ModbusPositioner, ModbusSensor
from mbcacq_bus.registers import Register
from mbcacq_bus.serial import SerialSensor
from mbcacq_bus.serial_positioner import SerialPositioner, SerialPositionerOptions
from mbcacq_fakes.protocols.bus.modbus import FakeModbus, FakePositioner
from mbcacq_fakes.protocols.bus.serial_positioner import FakeSerialPositioner
from mbcacq_fakes.protocols.bus.serial_sensor import FakeSerialSensor

from mbcacq.conformance import Channel, PtyProxy, Stand, TcpProxy, counted, ended
from mbcacq.devices import parse_options

MBAP = counted(at=4, size=2, order="big", plus=6)
LINE = ended(b"\n")
WORDS = {
    "stations": {"1": 0.0, "2": 152.5},
    "scale": 0.01,
    "move": {"send": "MA {raw:.0f}\r\n", "reply": "OK"},
    "position": {"send": "?P\r\n", "reply": r"P=(?P<raw>[-+]?\d+)"},
    "ready": {"send": "?S\r\n", "reply": "S=READY"},
    "halt": {"send": "ST\r\n"},
    "identity": {"ask": "*IDN?\r\n", "expect": "LIFT 3000"},
}
IN_POSITION, POSITION, ACTUAL = (
    {"address": 3, "table": "discrete"},
    {"address": 10, "type": "int32", "scale": 0.1},
    {"address": 20, "type": "float32"},
)
HASTY = {"timeout_s": 0.3}
IDENTITY = {"address": 100, "table": "input"}


@contextmanager
def modbus_positioner() -> Iterator[Stand]:
    lift = FakePositioner({"1": 0.0, "2": 120.0}, Register(**POSITION), Register(**IN_POSITION), Register(**ACTUAL), travel_s=0.03)
    given = {
        "stations": {"1": 0.0, "2": 120.0},
        "position": POSITION,
        "in_position": IN_POSITION,
        "actual": ACTUAL,
        "move_timeout_s": 10.0,
        "identity": {"where": IDENTITY, "equals": 4711},
    }
    with _modbus(FakeModbus(lift, [(Register(**IDENTITY), lambda: 4711.0)]), given, ModbusPositioner) as (make, proxies):

        def use(positioner: ModbusPositioner) -> None:
            station = "2" if lift.target == 0.0 else "1"
            positioner.go_to(station, "")
            assert lift.station == station, f"it says it is at station {station}, but it stands at {lift.station}"

        def begin(positioner: ModbusPositioner) -> None:
            lift.travel_s = 1.0
            try:
                positioner.go_to("2" if lift.target == 0.0 else "1", "")
            finally:
                lift.travel_s = 0.03

        def wrong() -> ModbusPositioner:
            return make(identity={"where": IDENTITY, "equals": 12})

        facts = {"in position": lambda: setattr(lift, "stuck", True)}
        yield Stand(make, use, proxies, wrong, begin, lambda: lift.arrived, HASTY, facts=facts)


@contextmanager
def modbus_sensor(rtu: bool = False) -> Iterator[Stand]:
    values = {"air_C": {"address": 4, "type": "int16", "scale": 0.1}, "scanner_C": {"address": 40, "table": "input", "type": "float32"}}
    known = {"air_C": 21.5, "scanner_C": 38.25}
    flipped: list[float] = []  # what the air reads once

    def air() -> float:
        return flipped.pop() if flipped else known["air_C"]

    served = [(Register(**values["air_C"]), air), (Register(**values["scanner_C"]), lambda: known["scanner_C"])]
    served.append((Register(**IDENTITY), lambda: 4711.0))
    given = {"values": values, "identity": {"where": IDENTITY, "equals": 4711}}
    with _modbus(FakeModbus(values=served, rtu=rtu), given, ModbusSensor, rtu) as (make, proxies):

        def use(sensor: ModbusSensor) -> None:
            assert (got := sensor.read()) == known, f"it reads {got} instead of {known}"

        facts = {"doubted reading": lambda: flipped.append(226.3)}
        yield Stand(make, use, proxies, lambda: make(identity={"where": IDENTITY, "equals": 12}), short_limits=HASTY, facts=facts)


@contextmanager
def _modbus(fake: FakeModbus, given: dict[str, Any], driver: type, rtu: bool = False) -> Iterator[tuple]:
    cuts = {} if rtu else {"cut": MBAP, "cut_driver": MBAP}
    with fake, TcpProxy(Channel("modbus"), fake.address, **cuts) as proxy:
        where = {"serial": f"socket://127.0.0.1:{proxy.port}"} if rtu else {"host": "127.0.0.1", "port": proxy.port}
        yield lambda **o: driver("lift", "L4", {**where, **given, "timeout_s": 15.0, "retries": 1, **o}), {"modbus": proxy}


class Thermometer(dict):
    """Answers by request; every temperature is a hundredth higher than the one before, but for one that is ``flipped``."""

    readings, flipped = 0, False

    def get(self, request: str, default: str | None = None) -> str | None:
        if request == "T?":
            self.readings, wrong, self.flipped = self.readings + 1, 200 * self.flipped, False
            return f"T={20 + wrong + self.readings / 100:.2f} H=40"
        return {"ID?": "THERM-2"}.get(request, default)


@contextmanager
def serial_sensor(pty: bool = False) -> Iterator[Stand]:
    thermometer = Thermometer({"": ""})
    with FakeSerialSensor(lambda: "", answers=thermometer) as fake:
        fake.silent = True
        kind = PtyProxy if pty else TcpProxy
        with kind(Channel("line"), fake.address, cut=ended(b"\n"), cut_driver=ended(b"\n")) as proxy:
            given = {
                "port": proxy.path if pty else f"socket://127.0.0.1:{proxy.port}",
                "ask": "T?\n",
                "timeout_s": 3.0,
                "max_rate": {"humidity": 1.0},
                "line": r"T=(?P<air_C>[-+0-9.]+) H=(?P<humidity>[0-9]+)",
                "identity": {"ask": "ID?\n", "expect": "THERM-2"},
            }

            def use(sensor: SerialSensor) -> None:
                """Lines carry no number: after a late or doubled reply the one before may be taken, never an older one."""
                got = sensor.read()
                now = [round(20 + (thermometer.readings - back) / 100, 2) for back in (0, 1)]
                assert got["air_C"] in now, f"it reads {got} where {now} was sent"
                assert got["humidity"] == 40.0, f"it reads {got}"

            def wrong() -> SerialSensor:
                return SerialSensor("thermo", "T2", {**given, **HASTY, "identity": {"ask": "ID?\n", "expect": "BARO-1"}})

            facts = {"doubted reading": lambda: setattr(thermometer, "flipped", True)}
            yield Stand(
                lambda **o: SerialSensor("thermo", "T2", {**given, **o}), use, {"line": proxy}, wrong, short_limits=HASTY, facts=facts
            )


@contextmanager
def serial_positioner() -> Iterator[Stand]:
    with (
        FakeSerialPositioner(parse_options(SerialPositionerOptions, "x", {"port": "x", **WORDS}), travel_s=0.03) as fake,
        PtyProxy(Channel("line"), fake.address, cut=LINE, cut_driver=LINE) as proxy,
    ):
        lift, given = fake.motion, {"port": proxy.path, **WORDS, "timeout_s": 3.0, "move_timeout_s": 10.0}

        def use(positioner: SerialPositioner) -> None:
            station = "2" if lift.target == 0.0 else "1"
            positioner.go_to(station, "")
            assert lift.station == station, f"it says it is at station {station}, but it stands at {lift.station}"

        def begin(positioner: SerialPositioner) -> None:
            lift.travel_s = 1.0
            try:
                positioner.go_to("2" if lift.target == 0.0 else "1", "")
            finally:
                lift.travel_s = 0.03

        def make(**more: Any) -> SerialPositioner:
            return SerialPositioner("lift", "L4", {**given, **more})

        yield Stand(
            make,
            use,
            {"line": proxy},
            lambda: make(timeout_s=0.3, identity={"ask": "*IDN?\r\n", "expect": "LIFT 4000"}),
            begin,
            lambda: lift.arrived,
            HASTY,
            facts={"in position": lambda: setattr(lift, "stuck", True)},
        )
