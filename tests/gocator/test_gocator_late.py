"""A reply that comes after its time limit is never taken for that to the next request: both control channels end with it."""

import socket
import struct
import threading

import msgpack
import pytest
from mbcacq_gocator import commands
from mbcacq_gocator.control import ControlChannel
from mbcacq_gocator.gopxl.control import GoPxLControl

from mbcacq.devices import ConnectError, DeviceTimeout

LIMIT_S = 0.5


class HeldSensor:
    """Answers each request in order with ``reply``; the one numbered ``held`` only when the next connection or request has come."""

    def __init__(self, header, reply, held):
        self._header, self._reply, self._held = header, reply, held
        self._count, self._go = 0, threading.Event()
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = self._listener.getsockname()[1]
        threading.Thread(target=self._accept, daemon=True).start()

    def release(self):
        self._go.set()

    def close(self):
        self._go.set()
        self._listener.close()

    def _accept(self):
        while True:
            try:
                client, _ = self._listener.accept()
            except OSError:
                return
            threading.Thread(target=self._serve, args=(client,), daemon=True).start()

    def _serve(self, client):
        try:
            with client, client.makefile("rb") as stream:
                while len(head := stream.read(self._header.size)) == self._header.size:
                    body = stream.read(self._header.unpack(head)[0] - len(head))
                    number, self._count = self._count, self._count + 1
                    if number == self._held:
                        self._go.wait(60)
                    client.sendall(self._reply(head, body))
        except OSError:
            return


def classic(head, body):
    _, identifier = struct.unpack("<IH", head)
    payload = {0: b"", 0x4511: b"\x65\x0b", 0x1005: struct.pack("<i", 3)}.get(identifier, struct.pack("<Q", 77))
    return struct.pack("<IHi", 10 + len(payload), identifier, 1) + payload


def gopxl(head, body):
    asked = msgpack.unpackb(body[4:])
    content = msgpack.packb({"type": "response", "status": 1, "path": asked["path"], "payload": {"answer": asked["path"]}})
    return struct.pack("<IHiI", 14 + len(content), 0xB000, 1, len(content)) + content


@pytest.fixture
def held(request):
    sensor = HeldSensor(*request.param)
    yield sensor
    sensor.close()


@pytest.mark.parametrize("held", [(struct.Struct("<IH"), classic, 2)], indirect=True)
def test_gocator_control(held):
    channel = ControlChannel("127.0.0.1", held.port, reply_limit_s=LIMIT_S)
    channel.open()
    with pytest.raises(DeviceTimeout, match="did not come in time"):
        channel.request(commands.SCAN_MODE)
    held.release()
    with pytest.raises(ConnectError, match="is closed; connect first"):
        channel.request(commands.TIME_STAMP)
    channel.open()
    assert struct.unpack("<Q", channel.request(commands.TIME_STAMP)) == (77,)
    channel.close()


@pytest.mark.parametrize("held", [(struct.Struct("<IH"), gopxl, 0)], indirect=True)
def test_gopxl_control(held):
    control = GoPxLControl("127.0.0.1", held.port, 20.0, LIMIT_S)
    control.open()
    with pytest.raises(DeviceTimeout):
        control.read("/system")
    held.release()
    with pytest.raises(ConnectError, match="is closed; connect first"):
        control.read("/jobs")
    control.open()
    assert control.read("/jobs") == {"answer": "/jobs"}
    control.close()
