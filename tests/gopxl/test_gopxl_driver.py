"""The GoPxL driver in front of a fake sensor that speaks its protocol."""

from __future__ import annotations

import threading

import numpy as np
import pytest
from gopxl_scene import tilted_plane
from mbcacq_fakes.protocols.gopxl import FakeGoPxL, resources
from mbcacq_gocator.gopxl import discovery
from mbcacq_gocator.gopxl.driver import GoPxL

from mbcacq.devices import Aborted, ConfigError, ConnectError, DeviceFault, DeviceTimeout, IdentityError, MbcacqError, ProtocolError


def check(scan, number: int) -> None:
    """The scan shows the plane of this exposure, every point at its pixel."""
    plane = tilted_plane(number)
    assert len(scan.points) == 228
    assert scan.shape == (12, 20)
    np.testing.assert_allclose(scan.points, plane.xyz.reshape(-1, 3)[scan.pixel], atol=0.005)
    np.testing.assert_array_equal(scan.intensity, plane.intensity.reshape(-1)[scan.pixel])


def test_a_capture_is_the_exposure_that_was_asked_for(sensor, options):
    with GoPxL("scanner", "3504", options) as scanner:
        for number, exposure_us in enumerate((800.0, 800.0, 2000.0), 1):
            scan = scanner.capture(exposure_us)
            check(scan, number)
            assert scan.exposure_us == exposure_us
            assert scan.frame == number + 1
    assert sensor.asked == [800, 800, 800, 2000]
    assert scan.measurements == {"output_101": 12.5}
    assert scan.health["cameraTemp0_C"] == 41


def test_what_somebody_else_changes_is_reported_with_the_next_scan(sensor, options):
    with GoPxL("scanner", "3504", options) as scanner:
        scanner.capture(800.0)
        before = {fact.name: fact.value for fact in scanner.facts()}
        known = {"alignment": "none", "job": "bench", "exposure": "as set", "serial number": "12345"}
        assert before == known | {"firmware": before["firmware"]}
        sensor.resources.sensor["exposureSettings"]["singleExposure"] = 2000
        sensor.resources.loaded_job = "other"
        sensor.resources.transform["zAngle"] = 1.5
        assert scanner.capture(800.0).exposure_us == 2000.0
        assert {fact.name: fact.value for fact in scanner.facts()} == before | {
            "alignment": "none, zAngle 1.5",
            "job": "other",
            "exposure": "2000 us instead of 800 us",
        }


def test_a_uniform_surface_gives_the_same_plane(sensor, options):
    with GoPxL("scanner", "", {**options, "uniform": True}) as scanner:
        scan = scanner.capture()
    assert len(scan.points) > 200
    x, y, z = scan.points.T.astype(float)
    seen = 20 + 0.5 * (len(sensor.asked) - 1)
    np.testing.assert_allclose(z, seen + 0.1 * (x + 4) / 0.5 - 0.05 * (y + 3) / 0.5, atol=0.01)


def test_the_sensor_is_left_as_it_was_found(sensor, options):
    group, single = dict(sensor.resources.group), dict(sensor.resources.sensor)
    sensor.resources.running = True
    with GoPxL("scanner", "", {**options, "exposure_us": 3000.0}) as scanner:
        scanner.capture()
        assert sensor.resources.group["triggerSettings"]["source"] == 3
    assert (sensor.resources.group, sensor.resources.sensor) == (group, single)
    assert sensor.resources.running
    assert sensor.resources.outputs == []


def test_it_is_left_as_found_also_after_the_connection_was_lost(sensor, options):
    group = dict(sensor.resources.group)
    with GoPxL("scanner", "", options) as scanner:
        scanner.capture()
        sensor.drop_connections()
        check(scanner.capture(), 2)
    assert sensor.resources.group == group
    assert not sensor.resources.running


def test_a_job_is_loaded_and_the_old_one_put_back(sensor, options):
    with GoPxL("scanner", "", {**options, "job": "other"}) as scanner:
        assert sensor.resources.loaded_job == "other"
        check(scanner.capture(), 1)
    assert sensor.resources.loaded_job == "bench"
    with pytest.raises(DeviceFault, match="no job missing"):
        GoPxL("scanner", "", {**options, "job": "missing"}).connect()


def test_notifications_between_request_and_reply_are_passed_over(sensor, options):
    sensor.faults.set("notifications", 5)
    with GoPxL("scanner", "", options) as scanner:
        check(scanner.capture(), 1)


def test_another_sensor_is_refused(options):
    with pytest.raises(IdentityError, match="expects a '3210'"):
        GoPxL("scanner", "3210", options).connect()
    with pytest.raises(IdentityError, match="serial 99 "):
        GoPxL("scanner", "", {**options, "serial": 99}).connect()


def test_a_sensor_that_another_instance_controls_is_refused(sensor, options):
    sensor.resources.remote = True
    with pytest.raises(ConnectError, match="192.168.1.50:3640"):
        GoPxL("scanner", "", options).connect()


def test_an_aligned_sensor_is_refused_unless_the_plan_says_so(sensor, options):
    sensor.resources.align_state = 1
    with pytest.raises(ConfigError, match="aligned"):
        GoPxL("scanner", "", options).connect()
    with GoPxL("scanner", "", {**options, "allow_aligned": True}) as scanner:
        check(scanner.capture(), 1)


