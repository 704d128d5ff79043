"""The driver against the sources of the vendor's own client (GoPxL SDK for C++, 2022 to 2025, MIT licence). They say which requests it
writes, byte for byte, which replies it takes, and how it reads the messages of a scan. Read, not copied: bytes are made after their
order."""

import re
import socket
import struct
import threading

import numpy as np
import pytest
from mbcacq_gocator.gopxl import control, frames, gdp
from mbcacq_gocator.gopxl.driver import GoPxL

from mbcacq.devices import ProtocolError

SCANNER = "/scan/engines/ENGINE/scanners/scanner-0"
# Where the vendor uses each: GoSystem.cpp, the samples that come with it (S), or the REST reference of release 1.2 (R).
VENDORS = {
    ("read", "/version"),  # R
    ("read", "/environ/info"),  # S
    ("read", "/environ/remoteController"),  # S: VerifyConnection
    ("read", "/system"),
    ("call", "/system/commands/start"),
    ("call", "/system/commands/stop"),
    ("read", "/system/metrics"),  # S: ReceiveMetrics
    ("read", "/jobs"),  # S: SaveJob
    ("call", "/jobs/commands/load"),  # S: SaveJob
    ("read", "/scan/engines"),
    ("read", "/scan/engines/ENGINE/scanners"),
    ("read", f"{SCANNER}/sensors"),
    ("read", f"{SCANNER}/sensors/sensor-0"),
    ("update", f"{SCANNER}/sensors/sensor-0"),  # S: ConfigureSensor
    ("read", f"{SCANNER}/sensors/sensor-0/metrics"),  # S: ReceiveMetrics
    ("read", SCANNER),  # S: ReceiveSurface
    ("update", SCANNER),  # S: ReceiveSurface
    ("read", f"{SCANNER}/alignment"),  # S: AlignSensor
    ("read", f"{SCANNER}/sensors/sensor-0/transform"),  # S: AlignSensor
    ("read", f"{SCANNER}/metrics"),  # S: ReceiveMetrics
    ("read", f"{SCANNER}/outputs"),  # S: how an image source is found
    ("call", f"{SCANNER}/actions/trigger"),  # S: ReceiveImage
    ("read", "/controls/gocator"),
    ("update", "/controls/gocator"),  # S: ReceiveSurface
    ("read", "/controls/gocator/outputs"),  # S: ReceiveSurface
    ("call", "/controls/gocator/outputs/commands/add"),  # S: ReceiveSurface
    ("call", "/controls/gocator/outputs/commands/remove"),  # S
}


def packed(value):
    """MessagePack as the vendor's client writes it: the shortest form of each, keys in the order of their bytes. Its floats may have four
    bytes; the driver's have eight."""
    if isinstance(value, dict):
        assert len(value) < 16
        return bytes([0x80 | len(value)]) + b"".join(packed(key) + packed(value[key]) for key in sorted(value))
    if isinstance(value, list):
        assert len(value) < 16
        return bytes([0x90 | len(value)]) + b"".join(map(packed, value))
    if isinstance(value, bool):
        return b"\xc3" if value else b"\xc2"
    if isinstance(value, str):
        text = value.encode()
        return (bytes([0xA0 | len(text)]) if len(text) < 32 else b"\xd9" + bytes([len(text)])) + text
    if isinstance(value, int):
        return bytes([value]) if value < 128 else b"\xcd" + struct.pack(">H", value)
    return b"\xcb" + struct.pack(">d", value)


def written(method, path, payload, args):
    """GoRequest::ToByteArray and GoCtrlChannelV1::ProcessRequest: a length that counts itself, 0xB000, a length that does not, four keys."""
    body = packed({"method": method, "path": path, "payload": payload, "args": args})
    return struct.pack("<I", 10 + len(body)) + b"\x00\xb0" + struct.pack("<I", len(body)) + body


def test_every_request_of_a_run_is_one_that_the_vendors_client_writes(sensor, options, monkeypatch):
    asked, request = [], frames.request

    def noted(method, path, payload=None, args=None):
        asked.append((method, path, payload or {}, args or {}, request(method, path, payload, args)))
        return asked[-1][-1]

    monkeypatch.setattr(frames, "request", noted)
    with GoPxL("s", "", {**options, "exposure_us": 900.0}) as scanner:
        scanner.capture()
    used = set()
    for method, path, payload, args, data in asked:
        assert set(args) <= {"expandLevel"}
        used.add((method, re.sub("/engines/[^/]+", "/engines/ENGINE", path.rstrip("/"))))
        ordered = request(method, path, _sorted(payload), args)
        assert len(data) == len(ordered) == len(written(method, path, payload, args)), path
        assert ordered == written(method, path, payload, args), path
    assert used <= VENDORS
    assert len(used) > 18


