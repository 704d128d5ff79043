"""Values of one reading against the last: exchanged ones, and faster ones than the plan allows."""

import pytest
from mbcacq_bus.modbus import ModbusSensor
from mbcacq_bus.plausible import Plausibility
from mbcacq_bus.registers import Register
from mbcacq_fakes.protocols.bus.modbus import FakeModbus

from mbcacq.devices import DeviceFault

UNITS = {"robot_C": "C", "air_C": "C", "humidity": "%"}


def watched(*readings, rates=None):
    plausible = Plausibility(UNITS, rates or {})
    for k, reading in enumerate(readings):
        plausible.believe(reading, float(k))
    return plausible


def test_two_values_exchanged_are_found_and_a_slow_crossing_is_not():
    steady = [{"robot_C": 30.1, "air_C": 21.5, "humidity": 30.1}] * 3
    found = watched(*steady).doubt({"robot_C": 21.5, "air_C": 30.1, "humidity": 30.1}, 4.0)
    assert found.sure
    assert "robot_C reads 21.5 as air_C did before" in found.text
    crossing = [{"robot_C": 24.0 + 0.3 * k, "air_C": 25.0 - 0.3 * k} for k in range(8)]
    for k in range(3, 8):
        assert watched(*crossing[:k]).doubt(crossing[k], float(k)) is None


def test_noise_of_two_equal_probes_is_no_exchange():
    noisy = [{"robot_C": 21.5 + 0.02 * (k % 2), "air_C": 21.52 - 0.02 * (k % 2)} for k in range(9)]
    for k in range(4, 9):
        assert watched(*noisy[:k]).doubt(noisy[k], float(k)) is None


def test_a_faster_change_than_the_plan_allows_is_found():
    plausible = watched({"robot_C": 30.0, "air_C": 21.5}, rates={"robot_C": 0.1})
    assert plausible.doubt({"robot_C": 30.9, "air_C": 40.0}, 10.0) is None
    assert "robot_C went from 30 to 31.5 in 10.0 s" in plausible.doubt({"robot_C": 31.5, "air_C": 21.5}, 10.0).text


def test_a_device_that_exchanges_its_registers_is_refused_after_a_second_look():
    arm, air = Register(address=0, unit="C"), Register(address=1, unit="C")
    swapped = [False]
    live = [(arm, lambda: 21.0 if swapped[0] else 30.0), (air, lambda: 30.0 if swapped[0] else 21.0)]
    with FakeModbus(values=live) as server:
        values = {"robot_C": arm.model_dump(), "air_C": air.model_dump()}
        with ModbusSensor("s", "", {"host": server.host, "port": server.port, "values": values, "timeout_s": 20.0}) as sensor:
            for _ in range(3):
                sensor.read()
            swapped[0] = True
            with pytest.raises(DeviceFault, match="values are exchanged: .*check its probes"):
                sensor.read()
            swapped[0] = False
            assert sensor.read() == {"robot_C": 30.0, "air_C": 21.0}
