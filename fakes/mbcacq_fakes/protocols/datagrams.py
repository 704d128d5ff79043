"""Datagrams with the interface by which they came: a broadcast answer leaves by the same one, on a computer without any route too."""

from __future__ import annotations

import socket
import struct
import sys
import threading
from abc import ABC, abstractmethod

_IP_PKTINFO = 8  # of Linux; the socket module does not name it
_INFO = struct.Struct("@i4s4s")  # interface, its address, destination


def open_socket(port: int) -> socket.socket:
    """A udp socket on all interfaces that may broadcast; ``port`` is shared with others. Raises OSError."""
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        if sys.platform == "linux":
            sock.setsockopt(socket.IPPROTO_IP, _IP_PKTINFO, 1)
        sock.bind(("", port))
    except OSError:
        sock.close()
        raise
    return sock


def receive(sock: socket.socket, most: int) -> tuple[bytes, tuple[str, int], int]:
    """A datagram, who sent it, and the number of the interface by which it came (0: unknown)."""
    if sys.platform != "linux":
        data, sender = sock.recvfrom(most)
        return data, sender, 0
    data, more, _, sender = sock.recvmsg(most, socket.CMSG_SPACE(_INFO.size))
    index = next((_INFO.unpack(value)[0] for level, kind, value in more if (level, kind) == (socket.IPPROTO_IP, _IP_PKTINFO)), 0)
    return data, sender, index


def send(sock: socket.socket, data: bytes, to: tuple[str, int], interface: int = 0) -> None:
    """Send, by an interface where its number is given. A network that is down takes none, which is no error of a sensor."""
    try:
        if interface and sys.platform == "linux":
            route = [(socket.IPPROTO_IP, _IP_PKTINFO, _INFO.pack(interface, bytes(4), bytes(4)))]
            sock.sendmsg([data], route, 0, to)
        else:
            sock.sendto(data, to)
    except OSError:
        return


def facing(asker: tuple[str, int]) -> str:
    """This computer's address as ``asker`` sees it; '' if there is no way to it."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(asker)
        except OSError:
            return ""
        return str(probe.getsockname()[0])


class Responder(ABC):
    """Hears a udp port in a thread until closed. most: bytes of a datagram; port: 0 for any free one. Raises OSError if it is taken."""

    def __init__(self, name: str, port: int, most: int) -> None:
        self._most, self._closing = most, threading.Event()
        self._sock = open_socket(port)
        self._sock.settimeout(0.1)
        self.port: int = self._sock.getsockname()[1]
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    @abstractmethod
    def respond(self, data: bytes, asker: tuple[str, int], interface: int) -> None:
        """To a datagram, as ``receive`` gives it."""

    def start(self) -> None:
        self._thread.start()

    def close(self) -> None:
        self._closing.set()
        if self._thread.is_alive():
            self._thread.join(2.0)
        self._sock.close()

    def _run(self) -> None:
        while not self._closing.is_set():
            try:
                data, asker, interface = receive(self._sock, self._most)
            except TimeoutError:
                continue
            except OSError:
                return
            self.respond(data, asker, interface)