def _sorted(value):
    """Keys in the order of the vendor's client; which one they have is of no meaning in a map."""
    return {key: _sorted(value[key]) for key in sorted(value)} if isinstance(value, dict) else value


def framed(body, status=1, behind=b""):
    return struct.pack("<IHiI", 14 + len(body) + len(behind), 0xB000, status, len(body)) + body + behind


VERSION = bytes.fromhex(  # the example of the REST reference: no path, keys in their order
    "83 a77061796c6f6164 82 a65f6c696e6b73 81 a473656c66 81 a468726566 a82f76657273696f6e aa61706956657273696f6e a5312e302e30"
    "a6737461747573 01 a474797065 a8726573706f6e7365"
)
TAKEN = {
    "as in the REST reference": (framed(VERSION), "1.0.0"),
    "with bytes behind the map, which EndRead skips": (framed(VERSION, behind=b"later"), "1.0.0"),
    "without a status": (framed(packed({"type": "response", "payload": {"apiVersion": "1.5"}})), "1.5"),
    "of a type that no client knows": (framed(packed({"type": "undefined", "payload": {"apiVersion": "1.5"}})), "1.5"),
    "without a payload": (framed(packed({"type": "response", "status": 1})), None),
    "with nil as payload": (framed(b"\x82" + packed("type") + packed("response") + packed("payload") + b"\xc0"), None),
    "after a notification and a stream": (
        framed(packed({"type": "notification", "eventType": "embeddedUpdated", "path": "/system", "payload": {}}))
        + framed(packed({"type": "stream", "path": "/system/metrics", "status": 1, "streamId": 7, "streamStatus": "any", "payload": {}}))
        + framed(VERSION),
        "1.0.0",
    ),
}


@pytest.fixture
def server():
    """One request, then the bytes that ``replies`` holds."""
    replies = []
    with socket.create_server(("127.0.0.1", 0)) as listening:

        def serve():
            connection, _ = listening.accept()
            with connection:
                connection.recv(4096)
                connection.sendall(replies[0])
                connection.recv(1)

        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        made = control.GoPxLControl("127.0.0.1", listening.getsockname()[1], 20.0, 20.0)
        made.open()
        yield made, replies
        made.close()
        thread.join(20.0)


@pytest.mark.parametrize("which", TAKEN)
def test_a_reply_that_the_vendors_client_takes_is_taken(server, which):
    client, replies = server
    reply, version = TAKEN[which]
    replies.append(reply)
    assert client.read("/version").get("apiVersion") == version


@pytest.mark.parametrize(
    "reply",
    [
        framed(packed({"status": 1, "payload": {}})),  # no type: InvalidMessageContent
        framed(VERSION)[:4] + b"\x01\xb0" + framed(VERSION)[6:],  # JSON: InvalidMessageType
        framed(VERSION[:-3]),  # MessagePack that ends early
    ],
    ids=["no type", "JSON", "cut"],
)
def test_a_reply_that_the_vendors_client_cannot_read_is_an_error_by_name(server, reply):
    client, replies = server
    replies.append(reply)
    with pytest.raises(ProtocolError):
        client.read("/version")


# GoGdpMsg.cpp: space type, transform of 12 floats, box of 6 floats, arrayed count and index, two names, set, last, id. Then
# GoGdpSurfaceBase.cpp with GoGdpSurfaceUniform.cpp: lengths, resolutions, offsets, surface id, exposure; ranges and grey values follow.
UNIFORM = bytes.fromhex(
    "c1000000 0e00"
    "6b000000 01"
    "01 0000803f 00000000 00000000 00002041 00000000 0000803f 00000000 000020c1 00000000 00000000 0000803f 0000f041"
    "01 000080bf 000080bf 00000000 00000040 00000040 0000803f"
    "02000000 01000000 0400 613a7573 0100 73 0900000000000000 01 0500"
    "4a00 01000000 02000000 01000000 02000000 000000000000e03f 000000000000e03f fca9f1d24d62503f"
    "0000000000002440 00000000000034c0 0000000000003e40 03000000 00247449"
    "e803 0080 64 c8"
)


def test_a_uniform_surface_with_transform_and_box_is_read_in_the_vendors_order():
    view = memoryview(UNIFORM)
    common = gdp.parse_common(view)
    assert (common.type, common.source, common.set_id, common.last, common.output, common.transformed) == (14, "a:us", 9, True, 5, True)
    found = gdp.GdpSet()
    gdp.add(found, view, common)
    surface = found.surface
    assert surface.raw.tolist() == [[1000, -32768]]
    assert surface.intensity.tolist() == [[100, 200]]
    np.testing.assert_allclose([surface.scale, surface.offset], [[0.5, 0.5, 0.001], [10.0, -20.0, 30.0]])
    assert surface.exposure_us == pytest.approx(1000.0)
