"""The control channel: one request in flight, one reply for it, and never a reply taken for another's."""

from __future__ import annotations

import socket
import struct
import threading
import time

from mbcacq.devices import ConnectError, DeviceTimeout, IdentityError, ProtocolError
from mbcacq_gocator import commands, wire
from mbcacq_gocator.commands import GocatorCommand
from mbcacq_gocator.request_connection import RequestConnection
from mbcacq_gocator.status import OK, SensorRefused, meaning

PROTOCOL_MAJOR = 101
MAX_REPLY = 64 * 2**20
_REQUEST = struct.Struct("<IH")
_REPLY = struct.Struct("<IHi")
# Readable by old firmware as a 64-bit and by new firmware as a 32-bit frame.
_PROBE = bytes.fromhex("10000000000000000011000000000000")
_OLD_PROBE_REPLY = 40
_FIRST_STEP = 64 * 1024


class ControlChannel(RequestConnection):
    """Requests to one sensor. Safe to use from several threads; they take turns.

    After a reply that did not come or made no sense the channel is closed: a late reply could otherwise be taken for the next one.
    """

    def __init__(
        self, address: str, port: int, connect_timeout_s: float = 3.0, reply_limit_s: float | None = None, grace_s: float = 0.0
    ) -> None:
        super().__init__(address, port, connect_timeout_s, reply_limit_s, grace_s)
        self._turn = threading.Lock()
        self.version: tuple[int, int] = (0, 0)

    def open(self) -> None:
        """Connect and compare protocol versions. Raises ConnectError, IdentityError, DeviceTimeout, ProtocolError."""
        self._sock = wire.connect(self._address, self._port, "control", self._connect_timeout_s)
        try:
            self.version = self._probe() or self._ask_version()
            if self.version[0] != PROTOCOL_MAJOR:
                spoken = ".".join(map(str, self.version))
                raise IdentityError(
                    f"the sensor at {self._address}:{self._port} speaks Gocator protocol {spoken}, this driver "
                    f"{PROTOCOL_MAJOR}.x; use a sensor firmware of 4.x to 6.x"
                )
        except BaseException:
            self.close()
            raise

    def request(self, command: GocatorCommand, payload: bytes = b"", wait_s: float | None = None) -> memoryview:
        """Send one command and return the payload of its reply. ``wait_s`` bounds the wait for one's turn.

        Raises SensorRefused (a DeviceFault) on a bad status, DeviceTimeout, ConnectError, ProtocolError.
        """
        if not self._turn.acquire(timeout=-1 if wait_s is None else wait_s):
            raise DeviceTimeout(f"the Gocator is still busy with another command, so '{command.name}' was not sent")
        try:
            sock = self._sock
            if sock is None:
                raise ConnectError(f"the control connection to the Gocator at {self._address}:{self._port} is closed; connect first")
            try:
                return self._exchange(sock, command, payload)
            except SensorRefused:
                raise
            except BaseException:
                self.close()
                raise
        finally:
            self._turn.release()

    def _limit(self, command: GocatorCommand) -> float:
        return self._grace_s + (command.limit_s if self._reply_limit_s is None else min(command.limit_s, self._reply_limit_s))

    def _exchange(self, sock: socket.socket, command: GocatorCommand, payload: bytes) -> memoryview:
        deadline = time.monotonic() + self._limit(command)
        what = f"reply to '{command.name}'"
        _send(sock, _REQUEST.pack(_REQUEST.size + len(payload), command.id) + payload, command.name, self._limit(command))
        length, answered, status, body = _read_reply(sock, what, deadline)
        if answered != command.id:
            raise ProtocolError(
                f"the Gocator answered '{command.name}' (0x{command.id:04X}) with a reply to 0x{answered:04X} "
                f"of {length} bytes; reconnect, and check that a Gocator listens at port {self._port}"
            )
        if status != OK:
            raise SensorRefused(f"the Gocator refused '{command.name}': {meaning(status)}", status)
        return body

    def _probe(self) -> tuple[int, int] | None:
        """The version, if firmware old enough to answer in 64-bit fields reports it here."""
        assert self._sock is not None
        limit = self._limit(commands.PROTOCOL_VERSION)
        _send(self._sock, _PROBE, "version probe", limit)
        length, _, _, body = _read_reply(self._sock, "reply to 'version probe'", time.monotonic() + limit)
        if length != _OLD_PROBE_REPLY:
            return None
        # u32 40, u32 0, u64 id, s64 status, u64 major, u64 minor; body starts at byte 10
        status, major, minor = struct.unpack_from("<qQQ", body, 6)
        return (major, minor) if status == OK else None

    def _ask_version(self) -> tuple[int, int]:
        body = self.request(commands.PROTOCOL_VERSION)
        if len(body) < 2:
            raise ProtocolError(f"the version reply at port {self._port} has {len(body)} bytes instead of 2; no Gocator listens there")
        return body[0], body[1]


def _send(sock: socket.socket, data: bytes, name: str, limit_s: float) -> None:
    try:
        sock.settimeout(limit_s)
        sock.sendall(data)
    except TimeoutError:
        raise DeviceTimeout(f"the Gocator does not take in '{name}'; check the network") from None
    except OSError as error:
        raise wire.Dropped(f"the control connection broke while sending '{name}' ({error.strerror or error})") from None


def _read_reply(sock: socket.socket, what: str, deadline: float) -> tuple[int, int, int, memoryview]:
    header = memoryview(bytearray(_REPLY.size))
    wire.receive_exactly(sock, header, what, deadline)
    length, identifier, status = _REPLY.unpack(header)
    if not _REPLY.size <= length <= MAX_REPLY:
        raise ProtocolError(f"the {what} announces {length} bytes; no Gocator listens at this port, or the connection is out of step")
    body, wanted = bytearray(), length - _REPLY.size
    while (have := len(body)) < wanted:  # space is made as bytes come in, so a wrong length cannot claim memory that nothing fills
        body.extend(bytes(min(wanted - have, max(_FIRST_STEP, have))))
        wire.receive_exactly(sock, memoryview(body)[have:], what, deadline, started=True)
    return length, identifier, status, memoryview(body)
