"""Points are in the sensor's own coordinates, or the plan accepts another frame; it stays the same one for the whole run."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
from gocator_bench import options
from mbcacq_fakes.protocols.gocator import FakeGocator, FakeGocatorOptions, actions
from mbcacq_gocator.alignment import main_transform
from mbcacq_gocator.driver import Gocator

from mbcacq.acquisition.runner import Runner
from mbcacq.conformance.bounded import eventually
from mbcacq.devices import ConfigError, ConnectError, DeviceFault, ProtocolError

MEDIAN, WIDTH = "Setup/Filters/XMedian/Window", "Setup/Devices/Device[@role='0']/ActiveArea/Width"


def test_an_aligned_sensor_is_refused_unless_the_plan_accepts_it(fake, driver):
    actions.align(fake.state)
    with pytest.raises(ConfigError, match=r"not in its own coordinates \(alignment: aligned, X 0, Y 0, Z -12.5, .*allow_aligned: true"):
        driver().connect()
    with driver(allow_aligned=True) as scanner:
        scanner.capture()
        assert scanner.describe().settings["alignment"].startswith("aligned, X 0")
    actions.clear_alignment(fake.state)
    with driver() as scanner:
        scanner.capture()


def test_a_transformation_typed_into_the_web_page_is_refused_too(fake, driver):
    fake.files.set_transform({"XAngle": 3.0})
    with pytest.raises(ConfigError, match="alignment: not aligned, .* XAngle 3"):
        driver().connect()


@pytest.mark.parametrize("mode", ["snapshot", "trigger"])
def test_an_alignment_during_the_run_ends_it(fake, driver, mode):
    with driver(mode=mode) as scanner:
        scanner.capture()
        exposures = fake.state.exposures
        actions.align(fake.state)
        with pytest.raises(DeviceFault, match="scanner 'front': .*alignment changed during the run, from 'none' to 'aligned, X 0"):
            scanner.capture()
        assert fake.state.exposures == exposures


def test_another_transformation_of_an_aligned_sensor_ends_the_run(fake, driver):
    actions.align(fake.state)
    with driver(allow_aligned=True) as scanner:
        scanner.capture()
        fake.files.set_transform({"Z": -12.6, "YAngle": 0.25})
        with pytest.raises(DeviceFault, match="alignment changed"):
            scanner.capture()


def test_an_alignment_while_the_sensor_was_away_ends_the_run(fake, driver):
    with driver(allow_aligned=True) as scanner:
        scanner.capture()
        actions.align(fake.state)
        fake.state.drop_connections()
        with pytest.raises(DeviceFault, match="'alignment' changed during the run, from 'none' to 'aligned"):
            scanner.capture()


def test_a_filter_that_somebody_changes_during_the_run_ends_it(fake, driver):
    with driver() as scanner:
        scanner.capture(900.0)
        fake.files.set_number(MEDIAN, 7)
        with pytest.raises(DeviceFault, match="setting 'filters' changed during the run, .*XMedian/Window 7"):
            scanner.capture(1100.0)


def test_what_decides_about_the_points_is_described(fake, driver):
    fake.files.set_number(MEDIAN, 5)
    fake.files.set_number(WIDTH, 71)
    with driver(job="bench", exposure_us=900) as scanner:
        settings = dict(scanner.describe().settings)
        assert settings["job"] == "bench.job"
        assert settings["alignment"] == "none"
        assert "XMedian/Window 5" in settings["filters"]
        assert settings["active_area"] == "X 1, Y 1, Z 1, Width 71, Length 1, Height 1"
        assert (settings["scan_mode"], settings["intensity"]) == ("3", "1")
        assert len(settings["configuration_sha256"]) == 64
    with driver(exposure_us=901) as scanner:
        assert scanner.describe().settings["configuration_sha256"] != settings["configuration_sha256"]


def test_the_pattern_of_the_projector_is_described(fake):
    from mbcacq_gocator.configuration import Configuration

    data = fake.files.read("_live.cfg").replace(b"<ExposureMode", b"<PatternSequenceType>2</PatternSequenceType><ExposureMode")
    assert Configuration(data).scan_settings()["pattern"] == "PatternSequenceType 2"


def test_a_transformation_that_is_no_number_is_refused():
    whole = (
        b'<Transform version="100"><Devices><Device role="1"><X>9</X></Device><Device role="0"><X>1.5</X></Device></Devices></Transform>'
    )
    assert main_transform(whole) == (1.5, 0, 0, 0, 0, 0)
    assert main_transform(b"<Transform/>") == (0,) * 6
    for wrong in (whole.replace(b"1.5", b"nan"), whole.replace(b"1.5", b"one"), b"<Other/>", b"", b"<a>" * 100_000):
        with pytest.raises(ProtocolError):
            main_transform(wrong)


@pytest.fixture
def secured(frame):
    with FakeGocator(lambda e: frame, FakeGocatorOptions(password="open sesame")) as sensor:
        yield sensor


def test_the_driver_logs_in_where_security_is_on(secured, monkeypatch):
    found = secured.files.read("_live.cfg")
    with Gocator("front", "", options(secured, password="open sesame", job="other")) as scanner:
        scanner.capture(2000.0)
        secured.state.drop_connections()
        scanner.capture(2000.0)
        secured.state.drop_connections()
    assert (secured.files.loaded_job, secured.files.read("_live.cfg")) == ("bench.job", found)
    monkeypatch.setenv("SENSOR_PASSWORD", "open sesame")
    with Gocator("front", "", options(secured, password="$SENSOR_PASSWORD")) as scanner:
        scanner.capture()


def test_a_missing_or_wrong_password_is_named_and_not_shown(secured, monkeypatch):
    with pytest.raises(ConnectError, match="demands a log-in; give its administrator's password"):
        Gocator("front", "", options(secured)).connect()
    scanner = Gocator("front", "", options(secured, password="open barley"))
    assert "barley" not in repr(scanner.options)
    with pytest.raises(ConfigError, match="refuses the password .*not logged in") as refused:
        scanner.connect()
    assert "barley" not in str(refused.value)
    monkeypatch.delenv("SENSOR_PASSWORD", raising=False)
    for password, words in (("$SENSOR_PASSWORD", "SENSOR_PASSWORD .* is not set"), ("x" * 64, "up to 63 bytes"), (7, "must be a text")):
        with pytest.raises(ConfigError, match=words):
            Gocator("front", "", options(secured, password=password))


def test_a_sensor_without_security_ignores_the_password(fake, driver):
    with driver(password="open sesame") as scanner:
        scanner.capture()


def test_a_fake_with_a_frame_rate_sends_scans_as_soon_as_it_runs(frame):
    with FakeGocator(lambda e: frame, FakeGocatorOptions(frame_rate_hz=20.0)) as sensor:
        actions.start(sensor.state)
        eventually(lambda: sensor.state.exposures >= 3, 30.0, "exposures by time")
        with pytest.raises(ConfigError, match="triggered by 'time'"):
            Gocator("front", "", options(sensor, mode="trigger")).connect()


def test_the_run_writes_down_how_the_sensor_is_set_up(driver):
    messages = []
    with driver() as scanner:
        bus = SimpleNamespace(message=lambda level, text: messages.append((level, text)), emit=lambda *event: None)
        Runner._describe(SimpleNamespace(devices=SimpleNamespace(all={"front": scanner}), bus=bus))  # type: ignore[arg-type]
    assert messages[0] == ("info", "front: 3210 12345 6.1.32.12")
    assert messages[1][1].startswith("front: job: bench.job; alignment: none; scan_mode: 3; ")
