"""A job that sends several surfaces gives the scanner's own one, or an error that says what to untick; never another one in silence."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from gocator_bench import options
from mbcacq_fakes.protocols.gocator import FakeGocator, encode, exposures
from mbcacq_gocator.decode import ArrayMessage
from mbcacq_gocator.driver import Gocator
from mbcacq_gocator.selection import scan_intensity, scan_surface

from mbcacq.devices import ConfigError

CLOUD, UNIFORM, INTENSITY = 28, 8, 9
STEP_AT = {CLOUD: 46, UNIFORM: 52, INTENSITY: 40}
SURFACE, RAW, TOOL, ORIGINAL = 3, 6, 8, 11


def array(kind: int = CLOUD, **attributes: int) -> ArrayMessage:
    return ArrayMessage(kind, {"source": 0, "stream_step": SURFACE, **attributes}, np.zeros((1, 1, 3), "<i2"))


def changed(message: bytearray, step: int = SURFACE, source: int = 0) -> bytearray:
    """A copy from another step of the processing or another source, shifted by one step of the resolution; not the last of its set."""
    copy, kind = bytearray(message), struct.unpack_from("<H", message, 4)[0] & 0x7FFF
    copy[5] &= 0x7F
    struct.pack_into("<i", copy, STEP_AT[kind], step)
    copy[40 if kind != INTENSITY else 32] = source
    first = 8 + struct.unpack_from("<H", copy, 6)[0]
    copy[first] ^= 1
    return copy


@pytest.fixture
def sending(frame, monkeypatch):
    """Starts a fake whose data sets are changed by a function of (stamp, surface, intensity, measurement)."""
    started = []

    def start(change) -> FakeGocator:
        monkeypatch.setattr(exposures.encode, "data_set", lambda *given: change(*original(*given)))
        started.append(FakeGocator(lambda e: frame).start())
        return started[-1]

    original = encode.data_set
    yield start
    for sensor in started:
        sensor.stop()


def test_the_output_of_a_tool_before_the_surface_is_not_taken_for_it(frame, sending):
    def with_tool(stamp, surface, grey, value):
        return [stamp, changed(surface, TOOL), changed(grey, TOOL), surface, grey, value]

    with Gocator("front", "", options(sending(with_tool))) as scanner:
        scan = scanner.capture()
    assert np.abs(scan.points - frame.xyz.reshape(-1, 3)[scan.pixel]).max() < 1.53e-3
    assert (scan.intensity == frame.intensity.reshape(-1)[scan.pixel]).all()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda stamp, surface, *rest: [stamp, surface, changed(surface, source=1), *rest], "several surfaces .* of source bottom"),
        (lambda stamp, surface, *rest: [stamp, changed(surface), surface, *rest], "several surfaces"),
        (lambda stamp, surface, *rest: [stamp, changed(surface, TOOL), *rest], "only outputs of tools"),
        (lambda stamp, surface, grey, value: [stamp, surface, changed(grey), grey, value], "several intensity images"),
    ],
)
def test_what_nobody_can_tell_apart_is_refused(sending, change, words):
    with Gocator("front", "", options(sending(change))) as scanner, pytest.raises(ConfigError, match=words):
        scanner.capture()


def test_a_point_cloud_is_taken_before_a_uniform_surface_and_a_surface_before_a_raw_one():
    cloud, raw, uniform = array(), array(stream_step=RAW), array(UNIFORM)
    assert scan_surface([uniform, raw, cloud]) is cloud
    assert scan_surface([uniform, raw]) is raw
    assert scan_surface([array(UNIFORM, stream_step=ORIGINAL), uniform]) is uniform
    assert scan_surface([array(INTENSITY)]) is None


def test_a_message_that_came_twice_is_one_surface():
    one, same, other = array(), array(), array()
    other.array[0, 0, 0] = 1
    assert scan_surface([one, same]) is one
    assert scan_intensity([array(INTENSITY), array(INTENSITY)], one) is not None
    with pytest.raises(ConfigError, match="several surfaces"):
        scan_surface([one, same, other])


def test_a_surface_of_old_firmware_that_states_no_step_is_the_scan():
    old = ArrayMessage(UNIFORM, {"source": 0}, np.zeros((1, 1), "<i2"))
    assert scan_surface([old]) is old
    unstated = array(UNIFORM, stream_step=-1)
    assert scan_surface([unstated, array(UNIFORM, stream_step=TOOL)]) is unstated


def test_parts_of_one_frame_are_not_one_scan():
    with pytest.raises(ConfigError, match="part 1"):
        scan_surface([array(arrayed_count=2, arrayed_index=k) for k in range(2)])


def test_grey_values_belong_to_the_surface_of_their_step():
    grey, raw_grey = array(INTENSITY), array(INTENSITY, stream_step=RAW)
    assert scan_intensity([raw_grey, grey], array()) is grey
    assert scan_intensity([raw_grey, grey], array(stream_step=RAW)) is raw_grey
    assert scan_intensity([raw_grey], array()) is raw_grey
    assert scan_intensity([array(INTENSITY, source=1), array(INTENSITY, stream_step=TOOL)], array()) is None
