"""The sensor is left as it was found: job, exposure and unsaved changes, after a good end, a fault, or a refused plan."""

from __future__ import annotations

import hashlib
import re

import pytest
from gocator_bench import options
from mbcacq_fakes.protocols.gocator import FakeGocator
from mbcacq_gocator.driver import Gocator

from mbcacq.devices import ConfigError, ConnectError, DeviceTimeout, ProtocolError

EXPOSURE = "Setup/Devices/Device[@role='0']/Exposure"
WRITE_FILE, SNAPSHOT, READ_FILE = 0x1006, 0x4528, 0x1007


def live(fake: FakeGocator) -> tuple[str, str]:
    return fake.files.loaded_job, hashlib.sha256(fake.files.read("_live.cfg")).hexdigest()


def test_job_and_exposure_are_put_back(fake, driver):
    fake.files.set_number(EXPOSURE, 1234.5)  # changed on the web page, saved by nobody
    found = live(fake)
    with driver(job="other", exposure_us=900.0) as scanner:
        scanner.capture(2750)
        assert fake.files.loaded_job == "other.job"
        assert fake.files.number(EXPOSURE) == 2750
    assert live(fake) == found


def test_they_stay_where_the_plan_says_so(fake, driver):
    with driver(job="other", exposure_us=900.0, restore=False):
        pass
    assert fake.files.loaded_job == "other.job"
    assert fake.files.number(EXPOSURE) == 900


@pytest.mark.parametrize(
    ("fault", "value"), [("close_control", {SNAPSHOT}), ("silent", {SNAPSHOT}), ("garbage", True), ("close_data", True)]
)
def test_they_are_put_back_after_a_fault_too(fake, driver, fault, value):
    found = live(fake)
    with driver(job="other", timeout_s=0.5, reply_limit_s=0.5) as scanner:
        scanner.capture(2750)
        fake.faults.set(fault, value)
        with pytest.raises((ConnectError, DeviceTimeout, ProtocolError)):
            scanner.capture()
    assert live(fake) == found


@pytest.mark.parametrize("fault", ["close_control", "silent"])
def test_a_fault_while_they_are_put_back_is_made_up_for(fake, driver, fault):
    found = live(fake)
    with driver(reply_limit_s=0.5) as scanner:
        scanner.capture(2750)
        fake.faults.set(fault, {WRITE_FILE}, times=1)
    assert live(fake) == found


def test_they_are_put_back_after_ctrl_c_and_from_trigger_mode(fake, driver):
    found = live(fake)

    def interrupted() -> None:
        with driver(exposure_us=900.0, mode="trigger") as scanner:
            scanner.capture()
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert live(fake) == found
    assert not fake.state.running


def test_a_refused_plan_changes_nothing(fake, driver):
    found = live(fake)
    with pytest.raises(ConfigError, match="outside the"):
        driver(job="other", exposure_us=1e7).connect()
    assert live(fake) == found


def test_a_reconnect_within_a_run_does_not_take_the_changed_state_for_the_old_one(fake, driver):
    found = live(fake)
    with driver(job="other") as scanner:
        scanner.capture(2750)
        fake.state.drop_connections()
        scanner.capture(2750)
    assert live(fake) == found


def test_a_sensor_that_went_away_is_said_to_have_kept_the_settings(frame, caplog):
    with FakeGocator(lambda e: frame) as sensor:
        scanner = Gocator("front", "", options(sensor, job="other"))
        scanner.connect()
    scanner.close()
    assert re.search(r"scanner 'front': job 'bench.job' and its exposure could not be put back", caplog.text)


def test_nothing_is_written_to_a_sensor_whose_settings_fit(fake, driver):
    fake.faults.set("status", {WRITE_FILE: -980})
    with driver(job="bench") as scanner:
        scanner.capture()
