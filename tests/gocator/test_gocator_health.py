"""Temperatures, overheating and lost scans: a warning once, or the end of the run, as the plan's limits say."""

from __future__ import annotations

import time

import pytest
from gocator_bench import options
from mbcacq_fakes.protocols.gocator import FakeGocator, FakeGocatorOptions
from mbcacq_gocator import health
from mbcacq_gocator.driver import Gocator
from mbcacq_gocator.guard import HealthGuard

from mbcacq.conformance.bounded import eventually
from mbcacq.devices import ConnectError, DeviceFault

OVERHEAT, TRIGGER_DROPS, OUTPUT_DROPS = 20020, 21010, 21011


@pytest.fixture
def sensor(frame):
    with FakeGocator(lambda e: frame, FakeGocatorOptions(health_period_s=0.01)) as made:
        yield made


def until(scanner: Gocator, wanted: str) -> str:
    """Capture until a warning with these words comes; a generous bound against hanging."""
    deadline = time.monotonic() + 600.0
    while time.monotonic() < deadline:
        for warning in scanner.capture().warnings:
            if wanted in warning:
                return warning
    raise AssertionError(f"no warning says '{wanted}'")


def test_a_warm_sensor_is_reported_once_and_a_hot_one_ends_the_run(sensor):
    with Gocator("front", "", options(sensor, temperature_warning_C=50, temperature_stop_C=60)) as scanner:
        assert scanner.capture().warnings == ()
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


@pytest.fixture
def slow_sensor(frame):
    """One health message a second, as real sensors send, of 60 C."""
    with FakeGocator(lambda e: frame, FakeGocatorOptions(health_period_s=1.0)) as made:
        made.state.temperature_C = 60.0
        yield made


def received(scanner: Gocator, name: str, value: float) -> None:
    """Wait until the driver has received this health value, without a capture."""
    eventually(lambda: scanner._session is not None and scanner._session.health.values().get(name) == value, 30.0, f"{name} arrives")


def test_heat_that_is_known_before_the_first_exposure_is_reported_with_it(slow_sensor):
    with Gocator("front", "", options(slow_sensor, temperature_warning_C=50)) as scanner:
        received(scanner, "temperature_C", 60)
        warnings = [warning for _ in range(6) for warning in scanner.capture().warnings]
    assert warnings == [
        "the Gocator's temperature is 60 C, above 50 C: its measurements drift",
        "the Gocator's projector temperature is 64 C, above 50 C: its measurements drift",
    ]


def test_drops_that_are_known_before_an_exposure_are_reported_with_it(slow_sensor):
    slow_sensor.state.indicators.update({(TRIGGER_DROPS, 0): 1, (OUTPUT_DROPS, 0): 2})
    with Gocator("front", "", options(slow_sensor)) as scanner:
        received(scanner, "output_drops", 2)
        assert scanner.capture().warnings == ()
        slow_sensor.state.indicators.update({(TRIGGER_DROPS, 0): 2, (OUTPUT_DROPS, 0): 5})
        received(scanner, "output_drops", 5)
        assert scanner.capture().warnings == (
            "the Gocator counts 1 more triggers that came too fast",
            "the Gocator counts 3 more scans that the network did not take",
        )


def test_a_sensor_without_health_messages_is_reported_when_they_are_due(slow_sensor, monkeypatch):
    slow_sensor.faults.set("mute_health")
    with Gocator("front", "", options(slow_sensor, temperature_stop_C=80)) as scanner:
        assert scanner.capture().warnings == ()  # none can be expected yet
        monkeypatch.setattr(health, "_FIRST_S", 0.0)
        assert scanner.capture().warnings == ("the Gocator reports no temperature, so the limits of the plan are not watched",)


@pytest.mark.parametrize("bracket", ["merge", "best"])
def test_a_bracket_carries_the_warnings_of_all_its_exposures(slow_sensor, bracket):
    with Gocator("front", "", options(slow_sensor, temperature_warning_C=50, exposures_us=[500, 900], bracket=bracket)) as scanner:
        received(scanner, "temperature_C", 60)
        assert len(scanner.capture().warnings) == 2


def test_a_warning_found_before_an_exposure_that_fails_comes_with_the_next_scan(slow_sensor):
    with Gocator("front", "", options(slow_sensor, temperature_warning_C=50)) as scanner:
        received(scanner, "temperature_C", 60)
        slow_sensor.faults.set("close_data", times=1)
        with pytest.raises(ConnectError):
            scanner.capture()
        assert len(scanner.capture().warnings) == 2
