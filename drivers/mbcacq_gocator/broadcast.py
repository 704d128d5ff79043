"""Sending a datagram to everybody on every network of this computer."""

from __future__ import annotations

import socket
import struct
import sys

from mbcacq.devices import ConnectError

BROADCAST = "255.255.255.255"
_IP_PKTINFO = 8  # of Linux; the socket module does not name it


def send(sock: socket.socket, data: bytes, address: str, port: int) -> None:
    """Send; to the limited broadcast address once by each interface, since it goes out by one only.

    Raises ConnectError where nothing can be sent.
    """
    sent, reason = False, ""
    for route in _routes() if address == BROADCAST else [[]]:
        try:
            sock.sendmsg([data], route, 0, (address, port))
            sent = True
        except OSError as error:
            reason = error.strerror or str(error)
    if not sent:
        raise ConnectError(f"no discovery request can be sent to {address}:{port} ({reason.lower()}); check this computer's network")


def _routes() -> list[list[tuple[int, int, bytes]]]:
    """Ancillary data that choose the interface, where the system has it."""
    if sys.platform != "linux":
        return [[]]
    return [[(socket.IPPROTO_IP, _IP_PKTINFO, struct.pack("@i4s4s", index, bytes(4), bytes(4)))] for index, _ in socket.if_nameindex()]
