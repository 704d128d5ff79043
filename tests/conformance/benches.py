"""A bench for every driver of ours, with its fake at the wire."""

from __future__ import annotations

import sys
from functools import partial

import pytest
from bench_bus import modbus_positioner, modbus_sensor, serial_positioner, serial_sensor
from bench_folder import NO_IDENTITY as NO_IDENTITY_OF_FILES
from bench_folder import folder
from bench_gocator import gocator
from bench_gopxl import gopxl
from bench_kuka import kuka_eki, kuka_rsi
from bench_manual import EXCUSED, manual
from bench_opcua import opcua
from bench_profiles import profiles
from bench_simulated import OPTIONS_OF_OTHERS, simulated
from bench_simulated_scanner import simulated_scanner
from bench_ur import NO_IDENTITY as NO_IDENTITY_OF_UR
from bench_ur import ur_rtde

from mbcacq.conformance import DriverBench

NEEDS_TERMINAL = {"manual", "serial positioner", "serial sensor pty"}  # benches that stand on pseudo-terminals, which Windows has not
NO_IDENTITY = {"refuses_the_wrong_device": "RSI telegrams carry no identity"}
BENCHES = {
    bench.name: bench
    for bench in (
        DriverBench("folder", "scanner", folder, excused=NO_IDENTITY_OF_FILES),
        DriverBench("gocator", "scanner", gocator),
        DriverBench("gocator trigger", "scanner", partial(gocator, mode="trigger")),
        DriverBench("gopxl", "scanner", gopxl),
        DriverBench("gocator profiles", "scanner", partial(profiles, "classic")),
        DriverBench("gopxl profiles", "scanner", partial(profiles, "GoPxL")),
        DriverBench("kuka_rsi", "robot", kuka_rsi, excused=NO_IDENTITY),
        DriverBench("kuka_eki", "robot", kuka_eki),
        DriverBench("simulated", "robot", simulated, excused=OPTIONS_OF_OTHERS),
        DriverBench("simulated scanner", "scanner", simulated_scanner, excused=OPTIONS_OF_OTHERS),
        DriverBench("opcua", "robot", opcua),
        DriverBench("ur_rtde", "robot", ur_rtde, excused=NO_IDENTITY_OF_UR),
        DriverBench("manual", "positioner", manual, excused=EXCUSED),
        DriverBench("modbus positioner", "positioner", modbus_positioner),
        DriverBench("modbus sensor", "sensor", modbus_sensor),
        DriverBench("modbus sensor RTU", "sensor", partial(modbus_sensor, rtu=True)),
        DriverBench("serial positioner", "positioner", serial_positioner),
        DriverBench("serial sensor", "sensor", serial_sensor),
        DriverBench("serial sensor pty", "sensor", partial(serial_sensor, pty=True)),
    )
}


def marked(name: str, *more: object) -> object:
    """A test parameter set that begins with the name of a bench; skipped where that bench cannot stand."""
    no_terminal = pytest.mark.skipif(name in NEEDS_TERMINAL and sys.platform == "win32", reason="Windows has no pseudo-terminals")
    return pytest.param(name, *more, marks=no_terminal)
