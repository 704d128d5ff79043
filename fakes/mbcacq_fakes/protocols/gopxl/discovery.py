"""The fake sensor's answer to discovery: an announcement on udp 3320, as JSON behind a header."""

from __future__ import annotations

import json
import socket
import struct
from collections.abc import Callable
from ipaddress import IPv4Address
from typing import Any

from mbcacq.devices import is_own_address
from mbcacq_fakes.protocols import datagrams

PORT = 3320
SIGNATURE = int.from_bytes(b"LMIGOPXL", "little")


def announcement(content: dict[str, Any]) -> bytes:
    body = json.dumps(content).encode() + b"\0"
    return struct.pack("<QQQQ", 32 + len(body), 0x1001, SIGNATURE, 1) + body


class GoPxLDiscovery(datagrams.Responder):
    """Answers requests as a sensor at ``host`` does; on 0.0.0.0 as one at the address that the asker sees.

    It listens on all interfaces, since a socket bound to one address hears no broadcast; one at a loopback address answers this computer
    only. The vendor's client hears its own port 3320, by broadcast or not, and not the port that asked. Both therefore get the
    answer, the first by broadcast, for several programs on one computer may have that port.

    Parameters
    ----------
    host : str
        Address of the sensor.
    port : int
        Where requests come in; 0 for any free one.
    content : Callable[[str], dict[str, Any]]
        What is announced, for the address to announce.
    """

    def __init__(self, host: str, port: int, content: Callable[[str], dict[str, Any]]) -> None:
        super().__init__("fake-gopxl-discovery", port, 64)
        self._host, self._content = socket.gethostbyname(host), content

    def respond(self, data: bytes, asker: tuple[str, int], interface: int) -> None:
        if len(data) != 24 or struct.unpack("<QQQ", data) != (24, 1, SIGNATURE):
            return
        own = is_own_address(asker[0])
        if IPv4Address(self._host).is_loopback and not own:
            return
        address = datagrams.facing(asker) if IPv4Address(self._host).is_unspecified else self._host
        data = announcement(self._content(address))
        everybody = "127.255.255.255" if IPv4Address(asker[0]).is_loopback else "255.255.255.255"
        datagrams.send(self._sock, data, (everybody, PORT), interface)
        if not own:
            datagrams.send(self._sock, data, (asker[0], PORT))
        if asker[1] != PORT:
            datagrams.send(self._sock, data, asker)
