"""The way out of the fake EKI controller, where telegrams can come to harm."""

from __future__ import annotations

import socket
import time

from mbcacq_fakes.protocols.krc.eki_settings import COUNTED, FAULTS

_MERGED = 3


class Outlet:
    """``send`` a telegram on a socket, or what the faults leave of it. ``active``: fault -> value."""

    def __init__(self, faults: dict[str, float]) -> None:
        self.active: dict[str, float] = dict.fromkeys(FAULTS, 0.0)
        self.inject(faults)
        self._held: list[bytes] = []

    def inject(self, faults: dict[str, float]) -> None:
        self.active.update(faults)

    def use(self, fault: str) -> bool:
        """Is it active? A counted one is used up by one."""
        if not self.active[fault]:
            return False
        if fault in COUNTED:
            self.active[fault] -= 1
        return True

    def send(self, client: socket.socket, data: bytes) -> None:
        """Raises OSError where the connection ends."""
        if self.active["silence"] or self.use("drop"):
            return
        if self.active["delay_ms"]:
            time.sleep(self.active["delay_ms"] * 1e-3)
        self._close(client, data)
        data = self._damage(data)
        if self.active["merge"]:
            self._held.append(data)
            if len(self._held) < _MERGED:
                return
            data, self._held = b"".join(self._held), []
        pieces = [data[i : i + 1] for i in range(len(data))] if self.active["split"] else [data]
        for piece in pieces:
            client.sendall(piece)

    def _close(self, client: socket.socket, data: bytes) -> None:
        """Raises ConnectionResetError where the connection shall end before the telegram, or inside of it."""
        if self.use("close"):
            raise ConnectionResetError
        if self.use("close_inside"):
            client.sendall(data[: len(data) // 2])
            raise ConnectionResetError

    def _damage(self, data: bytes) -> bytes:
        if self.use("truncate"):
            data = data[: len(data) // 2]
        if self.use("duplicate"):
            data += data
        if self.use("malformed"):
            data = data.replace(b"=", b"= =", 1)
        if self.use("no_number"):
            data = data.replace(b'A1="', b'A1="x', 1)
        if self.use("garbage"):
            data = b"\n\0\0 x>y </Rob \xff" + bytes(40) + data
        return data
