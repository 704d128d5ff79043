"""The control channel: one request in flight, one reply for it, and never a reply taken for another's."""

from __future__ import annotations

import socket
import struct
from functools import partial

from mbcacq.devices import IdentityError, ProtocolError
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
    """Requests to one sensor."""

    version: tuple[int, int] = (0, 0)

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
        data = _REQUEST.pack(_REQUEST.size + len(payload), command.id) + payload
        return self._exchange(command.name, data, command.limit_s, partial(self._reply_to, command), wait_s)

    def _reply_to(self, command: GocatorCommand, sock: socket.socket, deadline: float) -> memoryview:
        length, answered, status, body = _read_reply(f"reply to '{command.name}'", sock, deadline)
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
        name, limit_s = "version probe", commands.PROTOCOL_VERSION.limit_s
        length, _, _, body = self._exchange(name, _PROBE, limit_s, partial(_read_reply, f"reply to '{name}'"))
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


def _read_reply(what: str, sock: socket.socket, deadline: float) -> tuple[int, int, int, memoryview]:
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
