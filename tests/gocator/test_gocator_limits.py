"""A sensor, or what answers in its place, cannot make the driver run out of stack, memory or time."""

from __future__ import annotations

import itertools
import socket
import struct
import tracemalloc
from collections.abc import Callable

import numpy as np
import pytest
from mbcacq_fakes.protocols.gocator import encode
from mbcacq_fakes.protocols.gocator.files import Files
from mbcacq_fakes.protocols.gocator.replies import CommandRefused
from mbcacq_gocator import layouts, wire
from mbcacq_gocator.configuration import Configuration
from mbcacq_gocator.dataset import read_set
from mbcacq_gocator.decode import decode
from mbcacq_gocator.health import HealthReader
from mbcacq_gocator.points import surface_points

from mbcacq.conformance.bounded import eventually
from mbcacq.devices import DeviceTimeout, ProtocolError


def peak(action: Callable[[], object]) -> int:
    """Bytes that ``action`` needed at most; it must end in a ProtocolError."""
    tracemalloc.start()
    try:
        with pytest.raises(ProtocolError):
            action()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def configuration(inner: bytes) -> bytes:
    return b'<Configuration version="101">' + inner + b"</Configuration>"


class Sent:
    """A socket that has received ``messages``; each read takes ``seconds`` on the clock that ``wire`` goes by."""

    def __init__(self, messages, seconds: float = 0.0) -> None:
        self._messages, self._rest, self._seconds, self.now = iter(messages), memoryview(b""), seconds, 0.0
        self.taken = 0

    def monotonic(self) -> float:
        return self.now

    def settimeout(self, seconds: float) -> None:
        pass

    def recv_into(self, view: memoryview) -> int:
        self.now += self._seconds
        if not self._rest:
            self._rest = memoryview(next(self._messages, b""))
        part = self._rest[: len(view)]
        view[: len(part)], self._rest = part, self._rest[len(part) :]
        self.taken += len(part)
        return len(part)


@pytest.mark.parametrize("deep", [65, 1000, 100_000])
def test_a_deeply_nested_configuration_is_refused(deep):
    data = configuration(b"<a>" * deep + b"</a>" * deep)
    assert peak(lambda: Configuration(data)) < 2 * 2**20
    with pytest.raises(CommandRefused):
        Files(("a.job",), {}).write("_live.cfg", data)


def test_a_configuration_as_deep_as_allowed_can_be_written_back():
    data = configuration(b"<a>" * 63 + b"</a>" * 63)
    assert Configuration(data).values_only().count(b"<a") == 63


@pytest.mark.parametrize("inner", [b"<a/>" * 200_000, b"<a>" + b'<b c="" d="" e=""/>' * 60_000 + b"</a>"], ids=["elements", "attributes"])
def test_a_configuration_of_too_many_parts_is_refused(inner):
    assert peak(lambda: Configuration(configuration(inner))) < 30 * 2**20
    with pytest.raises(ProtocolError, match="more than 100000 elements and attributes"):
        Configuration(configuration(inner))


def test_a_configuration_of_too_many_bytes_is_refused_unread():
    data = configuration(b" " * 4 * 2**20)
    assert peak(lambda: Configuration(data)) < 65536


@pytest.mark.parametrize(
    ("kind", "head"), [(10, struct.pack("<IHH", 10**6, 0, 7)), (31, struct.pack("<HIHHii", 16, 10**6, 0, 7, 1, 0))], ids=["old", "new"]
)
def test_a_measurement_of_a_million_values_takes_no_memory(kind, head):
    message = struct.pack("<IH", 6 + len(head) + 8 * 10**6, kind | 0x8000) + head + bytes(8 * 10**6)
    assert peak(lambda: decode(message)) < 65536
    reader = wire.MessageReader(sent := Sent([message]), "scan", limit=layouts.size_limit)
    assert peak(lambda: read_set(reader, float("inf"))) < 65536
    assert sent.taken == 6  # its header


def test_measurements_without_end_are_refused():
    values = [encode.measurement(number, 1.0) for number in range(9_999)]
    many = encode.measurement(1, 1.0)
    body = struct.pack("<HIHHii", 16, 1000, 0, 7, 1, 0) + bytes(many[-8:]) * 1000
    block = struct.pack("<IH", 6 + len(body), 31) + body
    with pytest.raises(ProtocolError, match="more than 10000 measurements in one data set"):
        read_set(wire.MessageReader(Sent([*values[:9_500], block]), "scan"), float("inf"))
    last = encode.mark_last(bytearray(block))
    assert len(read_set(wire.MessageReader(Sent([*values[:9_000], last]), "scan"), float("inf")).measurements) == 9_999


def test_a_data_set_larger_than_the_limit_is_refused(monkeypatch):
    monkeypatch.setattr(wire, "MAX_SET", 3 * 2**20)
    cloud = encode.surface_intensity(np.zeros((1024, 1024), np.uint8), encode.Scaling((1, 1, 1), (0, 0, 0)), 0)
    reader = wire.MessageReader(Sent(itertools.repeat(bytes(cloud))), "scan")
    assert peak(lambda: read_set(reader, float("inf"))) < 10 * 2**20


def test_messages_that_never_end_stop_at_the_deadline(monkeypatch):
    sent = Sent(itertools.repeat(bytes(encode.measurement(1, 2.0))), seconds=0.25)
    monkeypatch.setattr(wire, "time", sent)
    with pytest.raises(DeviceTimeout):
        read_set(wire.MessageReader(sent, "scan"), 10.0)
    assert sent.now <= 10.25


def test_health_indicators_without_end_do_not_accumulate():
    with socket.create_server(("127.0.0.1", 0)) as server:
        reader = HealthReader("127.0.0.1", server.getsockname()[1], 5.0)
        reader.open()
        sensor, _ = server.accept()
        with sensor:
            for first in range(0, 100_000, 2_000):
                sensor.sendall(encode.health({(2002, 0): first // 2_000, **{(n, 0): n for n in range(30_000 + first, 32_000 + first)}}))
            eventually(lambda: reader.values().get("temperature_C") == 49, 60.0, "the last message is read")
            assert len(reader.values()) <= 4096
            reader.close()


def test_a_health_message_of_many_megabytes_is_not_received():
    with socket.create_server(("127.0.0.1", 0)) as server:
        reader = HealthReader("127.0.0.1", server.getsockname()[1], 5.0)
        reader.open()
        sensor, _ = server.accept()
        with sensor:
            sensor.sendall(struct.pack("<IH", 100 * 2**20, 0x8000))
            eventually(lambda: not reader.alive, 60.0, "the connection is given up")
        reader.close()


@pytest.mark.parametrize("shape", [(0, 0), (0, 7), (7, 0)])
@pytest.mark.parametrize("kind", [28, 8])
def test_an_empty_surface_has_rows_and_columns_like_any_other(kind, shape):
    attributes = struct.pack("<II3I3iBIBii", *shape, 1000, 1000, 1000, 0, 0, 0, 0, 0, 0, 3, 0)
    body = struct.pack("<H", len(attributes)) + attributes
    surface = surface_points(decode(struct.pack("<IH", 6 + len(body), kind) + body)[0])
    assert surface.shape == shape
    assert surface.points.shape == (0, 3)
