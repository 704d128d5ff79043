"""The fake's side of the wire, byte by byte, against recorded and annotated frames of the vendor's client."""

from __future__ import annotations

import contextlib
import socket
import struct

import pytest
from gocator_bench import read_frame
from mbcacq_fakes.protocols.gocator import FakeGocator, FakeGocatorOptions
from mbcacq_fakes.protocols.gocator.commands import HANDLERS

NAME = struct.Struct("<64s")


def named(command: int, *names: str) -> bytes:
    return struct.pack("<IH", 6 + 64 * len(names), command) + b"".join(NAME.pack(n.encode()) for n in names)


def status(reply: bytes) -> int:
    return struct.unpack_from("<i", reply, 6)[0]


@pytest.mark.parametrize(
    ("request_hex", "reply_hex"),
    [
        ("10 00 00 00 00 00 00 00 00 11 00 00 00 00 00 00", "0a 00 00 00 00 00 1a fc ff ff"),  # version probe
        ("06 00 00 00 11 45", "0c 00 00 00 11 45 01 00 00 00 65 0b"),  # version 101.11
        ("06 00 00 00 0d 10", "0a 00 00 00 0d 10 01 00 00 00"),  # start
        ("06 00 00 00 28 45", "0a 00 00 00 28 45 01 00 00 00"),  # snapshot
        ("06 00 00 00 10 45", "0a 00 00 00 10 45 18 fc ff ff"),  # trigger while not running: -1000
        ("0e 00 00 00 10 46 a5 a3 08 cf bf 20 e3 00", "0a 00 00 00 10 46 01 00 00 00"),  # set date and time
        ("06 00 00 00 1c 10", "12 00 00 00 1c 10 01 00 00 00 00 00 00 00 00 00 00 00"),  # encoder
        ("06 00 00 00 05 10", "0e 00 00 00 05 10 01 00 00 00 03 00 00 00"),  # scan mode surface
        ("06 00 00 00 99 99", "0a 00 00 00 99 99 1a fc ff ff"),  # nobody's command: -998
        ("06 00 00 00 07 10", "0a 00 00 00 07 10 1b fc ff ff"),  # read file without a name: -997
    ],
)
def test_literal_exchange(talk, request_hex, reply_hex):
    assert talk(request_hex).hex(" ") == reply_hex


def test_system_info_of_a_3504(frame):
    wanted = (
        bytes.fromhex("8c 00 00 00 10 40 01 00 00 00 74 00 39 30 00 00 7f 00 00 01")
        + b"313504A-2-R-01-T".ljust(32, b"\0")
        + bytes.fromhex("06 01 20 0c 00 00 00 00 00 00 00 00")
        + b"3504".ljust(32, b"\0")
        + b"3504".ljust(32, b"\0")
        + bytes.fromhex("00 00 00 00 3c 00 00 00 00 00 08 00")
    )
    with (
        FakeGocator(lambda e: frame, FakeGocatorOptions(model="3504", serial=12345)) as sensor,
        socket.create_connection(("127.0.0.1", sensor.ports.control)) as sock,
    ):
        sock.sendall(bytes.fromhex("06 00 00 00 10 40"))
        assert read_frame(sock).hex(" ") == wanted.hex(" ")


def test_running_shows_in_system_info_and_states(talk):
    """The vendor's client takes the state from the system info."""
    at = 10 + 2 + 4 + 4 + 32 + 4
    assert talk("06 00 00 00 10 40")[at : at + 4] == bytes(4)
    talk("06 00 00 00 0d 10")
    assert talk("06 00 00 00 10 40")[at : at + 4] == b"\x01\0\0\0"
    assert talk("06 00 00 00 25 45")[14:18] == b"\x01\0\0\0"
    assert status(talk("06 00 00 00 28 45")) == -1000  # no snapshot while running
    assert status(talk("06 00 00 00 10 45")) == 1  # but a trigger
    assert status(talk("06 00 00 00 01 10")) == 1
    assert status(talk("06 00 00 00 01 10")) == 1  # stop is allowed at rest
    assert talk("06 00 00 00 10 40")[at : at + 4] == bytes(4)


def test_every_request_of_the_recorded_session_gets_a_reply_of_the_recorded_size(trace, frame):
    """What varies from run to run (uptime, time stamp) and what the recorded server was set up with is left out of the comparison."""
    varying = {0x4525: slice(14 + 6 * 4, 14 + 8 * 4), 0x100A: slice(10, 18), 0x4010: slice(12, 140)}
    with (
        FakeGocator(lambda e: frame, FakeGocatorOptions(intensity=False, model="3504")) as sensor,
        socket.create_connection(("127.0.0.1", sensor.ports.control)) as sock,
    ):
        compared, sensor.state.settings["alignment_state"] = 0, 1
        for ask, answer in zip(trace, trace[1:], strict=False):
            if ask.direction != "<-" or answer.direction != "->" or "WRITE_FILE" in ask.text or ask.size is None:
                continue
            sock.sendall(ask.data.ljust(ask.size, b"\0") if "COPY" not in ask.text else named(0x101B, "other.job", "_live.job"))
            reply = read_frame(sock)
            identifier = struct.unpack_from("<H", reply, 4)[0]
            if "COPY" in ask.text:
                break  # from here on the recorded configuration has changes of the write left out above
            assert len(reply) == answer.size, ask.text
            masked, recorded = bytearray(reply), bytearray(answer.data)
            for text in (masked, recorded):
                text[varying.get(identifier, slice(0))] = bytes(len(text[varying.get(identifier, slice(0))]))
            if identifier != 0x1007 or "cfg" in ask.text:
                assert masked[: len(recorded)] == recorded, ask.text
            compared += 1
        assert compared == 19


