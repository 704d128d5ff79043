"""Discovery datagrams, byte by byte, and over the loopback's own broadcast address."""

from __future__ import annotations

import struct

import pytest
from mbcacq_fakes.protocols.gocator import FakeGocator, FakeGocatorOptions
from mbcacq_fakes.protocols.gocator.discovery import Discovery
from mbcacq_fakes.protocols.gocator.options import Ports
from mbcacq_fakes.protocols.gocator.state import SensorState
from mbcacq_gocator.discovery import find_sensors, parse_reply
from mbcacq_gocator.driver import Gocator
from mbcacq_gocator.locate import elsewhere
from mbcacq_gocator.options import GocatorOptions

from mbcacq.devices import ConnectError, IdentityError, ProtocolError, parse_options

REQUEST = bytes.fromhex("20 00 00 00 00 00 00 00 05 00 00 00 00 00 00 00 4c 4d 49 55 44 50 00 00 00 00 00 00 00 00 00 00")
HEAD = bytes.fromhex(
    "ea 00 00 00 00 00 00 00 05 10 00 00 00 00 00 00 01 00 00 00 00 00 00 00 4c 4d 49 55 44 50 00 00 41 00 39 30 00 00 0c 20 01 06"
)
PORTS = bytes.fromhex("76 0c 78 0c 7a 0c 7c 0c 50 00 07 0a") + b"PartNumber" + b"\x10" + b"313504A-2-R-01-T"


@pytest.fixture
def discovery():
    # Ports of a real sensor, but no channel is opened: only the datagrams are looked at.
    made = Discovery(SensorState(FakeGocatorOptions(model="3504", serial=12345)), Ports(3190, 3194, 3196), port=0)
    yield made
    made.close()


def test_reply_to_get_info_is_the_annotated_datagram(discovery):
    reply = discovery.answer(REQUEST)
    assert len(reply) == 234
    assert reply[:42].hex(" ") == HEAD.hex(" ")
    assert reply[50:72].hex(" ") == "00 04 7f 00 00 01 00 00 00 00 00 00 00 00 00 00 00 00 18 00 00 00"
    assert reply[89 : 89 + len(PORTS)] == PORTS


def test_driver_reads_the_annotated_datagram():
    middle = struct.pack("<QBB4s12sIB4s12s", 5_000_000, 1, 4, bytes([10, 0, 0, 7]), b"", 24, 4, bytes([10, 0, 0, 1]), b"")
    properties = PORTS + b"".join(bytes([len(t)]) + t for t in [b"ModelNumber", b"3504", b"Family", b"G3x00"])
    data = bytearray(HEAD + middle + properties)
    data[:8] = struct.pack("<Q", len(data))
    data[89 + 10] = 3  # count of properties
    found = parse_reply(data)
    assert (found.serial, found.firmware, found.address, found.prefix_length) == (12345, (6, 1, 32, 12), "10.0.0.7", 24)
    assert (found.control_port, found.health_port, found.data_port) == (3190, 3194, 3196)
    assert found.properties == {"PartNumber": "313504A-2-R-01-T", "ModelNumber": "3504", "Family": "G3x00"}
    assert found.model == "3504"
    for cut in range(len(data)):
        short = bytearray(data[:cut])
        short[:8] = struct.pack("<Q", cut)[:cut]
        with pytest.raises(ProtocolError):
            parse_reply(short)


def test_old_clients_get_the_old_reply(discovery):
    old = discovery.answer(REQUEST[:8] + b"\x01" + REQUEST[9:])
    assert struct.unpack("<QQqQQQ4x4s4x4s8x8x", old) == (
        80,
        0x1001,
        1,
        0x0000504455494D4C,
        12345,
        0,
        bytes([127, 0, 0, 1]),
        bytes([255, 255, 255, 0]),
    )


@pytest.mark.parametrize(
    "request_bytes",
    [
        b"",
        REQUEST[:31],
        REQUEST + b"x",
        REQUEST[:16] + b"LMIUDQ" + REQUEST[22:],
        REQUEST[:24] + struct.pack("<Q", 99),
        REQUEST[:8] + b"\x09" + REQUEST[9:],
    ],
)
def test_datagrams_for_others_are_not_answered(discovery, request_bytes):
    assert discovery.answer(request_bytes) is None


def test_sensor_is_found_with_its_own_ports_by_a_broadcast_reply(frame):
    with FakeGocator(
        lambda e: frame, FakeGocatorOptions(discovery=True, discovery_port=0, broadcast="127.255.255.255", serial=777)
    ) as sensor:
        found = find_sensors(1.0, "127.0.0.1", sensor.discovery_port, serial=777)
        assert find_sensors(0.2, "127.0.0.1", sensor.discovery_port, serial=778) == []
    assert [(f.serial, f.model, f.address) for f in found] == [(777, "3210", "127.0.0.1")]
    assert (found[0].control_port, found[0].health_port, found[0].data_port) == sensor.ports


def test_firmware_before_5_1_sends_its_address_only():
    reply = bytes.fromhex(
        "50 00 00 00 00 00 00 00 01 10 00 00 00 00 00 00 01 00 00 00 00 00 00 00 4c 4d 49 55 44 50 00 00"
        "39 30 00 00 00 00 00 00 01 00 00 00 00 00 00 00 00 00 00 00 0a 00 00 07 00 00 00 00 ff ff fe 00"
        "00 00 00 00 0a 00 00 01 00 00 00 00 00 00 00 00"
    )
    found = parse_reply(reply)
    assert (found.serial, found.address, found.prefix_length) == (12345, "10.0.0.7", 23)
    assert (found.firmware, found.control_port, found.health_port, found.data_port) == ((0, 0, 0, 0), 3190, 3194, 3196)
    with pytest.raises(ProtocolError):
        parse_reply(reply[:24] + b"X" + reply[25:])


@pytest.fixture
def network(frame):
    """Options that look for sensors on the loopback's own broadcast address, where two answer."""
    with FakeGocator(
        lambda e: frame, FakeGocatorOptions(discovery=True, discovery_port=0, broadcast="127.255.255.255", serial=777)
    ) as sensor:
        yield {"broadcast": "127.0.0.1", "discovery_port": sensor.discovery_port}


def test_a_plan_may_name_the_serial_number_instead_of_an_address(network):
    with Gocator("front", "3210", {"serial": 777, **network}) as scanner:
        assert scanner.describe().serial == "777"
        assert len(scanner.capture().points) == 228


def test_a_sensor_that_does_not_answer_is_reported_with_those_that_do(network):
    with pytest.raises(ConnectError, match="no Gocator with serial 778 answers a broadcast .found: 3210 serial 777 at 127.0.0.1"):
        Gocator("front", "", {"serial": 778, **network}).connect()


def test_another_serial_at_the_plans_address_is_refused(fake, driver):
    with pytest.raises(IdentityError, match="asks for the Gocator with serial 99 but the sensor at 127.0.0.1 is serial 12345"):
        driver(serial=99).connect()


def test_a_wrong_address_is_answered_with_what_is_there(network):
    options = parse_options(GocatorOptions, "the scanner", {"address": "192.0.2.7", **network})
    error = elsewhere(ConnectError("cannot be reached"), options)
    assert str(error) == "cannot be reached; found: 3210 serial 777 at 127.0.0.1"
