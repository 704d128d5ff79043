"""The control channel of a GoPxL sensor: requests on resource paths, answered in order, with notifications in between."""

from __future__ import annotations

import socket
from functools import partial
from typing import Any

from mbcacq.devices import ProtocolError
from mbcacq_gocator import wire
from mbcacq_gocator.gopxl import frames
from mbcacq_gocator.request_connection import RequestConnection
from mbcacq_gocator.status import OK, SensorRefused, meaning

REPLY_S, STATE_S, JOB_S = 5.0, 15.0, 20.0  # limits of the vendor's own client: resources, start and stop, jobs
NOT_FOUND = -999
MAX_BETWEEN = 10_000  # notifications before a reply


class GoPxLControl(RequestConnection):
    """Requests carry no number: a reply belongs to the oldest request. So there is one request at a time."""

    def open(self) -> None:
        """Raises ConnectError."""
        self._sock = wire.connect(self._address, self._port, "GoPxL control", self._connect_timeout_s)

    def read(self, path: str, limit_s: float = REPLY_S, **args: Any) -> dict[str, Any]:
        return self.ask("read", path, None, args, limit_s)

    def read_if_there(self, path: str, **args: Any) -> dict[str, Any]:
        """Like ``read``, but {} if this firmware has no such resource."""
        try:
            return self.read(path, **args)
        except SensorRefused as error:
            if error.status != NOT_FOUND:
                raise
            return {}

    def update(self, path: str, payload: dict[str, Any]) -> dict[str, Any]:
        return self.ask("update", path, payload)

    def call(self, path: str, payload: dict[str, Any] | None = None, limit_s: float = REPLY_S) -> dict[str, Any]:
        return self.ask("call", path, payload, None, limit_s)

    def ask(
        self, method: str, path: str, payload: dict[str, Any] | None = None, args: dict[str, Any] | None = None, limit_s: float = REPLY_S
    ) -> dict[str, Any]:
        """The payload of the reply. Raises SensorRefused, ConnectError, DeviceTimeout, ProtocolError, Aborted."""
        data = frames.request(method, path, payload, args)
        return self._exchange(path, data, limit_s, partial(self._answer, path))

    def _answer(self, path: str, sock: socket.socket, deadline: float) -> dict[str, Any]:
        for _ in range(MAX_BETWEEN):
            header = bytearray(frames.REPLY.size)
            wire.receive_exactly(sock, memoryview(header), "reply", deadline, self._cancelled)
            status, count, behind = frames.reply_size(bytes(header))
            body = bytearray(count + behind)
            wire.receive_exactly(sock, memoryview(body), "reply", deadline, self._cancelled, started=True)
            found = frames.content(bytes(body[:count]))
            if found["type"] not in (frames.NOTIFICATION, frames.STREAM):
                return self._accepted(found, status, path)
        raise ProtocolError(f"GoPxL sends notifications without end instead of an answer to {path}")

    @staticmethod
    def _accepted(found: dict[str, Any], outer: int, path: str) -> dict[str, Any]:
        answered = found.get("path", path)
        if isinstance(answered, str) and answered.rstrip("/") != path.rstrip("/"):
            raise ProtocolError(f"GoPxL answered {answered} when it was asked for {path}; the stream is out of step")
        inner, payload = found.get("status", OK), found.get("payload")
        payload = {} if payload is None else payload
        status = outer if outer != OK else inner
        if not isinstance(status, int) or not isinstance(payload, dict):
            raise ProtocolError(f"the answer of GoPxL to {path} has no status or no payload")
        if status != OK:
            raise SensorRefused(f"GoPxL refuses {path}: {meaning(status)}{_described(payload)}", status)
        return payload


def _described(payload: dict[str, Any]) -> str:
    errors = payload.get("errors")
    first = errors[0] if isinstance(errors, list) and errors else None
    text = first.get("description") if isinstance(first, dict) else None
    return f", '{text}'" if isinstance(text, str) and text else ""
