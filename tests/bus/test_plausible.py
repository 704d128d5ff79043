"""Values of one reading against the last: exchanged ones, and faster ones than the plan allows."""

import pytest
from mbcacq_bus import serial_link
from mbcacq_bus.modbus import ModbusSensor
from mbcacq_bus.plausible import Plausibility
from mbcacq_bus.registers import Register
from mbcacq_bus.serial import SerialSensor
from mbcacq_fakes.protocols.bus.modbus import FakeModbus
from mbcacq_fakes.protocols.bus.serial_sensor import FakeSerialSensor

from mbcacq.conformance.bounded import eventually
from mbcacq.devices import ConfigError, DeviceFault

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
    assert plausible.doubt({"robot_C": 30.9, "air_C": 24.0}, 10.0) is None
    assert "robot_C went from 30 to 31.5 in 10.0 s" in plausible.doubt({"robot_C": 31.5, "air_C": 21.5}, 10.0).text


def test_a_flipped_bit_of_a_temperature_is_read_again_and_recorded():
    """226.3 for 21.5: the second reading counts. A jump that stays is believed, as somebody may have opened a gate."""
    plausible, at = watched({"air_C": 21.5, "humidity": 40.0}), [20.0]
    assert (
        plausible.checked("sensor", {"air_C": 226.3, "humidity": 40.0}, lambda _: {"air_C": 21.6, "humidity": 40.0}, lambda: at[0])["air_C"]
        == 21.6
    )
    (fact,) = plausible.facts()
    assert fact.text == "air_C went from 21.5 to 226.3 in 20.0 s, faster than temperatures change; read again: air_C 21.6, humidity 40"
    assert not fact.critical
    cold = {"air_C": 4.0, "humidity": 90.0}
    assert plausible.checked("sensor", dict(cold), lambda _: dict(cold), lambda: 40.0) == cold
    assert plausible.doubt({"air_C": 5.0, "humidity": 10.0}, 60.0) is None


def test_a_small_flip_is_outvoted_and_a_small_change_is_not():
    plausible, true = watched({"air_C": 21.5, "humidity": 40.0}, rates={"humidity": 1.0}), {"air_C": 21.6, "humidity": 40.0}
    for wrong in ({"air_C": 21.9, "humidity": 40.0}, {"air_C": 21.6, "humidity": 41.0}):
        assert plausible.checked("sensor", dict(wrong), lambda _: dict(true), lambda: 1.0) == true
        said = ", ".join(f"{name} {value:g}, then {true[name]:g}" for name, value in wrong.items() if value != true[name])
        assert [fact.text for fact in plausible.facts()] == [f"the first of three readings was another: {said}"]
    warmer = {"air_C": 22.0, "humidity": 41.0}
    assert plausible.checked("sensor", dict(warmer), lambda _: dict(warmer), lambda: 2.0) == warmer


def test_a_plan_s_own_rate_takes_the_place_of_the_default():
    fast = Plausibility({"tip_C": "C"}, {"tip_C": 100.0})
    fast.believe({"tip_C": 20.0}, 0.0)
    assert fast.doubt({"tip_C": 90.0}, 1.0) is None


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


TWO = r"T=(?P<air_C>[-+0-9.]+) R=(?P<robot_C>[-+0-9.]+)"


@pytest.fixture
def patient(monkeypatch):
    """Options of a sensor that waits long for an answer, and not so long for silence."""
    monkeypatch.setattr(serial_link, "_QUIET", 0.01)
    return {"line": TWO, "units": {"air_C": "C", "robot_C": "C"}, "timeout_s": 30.0}


@pytest.mark.parametrize("ask", [None, "READ?\n"], ids=["streamed", "asked"])
def test_a_line_whose_values_change_places_is_refused_after_a_second_look(ask, patient):
    said = ["T=21.0 R=30.0"]
    with FakeSerialSensor(lambda: said[0]) as fake:
        fake._answer = lambda heard: said[0]
        fake.silent = ask is not None
        with SerialSensor("s", "", {**patient, "port": fake.url, "ask": ask}) as sensor:
            for _ in range(3):
                assert sensor.read() == {"air_C": 21.0, "robot_C": 30.0}
            said[0] = "T=30.0 R=21.0"
            eventually(lambda: ask is not None or sensor._values["air_C"] == 30.0, 600.0, "the line has come")
            with pytest.raises(DeviceFault, match="values are exchanged: .*check its probes"):
                sensor.read()


def test_one_line_out_of_place_is_read_again_and_a_jump_beyond_max_rate_is_refused(patient):
    answers = iter(["T=21.0 R=30.0"] * 4 + ["T=30.0 R=21.0", "T=21.0 R=30.1", "T=26.5 R=30.1", "T=26.5 R=30.1"])
    with FakeSerialSensor(lambda: "") as fake:
        fake._answer, fake.silent = lambda heard: next(answers), True
        spec = {**patient, "port": fake.url, "ask": "READ?\n"}
        with SerialSensor("s", "", {**spec, "max_rate": {"air_C": 0.001}}) as sensor:
            for _ in range(3):
                sensor.read()
            assert sensor.read() == {"air_C": 21.0, "robot_C": 30.1}
            with pytest.raises(DeviceFault, match=r"air_C went from 21 to 26\.5 in .* faster than its max_rate"):
                sensor.read()
    with pytest.raises(ConfigError, match="max_rate names 'oil_C', which line does not"):
        SerialSensor("s", "", {**spec, "max_rate": {"oil_C": 1.0}})


def test_a_very_first_reading_with_a_flipped_bit_is_read_again(patient):
    """21.0 with one bit flipped is 01.0; without a reading before it nothing else could tell."""
    answers = iter(["T=01.0 R=30.0", "T=21.0 R=30.0", "T=21.0 R=30.0", "T=21.1 R=30.0"])
    with FakeSerialSensor(lambda: "") as fake:
        fake._answer, fake.silent = lambda heard: next(answers), True
        with SerialSensor("s", "", {**patient, "port": fake.url, "ask": "READ?\n", "units": {"air_C": "C"}}) as sensor:
            assert sensor.read() == {"air_C": 21.0, "robot_C": 30.0}
            assert sensor.read() == {"air_C": 21.1, "robot_C": 30.0}
