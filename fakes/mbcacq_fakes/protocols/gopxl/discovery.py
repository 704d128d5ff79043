"""The fake sensor's answer to discovery: an announcement to who asked, as JSON behind a header."""

from __future__ import annotations

import json
import socket
import struct
import threading
from collections.abc import Callable
from typing import Any

SIGNATURE = int.from_bytes(b"LMIGOPXL", "little")
_POLL_S = 0.1


def announcement(content: dict[str, Any]) -> bytes:
    body = json.dumps(content).encode() + b"\0"
    return struct.pack("<QQQQ", 32 + len(body), 0x1001, SIGNATURE, 1) + body


class GoPxLDiscovery:
    """Answers requests on a udp port of ``host`` until closed. reply_port: where to; 0: to the port that asked."""

    def __init__(self, host: str, port: int, reply_port: int, content: Callable[[], dict[str, Any]]) -> None:
        self._content, self._reply_port = content, reply_port
        self._closing = threading.Event()
        self._sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._sock.bind((host, port))
        self._sock.settimeout(_POLL_S)
        self.port: int = self._sock.getsockname()[1]
        self._thread = threading.Thread(target=self._run, name="fake-gopxl-discovery", daemon=True)

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
                data, (address, port) = self._sock.recvfrom(64)
            except TimeoutError:
                continue
            except OSError:
                return
            if len(data) == 24 and struct.unpack("<QQQ", data) == (24, 1, SIGNATURE):
                self._sock.sendto(announcement(self._content()), (address, self._reply_port or port))
