"""The connection under a control channel, of either generation."""

from __future__ import annotations

import socket

from mbcacq.devices import hang_up, has_ended


class RequestConnection:
    """One TCP connection, which is closed after a reply that did not come or made no sense: a late one could be taken for the next."""

    def __init__(self, address: str, port: int, connect_timeout_s: float, reply_limit_s: float | None, grace_s: float) -> None:
        self._address, self._port = address, port
        self._connect_timeout_s, self._reply_limit_s, self._grace_s = connect_timeout_s, reply_limit_s, grace_s
        self._sock: socket.socket | None = None

    @property
    def is_open(self) -> bool:
        return self._sock is not None

    @property
    def has_ended(self) -> bool:
        """Whether it is closed, by us or by the sensor."""
        return has_ended(self._sock)

    def close(self) -> None:
        """Idempotent, from any thread; a request under way ends at once."""
        sock, self._sock = self._sock, None
        hang_up(sock)
