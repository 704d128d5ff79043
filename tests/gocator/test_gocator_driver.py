"""The driver against the fake: what a user gets, and what the errors say when the sensor is not what the plan says."""

from __future__ import annotations

import threading

import numpy as np
import pytest
from gocator_bench import options
from mbcacq_fakes.protocols.gocator import FakeGocator, FakeGocatorOptions, actions
from mbcacq_fakes.protocols.gocator.files import EXPOSURE
from mbcacq_fakes.world.frame import ScannerFrame
from mbcacq_gocator.driver import Gocator

from mbcacq import devices
from mbcacq.conformance.bounded import eventually


def big_frame() -> ScannerFrame:
    """2 megapixels of a wavy surface with a missing patch."""
    y, x = np.mgrid[:1250, :1650].astype(np.float32)
    xyz = np.stack([x * 0.05 - 41, y * 0.05 - 31, 210 + 8 * np.sin(x / 90) * np.cos(y / 70)], axis=2)
    xyz[200:500, 300:800] = np.nan
    return ScannerFrame(xyz, ((3 * x + 5 * y) % 256).astype(np.uint8))


def truth_at(frame: ScannerFrame, scan: devices.Scan) -> tuple[np.ndarray, np.ndarray]:
    return frame.xyz.reshape(-1, 3)[scan.pixel], frame.intensity.reshape(-1)[scan.pixel]


@pytest.mark.parametrize("mode", ["snapshot", "trigger"])
def test_two_megapixel_frames_arrive_within_half_a_step(mode):
    frame = big_frame()
    with FakeGocator(lambda e: frame) as sensor, Gocator("front", "3210", options(sensor, mode=mode)) as scanner:
        scans = [scanner.capture() for _ in range(2)]
    for scan in scans:
        assert scan.shape == (1250, 1650)
        np.testing.assert_array_equal(scan.pixel, np.flatnonzero(np.isfinite(frame.xyz[..., 2])))
        points, grey = truth_at(frame, scan)
        assert (np.abs(scan.points - points).max(axis=0) < [1.53e-3, 1.53e-3, 1.03e-3]).all()
        assert (scan.intensity == grey).all()
    assert [s.frame for s in scans] == [1, 2]  # the first was exposed twice
    assert scans[0].time_s < scans[1].time_s
    assert not np.shares_memory(scans[0].points, scans[1].points)


@pytest.mark.parametrize(("generation", "mode", "uniform"), [(4, "trigger", True), (5, "snapshot", False), (6, "snapshot", True)])
def test_every_generation_of_firmware_and_uniform_surfaces(frame, generation, mode, uniform):
    with (
        FakeGocator(lambda e: frame, FakeGocatorOptions(generation=generation, uniform=uniform)) as sensor,
        Gocator("front", "3210", options(sensor, mode=mode)) as scanner,
    ):
        scan = scanner.capture()
        assert scanner.describe().firmware.startswith(f"{generation}.")
    x, y, z = scan.points.astype(float).T
    assert len(x) == 12 * 20 - 12
    assert np.abs(z - (200 + 0.2 * (x + 4) - 0.1 * (y + 3))).max() < 0.0025  # the frame's plane; x may be off by half a step of 3 um
    assert (scan.intensity == frame.intensity.reshape(-1)[scan.pixel]).all()


def test_scan_carries_time_exposure_measurements_and_health(frame):
    moment = ScannerFrame(frame.xyz, frame.intensity, time_s=3.25, measurements={7: 12.3456, 9: float("nan")})
    with FakeGocator(lambda e: moment, FakeGocatorOptions(clock=lambda: 3.0)) as sensor, Gocator("front", "", options(sensor)) as scanner:
        for _ in range(100):
            scan = scanner.capture(2750)
            if scan.health:
                break
    assert scan.time_s == pytest.approx(3.25, abs=1e-6)
    assert scan.exposure_us == 2750
    assert scan.measurements["measurement_7"] == 12.346
    assert np.isnan(scan.measurements["measurement_9"])
    assert scan.health["temperature_C"] == 41
    assert scan.health["projector_temperature_C"] == 45


def test_exposure_reaches_the_world_and_stays(frame):
    asked = []

    def source(exposure_us: float) -> ScannerFrame:
        asked.append(exposure_us)
        return frame

    with FakeGocator(source) as sensor, Gocator("front", "", options(sensor, exposure_us=1800)) as scanner:
        for exposure in (None, 900.5, None):
            scanner.capture(exposure)
    assert asked == [1800, 1800, 900.5, 900.5]


def test_exposure_changes_while_running_in_trigger_mode(frame):
    asked = []

    def source(exposure_us: float) -> ScannerFrame:
        asked.append(exposure_us)
        return frame

    with FakeGocator(source) as sensor, Gocator("front", "", options(sensor, mode="trigger")) as scanner:
        scanner.capture(500)
        assert sensor.state.running
        scanner.capture(700)
        scanner.stop()
        assert not sensor.state.running
        scanner.connect()
        scanner.capture()
    assert asked == [500, 500, 700, 700, 700]
    assert not sensor.state.running


