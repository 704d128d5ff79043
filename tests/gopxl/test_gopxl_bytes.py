"""GoPxL on the wire: frames byte by byte, as the vendor's own client sends and accepts them."""

from __future__ import annotations

import json
import struct

import numpy as np
import pytest
from mbcacq_gocator.gopxl import discovery, frames, gdp
from mbcacq_gocator.gopxl.points import points_of, profile_block
from mbcacq_gocator.profiles import joined

from mbcacq.devices import ProtocolError

READ_SYSTEM = bytes.fromhex(
    "33000000 00b0 29000000 84 a461726773 80 a66d6574686f64 a472656164 a470617468 a72f73797374656d a77061796c6f6164 80"
)
REPLY_SYSTEM = bytes.fromhex(
    "45000000 00b0 01000000 37000000 84 a474797065 a8726573706f6e7365 a6737461747573 01 a470617468 a72f73797374656d "
    "a77061796c6f6164 81 a872756e5374617465 00"
)
STAMP = bytes.fromhex(
    "66000000 0b00 26000000 00 00 00 00000000 00000000 0700 613a7374616d70 0100 73 0700000000000000 00 0000"
    "3a00 0700000000000000 00a00f0000000000 0000000000000000 0000000000000000 0000000000000000 00f1536500000000 0000000000000000"
)
POINTS_2_X_2 = bytes.fromhex(
    "90000000 0f00 23000000 01 00 00 00000000 00000000 0400 613a7063 0100 73 0700000000000000 01 0100"
    "4b00 02000000 02000000 02000000 02000000 7b14ae47e17a943f 7b14ae47e17a943f fca9f1d24d62603f"
    "0000000000000000 0000000000000000 0000000000000000 01000000 001bb749 00"
    "ceff ceff 0a00 0080 0080 0080 ceff 3200 1400 3200 3200 1e00 64 00 78 8c"
)
# Three points, steps of 20 um and 2 um, from x = -5 mm and z = 250 mm on, 1.5 ms of exposure; the middle point is invalid.
PROFILE_COMMON = "23000000 01 00 00 00000000 00000000 0400 613a7063 0100 73 0700000000000000 01 0100"
PROFILE_SECTION = "2e00 03000000 00000000 7b14ae47e17a943f fca9f1d24d62603f 00000000000014c0 0000000000406f40 001bb749"
PROFILE_POINTS = bytes.fromhex(f"63000000 0d00 {PROFILE_COMMON} {PROFILE_SECTION} ceff e803 0080 0080 3200 18fc")
UNIFORM_PROFILE = bytes.fromhex(f"5d000000 0c00 {PROFILE_COMMON} {PROFILE_SECTION} e803 0080 18fc")
MEASUREMENT = bytes.fromhex(
    "31000000 1300 22000000 00 00 00 00000000 00000000 0300 743a58 0100 73 0700000000000000 01 0200 000000000000f43f 01"
)
NULL = bytes.fromhex("2e000000 0a00 22000000 00 00 00 00000000 00000000 0300 743a59 0100 73 0700000000000000 01 0300 0600 19fcffff")


def collected(*messages: bytes) -> gdp.GdpSet:
    found = gdp.GdpSet()
    for message in messages:
        view = memoryview(message)
        gdp.add(found, view, gdp.parse_common(view))
    return found


def test_a_request_is_the_bytes_of_the_vendors_client():
    assert frames.request("read", "/system") == READ_SYSTEM


def test_a_reply_is_read():
    assert frames.reply_size(REPLY_SYSTEM[:14]) == (1, 55, 0)
    assert frames.content(REPLY_SYSTEM[14:]) == {"type": "response", "status": 1, "path": "/system", "payload": {"runState": 0}}


def test_a_stamp_is_read():
    assert gdp.parse_common(memoryview(STAMP)) == (11, "a:stamp", 7, False, 0, 44, False)
    assert collected(STAMP).stamp == (7, 1024000, 0, 1700000000.0)


def test_a_point_cloud_is_read_in_mm_with_its_grey_values():
    assert gdp.parse_common(memoryview(POINTS_2_X_2)).last
    surface = collected(POINTS_2_X_2).surface
    points, pixel = points_of(surface, right_handed=False)
    assert pixel.tolist() == [0, 2, 3]
    np.testing.assert_allclose(points, [[-1, -1, 0.02], [-1, 1, 0.04], [1, 1, 0.06]], atol=1e-6)
    assert surface.intensity.tolist() == [[100, 0], [120, 140]]
    assert surface.exposure_us == pytest.approx(1500)


