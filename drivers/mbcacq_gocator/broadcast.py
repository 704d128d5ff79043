"""Asking everybody on every network of this computer by a datagram."""

from __future__ import annotations

import socket
import struct
import sys
import time
from collections.abc import Callable, Sequence
from typing import TypeVar

from mbcacq.devices import ConnectError, ProtocolError

BROADCAST = "255.255.255.255"
_IP_PKTINFO = 8  # of Linux; the socket module does not name it
_Answer = TypeVar("_Answer")
_MOST = 1000  # answers
_LONGEST = 65536


def ask(
    requests: Sequence[bytes], address: str, port: int, wait_s: float, parse: Callable[[bytes, str], _Answer], own_port: int = 0
) -> list[_Answer]:
    """What ``parse(datagram, sender)`` makes of the datagrams that come within ``wait_s``, without those for which it raises ProtocolError.

    own_port: the requests are sent from it, or from any port if another program has it. Raises ConnectError if nothing can be sent.
    """
    answers: list[_Answer] = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            sock.bind(("", own_port))
        except OSError:
            sock.bind(("", 0))
        for request in requests:
            _send(sock, request, address, port)
        deadline = time.monotonic() + wait_s
        while (left := deadline - time.monotonic()) > 0 and len(answers) < _MOST:
            sock.settimeout(left)
            try:
                data, sender = sock.recvfrom(_LONGEST)
                answers.append(parse(data, sender[0]))
            except (TimeoutError, ProtocolError):
                continue
    return answers


def _send(sock: socket.socket, data: bytes, address: str, port: int) -> None:
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
