"""The way out of the fake EKI controller, where telegrams can come to harm."""

from __future__ import annotations

import socket
import time

from mbcacq_fakes.protocols.faults import Faults

_MERGED = 3


class Outlet:
    """``send`` a telegram on a socket, or what the faults leave of it."""

    def __init__(self, faults: Faults) -> None:
        self._faults = faults
        self._held: list[bytes] = []

    def send(self, client: socket.socket, data: bytes) -> None:
        """Raises OSError where the connection ends."""
        if self._faults.get("silence") or self._faults.use("drop"):
            return
        if delay_ms := self._faults.get("delay_ms"):
            time.sleep(delay_ms * 1e-3)
        self._close(client, data)
        data = self._damage(data)
        if self._faults.get("merge"):
            self._held.append(data)
            if len(self._held) < _MERGED:
                return
            data, self._held = b"".join(self._held), []
        pieces = [data[i : i + 1] for i in range(len(data))] if self._faults.get("split") else [data]
        for piece in pieces:
            client.sendall(piece)

    def _close(self, client: socket.socket, data: bytes) -> None:
        """Raises ConnectionResetError where the connection shall end before the telegram, or inside of it."""
        if self._faults.use("close"):
            raise ConnectionResetError
        if self._faults.use("close_inside"):
            client.sendall(data[: len(data) // 2])
            raise ConnectionResetError

    def _damage(self, data: bytes) -> bytes:
        if self._faults.use("truncate"):
            data = data[: len(data) // 2]
        if self._faults.use("duplicate"):
            data += data
        if self._faults.use("malformed"):
            data = data.replace(b"=", b"= =", 1)
        if self._faults.use("no_number"):
            data = data.replace(b'A1="', b'A1="x', 1)
        if self._faults.use("garbage"):
            data = b"\n\0\0 x>y </Rob \xff" + bytes(40) + data
        return data