@pytest.mark.parametrize(("message", "x"), [(PROFILE_POINTS, [-6, -4]), (UNIFORM_PROFILE, [-5, -4.96])])
def test_a_profile_is_read_in_mm_with_the_system_time_of_its_stamp(message, x):
    found = joined([profile_block(collected(STAMP, message), right_handed=False)])
    assert (found.counter.tolist(), found.time_s.tolist(), found.first.tolist()) == ([7], [1.7e9], [0])
    np.testing.assert_allclose(found.points, np.column_stack([x, [252, 248]]), atol=1e-4)
    np.testing.assert_allclose(joined([profile_block(collected(STAMP, message))]).points[:, 0], -np.array(x), atol=1e-4)


def test_a_profile_that_is_shorter_than_it_says_or_has_no_stamp_is_refused():
    cut = bytearray(PROFILE_POINTS[:-2])
    cut[0] -= 2
    with pytest.raises(ProtocolError, match="3 points does not fit"):
        collected(STAMP, bytes(cut))
    with pytest.raises(ProtocolError, match="without a stamp"):
        profile_block(collected(PROFILE_POINTS))


def test_points_are_right_handed_by_turning_x_round():
    surface = collected(POINTS_2_X_2).surface
    np.testing.assert_allclose(points_of(surface)[0][:, 0], [1, 1, -1], atol=1e-6)


def test_a_pixel_format_as_of_release_1_5_changes_nothing():
    at = POINTS_2_X_2.index(bytes.fromhex("001bb74900")) + 5
    longer = bytearray(POINTS_2_X_2[:at] + bytes.fromhex("01000000") + POINTS_2_X_2[at:])
    longer[0], longer[POINTS_2_X_2.index(b"\x4b\x00\x02")] = 148, 79
    old, new = collected(POINTS_2_X_2).surface, collected(bytes(longer)).surface
    np.testing.assert_array_equal(old.raw, new.raw)
    np.testing.assert_array_equal(old.intensity, new.intensity)


def test_measurements_are_in_their_own_unit_and_a_null_says_why():
    found = collected(MEASUREMENT, NULL)
    assert found.measurements == {2: 1.25}
    assert found.refused == {3: -999}


def test_bytes_behind_the_known_ones_are_skipped():
    section = bytearray(STAMP[6:44]) + b"later"
    section[0] += 5
    longer = struct.pack("<IH", len(STAMP) + 5, 11) + bytes(section) + STAMP[44:]
    assert collected(longer).stamp.frame == 7


@pytest.mark.parametrize("message", [STAMP, POINTS_2_X_2, MEASUREMENT, NULL])
def test_no_shortened_message_is_read_as_a_whole_one(message):
    for length in range(6, len(message)):
        short = struct.pack("<I", length) + message[4:length]
        try:
            found = collected(short)
        except ProtocolError:
            continue
        assert found == gdp.GdpSet() or found.stamp is None, length
        assert found.surface is None, length
        assert found.measurements in ({}, {2: 1.25}), length


def test_the_discovery_request_is_24_bytes():
    assert discovery.request() == bytes.fromhex("1800000000000000 0100000000000000 4c4d49474f50584c")


def test_an_announcement_is_read_and_nonsense_refused():
    body = b'{"SerialNumber":"4711","DeviceModel":"3504","AppVersion":"1.5","Address":"10.0.0.5","ControlPort":3600,"GdpPort":3601}\0'
    head = struct.pack("<QQ", 32 + len(body), 0x1001) + b"LMIGOPXL" + struct.pack("<Q", 1)
    found = discovery.parse(head + body, "10.0.0.9")
    assert (found.serial, found.model, found.address, found.control_port, found.data_port) == (4711, "3504", "10.0.0.5", 3600, 3601)
    for wrong in (head, head + b"[1]\0", head + b"{" * 900, b"LMIUDP", body):
        with pytest.raises(ProtocolError):
            discovery.parse(wrong, "10.0.0.9")


def test_a_reply_whose_map_has_a_map_as_key_is_a_protocol_error():
    body = bytes.fromhex("81 81 a1 61 01 02")  # {{"a": 1}: 2}
    with pytest.raises(ProtocolError, match="cannot be read as MessagePack"):
        frames.content(body)


@pytest.mark.parametrize(
    ("told", "taken"),
    [
        ("0.0.0.0", "10.0.0.9"),  # of an instance that listens on all its addresses
        ("", "10.0.0.9"),
        (None, "10.0.0.9"),
        ("255.255.255.255", "10.0.0.9"),
        ("127.0.0.1", "10.0.0.9"),  # its own loopback, not ours
        ("not an address", "10.0.0.9"),
        ("10.0.0.77", "10.0.0.77"),
    ],
)
def test_an_address_to_which_nobody_can_connect_is_that_of_the_sender(told, taken):
    content = {"SerialNumber": "12345"} if told is None else {"SerialNumber": "12345", "Address": told}
    data = bytes.fromhex("b900000000000000 0110000000000000 4c4d49474f50584c 0100000000000000") + json.dumps(content).encode() + b"\0"
    assert discovery.parse(data, "10.0.0.9").address == taken