def test_job_is_loaded_by_name_with_or_without_suffix(fake, driver):
    driver(job="other").connect()
    assert fake.files.loaded_job == "other.job"
    with pytest.raises(devices.ConfigError, match=r"no job 'missing.job' \(stored: bench.job, other.job\)"):
        driver(job="missing").connect()


@pytest.mark.parametrize("model", ["3210", "Gocator 3210", "LMI Gocator 3210", "313210A-2-R-01-T", ""])
def test_model_by_any_of_its_names(driver, model):
    scanner = driver(model)
    scanner.connect()
    assert scanner.describe().model == "3210"
    assert scanner.describe().serial == "12345"


@pytest.mark.parametrize("model", ["3504", "321", "32100", "Gocator 2330"])
def test_another_model_is_refused_with_both_names(driver, model):
    with pytest.raises(devices.IdentityError, match=f"plan asks for Gocator {model} but the sensor is a 3210"):
        driver(model).connect()


def test_old_part_number_alone_identifies(frame):
    with FakeGocator(lambda e: frame, FakeGocatorOptions(generation=4, model="2330")) as sensor:
        with Gocator("front", "2330", options(sensor, mode="trigger")) as scanner:
            assert scanner.describe().model == "2330"
        with pytest.raises(devices.IdentityError):
            Gocator("front", "3210", options(sensor, mode="trigger")).connect()
        with pytest.raises(devices.ConfigError, match="no snapshot; set the scanner option mode: trigger"):
            Gocator("front", "2330", options(sensor)).connect()


@pytest.mark.parametrize(
    ("path", "value", "words"), [("Setup/ScanMode", 2, "scans in mode 'profile'"), ("Setup/Trigger/Source", 1, "triggered by 'encoder'")]
)
def test_unsuitable_job_is_named(fake, driver, path, value, words):
    fake.files.set_number(path, value)
    with pytest.raises(devices.ConfigError, match=f"job 'bench.job' .*{words}"):
        driver(mode="trigger").connect()


def test_a_sensor_left_running_is_stopped_first(fake, driver):
    actions.start(fake.state)
    scanner = driver()
    scanner.connect()
    assert not fake.state.running
    scanner.capture()


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({}, "address is missing"),
        ({"address": "1.2.3.4", "port": 3190}, "unknown option 'port'"),
        ({"address": "1.2.3.4", "mode": "video"}, "mode must be one of snapshot, trigger"),
        ({"address": "1.2.3.4", "control_port": 0}, "control_port must be a whole number from 1 to 65535"),
        ({"address": "1.2.3.4", "timeout_s": "10"}, "timeout_s must be a number"),
        ({"address": "1.2.3.4", "job": 7}, "job must be a text"),
        ({"address": "1.2.3.4", "timeout_s": None}, "timeout_s must not be empty"),
    ],
)
def test_wrong_options_are_named_before_anything_is_opened(given, words):
    with pytest.raises(devices.ConfigError, match=words):
        devices.create("scanners", "gocator", "", given)


def test_driver_is_a_scanner_and_describes_itself_unconnected():
    scanner = devices.create("scanners", "gocator", "3210", {"address": "192.168.1.10"})
    assert isinstance(scanner, devices.Scanner)
    assert scanner.describe().kind == "scanner"
    assert not scanner.describe().verified_on_hardware
    assert {f.name: f.unit for f in scanner.describe().fields}["points"] == "mm"
    scanner.stop()
    scanner.close()
    scanner.close()


def test_stop_from_another_thread_ends_a_waiting_capture(fake, driver):
    fake.faults.set("no_data")
    scanner = driver(timeout_s=60)
    scanner.connect()
    raised = []

    def capture() -> None:
        try:
            scanner.capture()
        except devices.MbcacqError as error:
            raised.append(error)

    thread = threading.Thread(target=capture)
    thread.start()
    while not fake.state.exposures:
        thread.join(0.01)
    for _ in range(3):
        scanner.stop()
    thread.join(10)
    assert not thread.is_alive()
    assert isinstance(raised[0], devices.Aborted)
    fake.faults.clear()
    with pytest.raises(devices.Aborted, match="was stopped; connect it again"):
        scanner.capture()
    scanner.connect()
    assert len(scanner.capture().points)


def test_several_clients_share_one_sensor(fake, driver):
    one, two = driver(), driver()
    one.connect()
    two.connect()
    eventually(lambda: fake.state.data.count == 2, 10.0, "both are accepted")  # what is sent before a connection is accepted is lost to it
    times = [s.capture().time_s for s in (one, two, one, two)]
    assert times == sorted(times)  # sets that another client asked for earlier are passed over


def test_an_exposure_that_somebody_else_changes_is_reported_with_the_next_scan(fake, driver):
    with driver() as scanner:
        scanner.capture(900.0)
        assert {fact.name: fact.value for fact in scanner.facts()} == {
            "job": "bench.job",
            "exposure": "as set",
            "serial number": str(fake.options.serial),
            "firmware": "6.1.32.12",
        }
        fake.files.set_number(EXPOSURE, 2000.0)
        assert scanner.capture(900.0).exposure_us == 2000.0
        assert {fact.name: fact.value for fact in scanner.facts()}["exposure"] == "2000 us instead of 900 us"
