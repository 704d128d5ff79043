"""Messages a real server of the protocol sent, and what they mean."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from mbcacq_gocator import layouts
from mbcacq_gocator.decode import ArrayMessage, Health, Measurement, Stamp, Unknown, decode

from mbcacq.devices import ProtocolError

POINT_CLOUD = bytes.fromhex(
    "56 00 00 00 1c 80 36 00 02 00 00 00 02 00 00 00 20 4e 00 00 20 4e 00 00 d0 07 00 00 78 ec ff ff"
    "e8 03 00 00 90 d0 03 00 00 dc 05 00 00 00 06 00 00 00 00 00 00 00 01 00 00 00 00 00 00 00 ce ff"
    "ce ff 00 00 00 80 00 80 00 80 ce ff 00 00 49 03 00 00 00 00 49 03"
)
MEASUREMENT_2 = bytes.fromhex("20 00 00 00 1f 80 10 00 01 00 00 00 00 00 04 00 02 00 00 00 01 00 00 00 00 00 00 80 02 00 00 00")


def in_trace(trace, text):
    return next(line.data for line in trace if line.direction == "=>" and text in line.text and line.whole)


def test_point_cloud_of_four_points():
    message, last = decode(POINT_CLOUD)
    assert last
    assert isinstance(message, ArrayMessage)
    assert message.type == 28
    assert message.array.tolist() == [[[-50, -50, 0], [-32768, -32768, -32768]], [[-50, 0, 841], [0, 0, 841]]]
    assert {k: message.attributes[k] for k in ("x_resolution", "y_resolution", "z_resolution", "x_offset", "y_offset", "z_offset")} == {
        "x_resolution": 20000,
        "y_resolution": 20000,
        "z_resolution": 2000,
        "x_offset": -5000,
        "y_offset": 1000,
        "z_offset": 250000,
    }
    assert (message.attributes["exposure"], message.attributes["stream_step"], message.attributes["arrayed_count"]) == (1500, 6, 1)


def test_array_is_a_view_of_the_received_bytes():
    received = bytearray(POINT_CLOUD)
    message, _ = decode(received)
    received[62:64] = struct.pack("<h", 77)
    assert message.array[0, 0, 0] == 77


def test_stamp_of_the_trace(trace):
    message, last = decode(in_trace(trace, "type 1 size 78"))
    assert not last
    assert message == Stamp(frame=0, timestamp=0x0A8BCC, encoder=0, encoder_at_z=0, status=0, serial=12345, ptp_us=0x0660C0CFDDCA3F)
    assert message.time_s == pytest.approx(0x0A8BCC / 1.024e6, rel=1e-15)


def test_stamp_of_old_firmware_has_no_ptp_time(trace):
    new = in_trace(trace, "type 1 size 78")
    old = bytearray(struct.pack("<I", 70) + new[4:70])
    old[10:12] = struct.pack("<H", 56)
    assert decode(old)[0] == Stamp(0, 0x0A8BCC, 0, 0, 0, 12345, None)


def test_larger_stamp_of_future_firmware_is_read_as_far_as_known(trace):
    new = in_trace(trace, "type 1 size 78")
    future = bytearray(struct.pack("<I", 86) + new[4:] + b"futurist")
    future[10:12] = struct.pack("<H", 72)
    assert decode(future)[0] == decode(new)[0]


def test_intensity_of_the_trace(trace):
    message, _ = decode(in_trace(trace, "type 9 size 104"))
    assert message.type == layouts.SURFACE_INTENSITY
    assert message.array.shape == (8, 6)
    assert message.array.ravel().tolist() == [7 * i % 256 for i in range(48)]
    assert "z_resolution" not in message.attributes


def test_profiles_and_video_of_the_trace(trace):
    cloud, _ = decode(in_trace(trace, "type 5 size 76"))
    assert cloud.array.tolist() == [[[0, 1], [2, 3], [4, 5], [6, 7], [8, 9]]]
    uniform, _ = decode(in_trace(trace, "type 6 size 66"))
    assert uniform.type == layouts.UNIFORM_PROFILE  # the vendor's own enumeration calls this one 7
    assert uniform.array.tolist() == [[11, 12, 13, 14, 15]]
    assert (uniform.attributes["x_resolution"], uniform.attributes["z_offset"]) == (20000, 250000)
    video, _ = decode(in_trace(trace, "type 2 size 61"))
    assert video.array.shape == (4, 6, 1)
    assert video.array.ravel().tolist() == list(range(0x64, 0x7C))


def test_measurements_of_the_trace(trace):
    old, _ = decode(in_trace(trace, "type 10 size 22"))
    assert (old.id, old.value.tolist(), old.passed.tolist()) == (3, [12.345], [True])
    new, last = decode(in_trace(trace, "type 31 LAST size 32"))
    assert last
    assert isinstance(new, Measurement)
    assert new.id == 4
    assert np.isnan(new.value).tolist() == [True]
    assert new.passed.tolist() == [False]
    assert in_trace(trace, "type 31 LAST size 32") == MEASUREMENT_2


def test_health_of_the_trace(trace):
    message, last = decode(in_trace(trace, "health size 142"))
    assert last
    assert isinstance(message, Health)
    assert dict(zip(message.items["id"].tolist(), message.items["value"].tolist(), strict=True)) == {
        20000: 0,
        2000: 0x0601200C,
        2017: 0,
        2002: 41,
        2404: 45,
        1003: 0,
        20005: 0,
        2007: 12,
    }


@pytest.mark.parametrize(("attribute_size", "known"), [(54, 13), (46, 13), (38, 12), (62, 15)])
def test_array_stands_behind_the_attribute_size_whatever_the_firmware(attribute_size, known):
    """46: without the arrayed pair; 38: before stream steps; 62: firmware of the future. Trailing bytes are skipped."""
    attributes = (POINT_CLOUD[8:62] + b"\xee" * 20)[:attribute_size]
    body = struct.pack("<H", attribute_size) + attributes + POINT_CLOUD[62:] + b"trailing"
    message, last = decode(struct.pack("<IH", 6 + len(body), 28) + body)
    assert not last
    assert message.array[1].tolist() == [[-50, 0, 841], [0, 0, 841]]
    assert ("arrayed_count" in message.attributes) == (attribute_size >= 54)
    assert ("stream_step" in message.attributes) == (attribute_size >= 46)


def test_an_unknown_type_is_no_broken_message():
    assert decode(bytes.fromhex("0a000000ff83") + b"what") == (Unknown(0x3FF), True)


@pytest.mark.parametrize("kept", [0, 5, 7, 8, 20, 61, 62, 85])
def test_cut_point_cloud_is_a_protocol_error(kept):
    with pytest.raises(ProtocolError):
        decode(POINT_CLOUD[:kept])
    with pytest.raises(ProtocolError):
        decode(struct.pack("<I", kept) + POINT_CLOUD[4:kept])


def test_sizes_beyond_the_message_are_a_protocol_error():
    monstrous = bytearray(POINT_CLOUD)
    monstrous[8:16] = struct.pack("<II", 0xFFFFFFFF, 0xFFFFFFFF)
    with pytest.raises(ProtocolError, match="announces an array of"):
        decode(monstrous)


def test_attributes_too_short_for_the_size_of_the_array_are_a_protocol_error():
    message = bytearray(POINT_CLOUD)
    message[6:8] = struct.pack("<H", 4)
    with pytest.raises(ProtocolError, match="does not say its 'width'"):
        decode(message)
