"""A line scanner's stream of profiles: literal bytes, and fake sensors of both generations that lose, restart and go away."""

import socket
import time

import numpy as np
import pytest
from gocator_bench import options
from mbcacq_fakes.protocols.gocator import FakeGocator
from mbcacq_fakes.protocols.gocator.options import FakeGocatorOptions
from mbcacq_fakes.protocols.gopxl import FakeGoPxL, FakeGoPxLOptions
from mbcacq_fakes.world.frame import ScannerFrame
from mbcacq_gocator.dataset import DataSet
from mbcacq_gocator.decode import decode
from mbcacq_gocator.driver import Gocator
from mbcacq_gocator.gopxl.driver import GoPxL
from mbcacq_gocator.profiles import block_of, joined
from mbcacq_gocator.sensor_session import ProfileStream

from mbcacq.devices import ConfigError, ConnectError, DeviceFault, DeviceTimeout, ProfileScanner, ProtocolError

# Two stamps of 64 bytes: frames 7 and 8, 1024000 and 1126400 ticks (1.0 and 1.1 s), encoder -5 and -3, input of the second on.
STAMPS = bytes.fromhex(
    "8e000000 0100 02000000 4000 00 00"
    "0700000000000000 00a00f0000000000 fbffffffffffffff 0000000000000000 0000000000000000 39300000 00000000 0000000000000000 0000000000000000"
    "0800000000000000 0030110000000000 fdffffffffffffff 0000000000000000 0100000000000000 39300000 00000000 0000000000000000 0000000000000000"
)
# Two profiles of three points, steps of 20 um and 2 um, from x = -5 mm and z = 250 mm on; the middle point is invalid.
POINTS = bytes.fromhex(
    "50000000 0580 3000 02000000 03000000 204e0000 d0070000 78ecffff 90d00300 00 dc050000 00 0000"
    "02000000 00000000 01000000 00000000"
    "ceff e803 0080 0080 3200 18fc   ceff e903 0080 0080 3200 19fc"
)
UNIFORM = bytes.fromhex(
    "44000000 0680 3000 02000000 03000000 204e0000 d0070000 78ecffff 90d00300 00 dc050000 00 0000"
    "02000000 00000000 01000000 00000000 e803 0080 18fc   e903 0080 19fc"
)


def read(*messages):
    data = DataSet()
    for message in messages:
        decoded, _ = decode(message)
        if hasattr(decoded, "timestamp"):
            data.stamp = decoded
        else:
            data.arrays.append(decoded)
    return joined([block_of(data)])


def test_literal_bytes_of_profiles_become_points_with_stamps():
    found = read(STAMPS, POINTS)
    assert found.counter.tolist() == [7, 8]
    np.testing.assert_allclose(found.time_s, [1.0, 1.1])
    assert found.encoder.tolist() == [-5, -3]
    assert found.inputs.tolist() == [0, 1]
    assert found.first.tolist() == [0, 2]
    np.testing.assert_allclose(found.points, [[-6, 252], [-4, 248], [-6, 252.002], [-4, 248.002]], atol=1e-4)
    uniform = read(STAMPS, UNIFORM)
    np.testing.assert_allclose(uniform.points, [[-5, 252], [-4.96, 248], [-5, 252.002], [-4.96, 248.002]], atol=1e-4)


def test_profiles_without_a_stamp_of_each_are_refused():
    one = bytearray(STAMPS[: 14 + 64])
    one[0], one[6] = 78, 1
    with pytest.raises(ProtocolError, match="2 profiles with 1 stamps"):
        read(bytes(one), POINTS)


class Endless:
    """A sensor whose data sets never end, whatever it is told."""

    is_wanted = True

    def __init__(self):
        self.data, self.other = socket.socketpair()
        self.other.send(b"x")

    def start(self):
        pass

    stop = start

    def next_profiles(self, deadline):
        time.sleep(0.01)


def test_profiles_that_come_after_the_stop_are_no_whole_sweep():
    sensor = Endless()
    stream = ProfileStream(sensor, 0.2)
    try:
        with pytest.raises(DeviceTimeout, match=r"profiles still come 0.2 s after the sensor was stopped; see that nothing else starts it"):
            stream.end()
    finally:
        sensor.is_wanted = False
        sensor.data.close()
        sensor.other.close()