def test_states_are_seventeen(talk):
    reply = talk("06 00 00 00 25 45")
    assert len(reply) == 82
    assert struct.unpack_from("<I", reply, 10) == (17,)
    assert struct.unpack_from("<i", reply, 14 + 15 * 4) == (0,)  # security off


def test_every_command_is_answered_whatever_it_carries(fake):
    """One missing reply would leave a vendor's client busy for ever."""
    with socket.create_connection(("127.0.0.1", fake.ports.control), timeout=5) as sock:
        for command in sorted(set(HANDLERS) | set(range(0x1000, 0x1030)) | {0x3012, 0x3013} | set(range(0x4600, 0x4620))):
            for payload in (b"", bytes(3), b"\xff" * 64, bytes(400)):
                sock.sendall(struct.pack("<IH", 6 + len(payload), command) + payload)
                reply = read_frame(sock)
                assert struct.unpack_from("<H", reply, 4)[0] == command
                assert status(reply) in {1, -1000, -999, -998, -997, -987, -984, -981, -2001}


def test_files_read_copy_list_delete(talk):
    configuration = talk(named(0x1007, "_live.cfg"))
    assert struct.unpack_from("<I", configuration, 10)[0] == len(configuration) - 14
    assert b'<Configuration version="101">' in configuration
    assert b'<Transform version="100">' in talk(named(0x1007, "_live.tfm"))
    assert status(talk(named(0x1007, "nothing.job"))) == -999
    listing = talk(named(0x101A, ""))
    assert listing[10:] == struct.pack("<I64s64s", 2, b"bench.job", b"other.job")
    assert status(talk(named(0x101B, "_live.job", "saved.job"))) == 1
    assert talk("06 00 00 00 12 45")[10:] == NAME.pack(b"saved.job") + b"\0"
    assert struct.unpack_from("<I", talk(named(0x101A, "job")), 10) == (3,)
    assert status(talk(named(0x1008, "saved.job"))) == 1
    assert status(talk(named(0x1008, "saved.job"))) == -999


def test_streamed_read_ends_with_an_empty_piece(talk, fake):
    whole = talk(named(0x1007, "_live.cfg"))[14:]
    head = talk(named(0x4529, "_live.cfg"))
    assert struct.unpack_from("<II", head, 10) == (len(whole), 0)
    # the pieces follow unasked; the next exchange of this helper reads one frame each
    piece = talk("06 00 00 00 11 45")
    assert struct.unpack_from("<HiIII", piece, 4) == (0x5000, 1, len(whole), len(whole), len(whole))
    assert piece[22:] == whole
    end = talk("06 00 00 00 11 45")
    assert struct.unpack_from("<HiIII", end, 4) == (0x5000, 1, len(whole), len(whole), 0)


def test_old_firmware_sends_its_version_in_the_probe(frame):
    with (
        FakeGocator(lambda e: frame, FakeGocatorOptions(generation=4)) as sensor,
        socket.create_connection(("127.0.0.1", sensor.ports.control)) as sock,
    ):
        sock.sendall(bytes.fromhex("10 00 00 00 00 00 00 00 00 11 00 00 00 00 00 00"))
        assert read_frame(sock) == struct.pack("<IIQqQQ", 40, 0, 0x1100, 1, 101, 4)
        sock.sendall(bytes.fromhex("06 00 00 00 02 40"))
        assert len(read_frame(sock)) == 10 + 56 + 4
        sock.sendall(bytes.fromhex("06 00 00 00 25 45"))
        assert len(read_frame(sock)) == 10 + 4 + 11 * 4


def test_first_health_message_comes_at_once_and_lists_the_recorded_indicators(fake, trace):
    recorded = next(line.data for line in trace if "health size 142" in line.text)
    with socket.create_connection(("127.0.0.1", fake.ports.health), timeout=5) as sock:
        message = read_frame(sock)
    assert len(message) == 142
    assert message[:14] == recorded[:14]
    assert [message[14 + 16 * i : 22 + 16 * i] for i in range(8)] == [recorded[14 + 16 * i : 22 + 16 * i] for i in range(8)]


def test_requests_that_are_no_frames_end_the_connection(fake):
    with socket.create_connection(("127.0.0.1", fake.ports.control), timeout=5) as sock:
        sock.sendall(b"\x03\0\0\0\x11\x45")
        assert sock.recv(10) == b""
    with socket.create_connection(("127.0.0.1", fake.ports.control), timeout=5) as sock:
        sock.sendall(b"GET / HTTP/1.1\r\n\r\n")
        with contextlib.suppress(ConnectionResetError):  # as a close with bytes unread may be seen
            assert sock.recv(10) == b""
