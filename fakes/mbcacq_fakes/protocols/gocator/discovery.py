"""Discovery on udp 3220: requests in, broadcast replies out of the same port to the port of the asker.

A unicast reply does not reach the vendor's client on Linux: it has two sockets on its port and the other one swallows it.
"""

from __future__ import annotations

import socket
import struct

from mbcacq_fakes.protocols import datagrams
from mbcacq_fakes.protocols.gocator.options import DISCOVERY_PORT, Ports
from mbcacq_fakes.protocols.gocator.state import SensorState

SIGNATURE = 0x0000504455494D4C
GET_ADDRESS, GET_INFO, REPLY = 1, 5, 0x1000
_WEB_PORT, _UPGRADE_PORT = 80, 3192


class Discovery(datagrams.Responder):
    """ports: of the sensor's channels. broadcast: where replies go; 127.255.255.255 stays on the loopback interface."""

    def __init__(self, state: SensorState, ports: Ports, port: int = DISCOVERY_PORT, broadcast: str = "255.255.255.255") -> None:
        super().__init__("fake-gocator-discovery", port, 2048)
        self._state, self._ports, self._broadcast = state, ports, broadcast

    def respond(self, data: bytes, asker: tuple[str, int], interface: int) -> None:
        if answer := self.answer(data, asker):
            limited = self._broadcast == "255.255.255.255"  # which goes out by one interface only
            datagrams.send(self._sock, answer, (self._broadcast, asker[1]), interface if limited else 0)

    def answer(self, request: bytes, asker: tuple[str, int] | None = None) -> bytes | None:
        """The reply to one request, None if it is not for this sensor. A sensor on all addresses has that which ``asker`` sees."""
        if len(request) < 32:
            return None
        length, kind, signature, serial = struct.unpack_from("<QQQQ", request)
        if length != len(request) or signature != SIGNATURE or serial not in (0, self._state.serial):
            return None
        on_all = self._state.options.host in ("", "0.0.0.0")
        seen = datagrams.facing(asker) if on_all and asker is not None else ""
        address = socket.inet_aton(seen or self._state.address)
        if kind == GET_ADDRESS:
            addresses = (address, b"\xff\xff\xff\0", bytes(4), bytes(4))  # own, mask, gateway, spare
            body = struct.pack("<QQ", self._state.serial, 0) + b"".join(bytes(4) + a for a in addresses)
        elif kind == GET_INFO:
            body = struct.pack("<H", 65) + self._info(address) + self._properties()
        else:
            return None
        return struct.pack("<QQqQ", 32 + len(body), REPLY + kind, 1, SIGNATURE) + body

    def _info(self, address: bytes) -> bytes:
        major, minor, release, build = self._state.firmware
        ports = self._ports
        return struct.pack(
            "<IIQBB4s12sIB4s12s5H",
            self._state.serial,
            major << 24 | minor << 16 | release << 8 | build,
            int(self._state.uptime_s * 1e6),
            0,
            4,
            address,
            bytes(12),
            24,
            4,
            bytes(4),
            bytes(12),
            ports.control,
            _UPGRADE_PORT,
            ports.health,
            ports.data,
            _WEB_PORT,
        )

    def _properties(self) -> bytes:
        family = f"G{self._state.model[:1]}x00"
        pairs = {
            "PartNumber": self._state.part_number,
            "ModelNumber": self._state.model,
            "ModelDisplayName": self._state.model,
            "Family": family,
            "OpMode": "1",
            "AccelSensorIpVersion": "4",
            "AccelSensorIp": "0.0.0.0",
        }
        return bytes([len(pairs)]) + b"".join(bytes([len(t)]) + t for pair in pairs.items() for t in (v.encode() for v in pair))