class Ramp:
    """A world whose clock a test turns; each profile shows its own time as its height."""

    def __init__(self):
        self.time_s = 100.0

    def now(self):
        return self.time_s

    def profiles(self, times):
        x = np.linspace(-10, 10, 21)
        return [np.column_stack([x, np.where(np.abs(x) < 3, np.nan, 1e-2 * (t - 100))]) for t in times]


def awaited(driver):
    """The next profiles, once some have come."""
    while len(found := driver.profiles()) == 0:
        time.sleep(0.01)
    return found


def taken_until_it_ends(driver):
    while True:
        awaited(driver)


def nothing(exposure_us):
    return ScannerFrame(np.zeros((1, 1, 3), np.float32))


@pytest.fixture(params=["classic", "GoPxL", "GoPxL, equal steps"])
def stream(request):
    """A fake at 200 Hz, its world, and a driver of it that takes profiles."""
    world, made = Ramp(), []

    def make(**more):
        about = {"profiles": True, "frame_rate_hz": 200.0, "clock_began_s": 90.0, **more}
        if request.param == "classic":
            fake = FakeGocator(nothing, FakeGocatorOptions(**about), world).start()
            driver = Gocator("line", "", options(fake, mode="profile"))
        else:
            fake = FakeGoPxL(nothing, FakeGoPxLOptions(**about), line=world).start()
            uniform = request.param.endswith("steps")
            driver = GoPxL("line", "", {"address": "127.0.0.1", "control_port": fake.ports.control, "mode": "profile", "uniform": uniform})
        made.extend([driver.close, fake.stop])
        driver.connect()
        return world, driver, fake

    yield make
    for end in made:
        end()


def test_every_profile_between_start_and_end_comes_with_its_own_time(stream):
    world, driver, _ = stream()
    assert isinstance(driver, ProfileScanner)
    for _ in range(2):
        driver.start_profiles()
        began = world.time_s
        world.time_s += 1.5
        driver.end_profiles()
        found = driver.profiles()
        assert len(found) == 301
        np.testing.assert_allclose(found.time_s, began - 90 + np.arange(301) / 200, atol=2e-6)
        heights = found.points[found.first, 1]
        np.testing.assert_allclose(heights, 1e-2 * (found.time_s - 10), atol=2e-3)
        assert np.all(np.diff(np.r_[found.first, len(found.points)]) == 16)
        assert found.lost == 0
    world.time_s += 1.0
    assert len(driver.profiles()) == 0


def test_lost_profiles_are_counted_and_the_others_keep_their_times(stream):
    world, driver, _ = stream(lost_profiles=0.1)
    driver.start_profiles()
    world.time_s += 2.0
    driver.end_profiles()
    found = driver.profiles()
    assert 10 < found.lost < 80
    np.testing.assert_allclose(found.time_s, 10 + found.counter / 200, atol=2e-6)


def test_a_sensor_that_begins_anew_or_goes_away_gives_no_profile_another_time(stream):
    world, driver, fake = stream()
    driver.start_profiles()
    world.time_s += 0.5
    awaited(driver)
    fake.faults.set("restart", True, 1)
    world.time_s += 0.5
    driver.end_profiles()
    with pytest.raises(DeviceFault, match="began anew while it took profiles"):
        driver.profiles()
    world, driver, fake = stream()
    driver.start_profiles()
    world.time_s += 0.5
    assert len(awaited(driver)) <= 101
    fake.drop_connections()
    with pytest.raises(ConnectError):
        taken_until_it_ends(driver)


def test_jobs_that_stream_nothing_are_refused(fake):
    with pytest.raises(ConfigError, match="scans in mode 'surface'; choose the scan mode Profile"):
        Gocator("line", "", options(fake, mode="profile")).connect()


def test_a_gopxl_job_that_waits_for_software_triggers_is_refused():
    with FakeGoPxL(nothing, FakeGoPxLOptions(profiles=True)) as fake:
        fake.resources.group["triggerSettings"]["source"] = 3
        driver = GoPxL("line", "", {"address": "127.0.0.1", "control_port": fake.ports.control, "mode": "profile"})
        with pytest.raises(ConfigError, match="triggered by software, one profile at a time; choose Time, Encoder or External Input"):
            driver.connect()
