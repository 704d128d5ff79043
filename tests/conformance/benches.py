"""A bench for every driver of ours, with its fake at the wire."""

from __future__ import annotations

from functools import partial

from bench_bus import modbus_positioner, modbus_sensor, serial_positioner, serial_sensor
from bench_gocator import gocator
from bench_gopxl import gopxl
from bench_kuka import kuka_eki, kuka_rsi
from bench_manual import EXCUSED, manual

from mbcacq.conformance import TestStand

NO_IDENTITY = {"refuses_the_wrong_device": "RSI telegrams carry no identity; the bench with EKI has it"}
BENCHES = {
    bench.name: bench
    for bench in (
        TestStand("gocator", "scanner", gocator),
        TestStand("gocator trigger", "scanner", partial(gocator, mode="trigger")),
        TestStand("gopxl", "scanner", gopxl),
        TestStand("kuka_rsi", "robot", kuka_rsi, excused=NO_IDENTITY),
        TestStand("kuka_rsi with EKI", "robot", partial(kuka_rsi, eki=True)),
        TestStand("kuka_eki", "robot", kuka_eki),
        TestStand("manual", "positioner", manual, excused=EXCUSED),
        TestStand("modbus positioner", "positioner", modbus_positioner),
        TestStand("modbus sensor", "sensor", modbus_sensor),
        TestStand("modbus sensor RTU", "sensor", partial(modbus_sensor, rtu=True)),
        TestStand("serial positioner", "positioner", serial_positioner),
        TestStand("serial sensor", "sensor", serial_sensor),
        TestStand("serial sensor pty", "sensor", partial(serial_sensor, pty=True)),
    )
}