def test_an_exposure_out_of_range_is_refused_in_words(options):
    with GoPxL("scanner", "", options) as scanner, pytest.raises(DeviceFault, match="out of range 100 to 100000"):
        scanner.capture(5.0)


def test_a_source_that_does_not_exist_is_named_with_those_that_do(options):
    with pytest.raises(ConfigError, match="sensor-0UniformSurface"):
        GoPxL("scanner", "", {**options, "source": "scan:nothing"}).connect()


@pytest.mark.parametrize(
    ("fault", "value", "error"),
    [
        ("no_data", True, DeviceTimeout),
        ("stamp_only", True, DeviceTimeout),
        ("null_surface", -997, DeviceTimeout),
        ("old_frame", True, DeviceTimeout),
        ("stall", True, DeviceTimeout),
        ("short_message", True, ProtocolError),
        ("garbage", True, MbcacqError),
    ],
)
def test_a_bad_set_is_an_error_and_the_next_scan_is_good(sensor, options, fault, value, error):
    with GoPxL("scanner", "", {**options, "timeout_s": 0.5}) as scanner:
        scanner.capture()
        sensor.faults.set(fault, value, times=1)
        with pytest.raises(error):
            scanner.capture()
        check(scanner.capture(), 3)


@pytest.mark.parametrize("fault", ["close_data", "close_in_message"])
def test_a_connection_that_breaks_in_a_scan_is_a_named_error_and_the_next_scan_is_good(sensor, options, fault):
    with GoPxL("scanner", "", options) as scanner:
        scanner.capture()
        sensor.faults.set(fault, times=1)
        with pytest.raises(ConnectError, match="closed the connection"):
            scanner.capture()
        check(scanner.capture(), sensor.scans - 1)


def test_a_strange_message_is_passed_over(sensor, options):
    with GoPxL("scanner", "", options) as scanner:
        scanner.capture()
        sensor.faults.set("unknown_type", times=1)
        check(scanner.capture(), sensor.scans - 1)


def test_a_reply_that_stays_out_closes_the_connection_and_the_next_scan_is_good(sensor, options):
    trigger = f"{resources.GROUP}/actions/trigger"
    with GoPxL("scanner", "", {**options, "reply_limit_s": 0.5}) as scanner:
        scanner.capture()
        sensor.faults.set("silent", {trigger}, times=1)
        with pytest.raises(DeviceTimeout):
            scanner.capture()
        check(scanner.capture(), 2)


def test_stop_ends_a_scan_under_way(sensor, options):
    with GoPxL("scanner", "", {**options, "timeout_s": 60.0}) as scanner:
        scanner.capture()
        sensor.faults.set("no_data")
        begun = threading.Timer(0.2, scanner.stop)
        begun.start()
        with pytest.raises(Aborted):
            scanner.capture()
        begun.join()


def test_the_right_driver_is_named_where_the_other_generation_answers(options, sensor, monkeypatch):
    monkeypatch.setattr("mbcacq_gocator.gopxl.driver.CLASSIC_CONTROL", sensor.ports.control)  # something listens there
    with pytest.raises(ConnectError, match="use driver: gocator"):
        GoPxL("scanner", "", {"address": "127.0.0.1", "control_port": 1, "connect_timeout_s": 0.5}).connect()


def test_a_sensor_is_found_by_its_serial_number(sensor):
    where = {"serial": 12345, "broadcast": "127.0.0.1", "discovery_port": sensor.discovery_port, "discovery_listen_port": 0}
    found = discovery.find(0.5, "127.0.0.1", sensor.discovery_port, 0)
    assert [(one.serial, one.model, one.build) for one in found] == [(12345, "3504", "1.5.12.3")]
    with GoPxL("scanner", "3504", where) as scanner:
        check(scanner.capture(), 1)
    with pytest.raises(ConnectError, match="3504 serial 12345 at 127.0.0.1"):
        GoPxL("scanner", "", {**where, "serial": 7}).connect()


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({}, "address is missing"),
        ({"address": "x", "no_such": 1}, "unknown option 'no_such'"),
        ({"address": 5}, "address must be a text"),
        ({"address": "x", "timeout_s": -1}, "timeout_s must be a number from 0.001"),
        ({"address": "x", "uniform": "yes"}, "uniform must be true or false"),
    ],
)
def test_wrong_options_are_named(given, words):
    with pytest.raises(ConfigError, match=words):
        GoPxL("scanner", "", given)


@pytest.mark.parametrize("cut", [True, False], ids=["connections dropped", "connections stand"])
def test_close_leaves_the_sensor_as_it_was_found_over_a_new_connection_if_need_be(cut):
    with FakeGoPxL(lambda exposure_us: tilted_plane(1)) as fake:
        before = fake.resources.group["triggerSettings"]["source"], fake.resources.exposure_us
        with GoPxL("s", "", {"address": "127.0.0.1", "control_port": fake.ports.control, "timeout_s": 20, "exposure_us": 900.0}) as scanner:
            scanner.capture()
            assert fake.resources.gdp_enabled
            if cut:
                fake.drop_connections()
        after = fake.resources.group["triggerSettings"]["source"], fake.resources.exposure_us
        assert (after, fake.resources.running, fake.resources.outputs, fake.resources.gdp_enabled) == (before, False, [], False)
