"""Temperatures, overheating and lost scans: a warning once, or the end of the run, as the plan's limits say."""

from __future__ import annotations

import time

import pytest
from gocator_bench import options
from mbcacq_fakes.protocols.gocator import FakeGocator, FakeGocatorOptions
from mbcacq_gocator.driver import Gocator
from mbcacq_gocator.guard import HealthGuard

from mbcacq.devices import DeviceFault

OVERHEAT, OUTPUT_DROPS = 20020, 21011


@pytest.fixture
def sensor(frame):
    with FakeGocator(lambda e: frame, FakeGocatorOptions(health_period_s=0.01)) as made:
        yield made


def until(scanner: Gocator, wanted: str) -> str:
    """Capture until a warning with these words comes; a generous bound against hanging."""
    deadline = time.monotonic() + 100
    while time.monotonic() < deadline:
        for warning in scanner.capture().warnings:
            if wanted in warning:
                return warning
    raise AssertionError(f"no warning says '{wanted}'")


def test_a_warm_sensor_is_reported_once_and_a_hot_one_ends_the_run(sensor):
    with Gocator("front", "", options(sensor, temperature_warning_C=50, temperature_stop_C=60)) as scanner:
        assert scanner.capture().warnings in ((), ("the Gocator reports no temperature, so the limits of the plan are not watched",))
        sensor.state.temperature_C = 52.0
        assert until(scanner, "temperature is 52 C, above 50 C")
        assert not any("temperature is" in w and "projector" not in w for w in scanner.capture().warnings)
        sensor.state.temperature_C = 61.0
        with pytest.raises(DeviceFault, match=r"scanner 'front': .*temperature is 6[15] C, above the plan's 60 C; let it cool"):
            until(scanner, "never")


def test_the_sensors_own_word_counts_without_any_limit(sensor):
    with Gocator("front", "", options(sensor)) as scanner:
        scanner.capture()
        sensor.state.indicators[OVERHEAT, 0] = 1
        with pytest.raises(DeviceFault, match="reports that it is overheated"):
            until(scanner, "never")


def test_scans_that_the_sensor_drops_are_counted(sensor):
    sensor.state.indicators[OUTPUT_DROPS, 0] = 2
    with Gocator("front", "", options(sensor)) as scanner:
        while "output_drops" not in scanner.capture().health:
            pass
        sensor.state.indicators[OUTPUT_DROPS, 0] = 5
        assert until(scanner, "counts 3 more scans that the network did not take")


def test_limits_nobody_watches_are_said_once():
    guard = HealthGuard(50, None)
    assert [guard.look({}) for _ in range(2)] == [("the Gocator reports no temperature, so the limits of the plan are not watched",), ()]
    assert guard.look({"temperature_C": 49}) == ()
    assert len(guard.look({})) == 1
    assert HealthGuard(None, None).look({}) == ()


def test_a_warning_comes_again_only_after_cooling_down():
    guard = HealthGuard(50, 70)
    warnings = [len(guard.look({"temperature_C.1": value})) for value in (51, 49, 51, 47, 51)]
    assert warnings == [1, 0, 0, 0, 1]
    with pytest.raises(DeviceFault, match="temperature 1 is 71 C"):
        guard.look({"temperature_C.1": 71})
