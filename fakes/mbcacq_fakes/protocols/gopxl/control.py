"""The control channel of the fake GoPxL sensor: frames off the socket, answers in order."""

from __future__ import annotations

import socket
import struct
from collections.abc import Callable
from typing import Any

import msgpack

from mbcacq_fakes.protocols.faults import Faults
from mbcacq_fakes.protocols.gocator.channel import receive_exactly
from mbcacq_fakes.protocols.gopxl.resources import OK, RequestRefused

_REQUEST, _REPLY = struct.Struct("<IHI"), struct.Struct("<IHiI")
_TYPE, _MAX = 0xB000, 32 * 2**20

Handler = Callable[[str, str, dict[str, Any], dict[str, Any]], dict[str, Any]]


def serve(client: socket.socket, handle: Handler, faults: Faults) -> None:
    """Answer requests until either side closes."""
    while (asked := _request(client)) is not None:
        method, path = str(asked.get("method", "")), str(asked.get("path", ""))
        if faults.use("close_control", path.rstrip("/")):
            return
        if faults.use("silent", path.rstrip("/")):
            continue
        for number in range(int(faults.get("notifications") or 0)):
            _send(client, OK, _between(number))
        status = faults.use("status", path.rstrip("/"))
        try:
            if status is not None:
                raise RequestRefused(status, "as the fault says")
            payload, status = handle(method, path, asked.get("payload") or {}, asked.get("args") or {}), OK
        except RequestRefused as error:
            payload, status = {"errors": [{"status": error.status, "description": str(error)}]}, error.status
        if not _send(client, status, {"type": "response", "status": status, "path": path, "payload": payload}):
            return


def _between(number: int) -> dict[str, Any]:
    if number % 2:
        return {"type": "stream", "path": "/system/metrics", "status": OK, "streamId": 1, "streamStatus": "active", "payload": {}}
    return {"type": "notification", "eventType": "updated", "path": "/system", "payload": {"runState": 0}}


def _request(sock: socket.socket) -> dict[str, Any] | None:
    """None at the end, or where what comes is no request."""
    try:
        header = receive_exactly(sock, _REQUEST.size)
        if header is None:
            return None
        total, kind, count = _REQUEST.unpack(header)
        if kind != _TYPE or total != _REQUEST.size + count or total > _MAX:
            return None
        body = receive_exactly(sock, count)
        found = msgpack.unpackb(body) if body is not None else None
    except (OSError, ValueError, msgpack.UnpackException):
        return None
    return found if isinstance(found, dict) else None


def _send(sock: socket.socket, status: int, content: dict[str, Any]) -> bool:
    body: bytes = msgpack.Packer().pack(content)
    try:
        sock.sendall(_REPLY.pack(_REPLY.size + len(body), _TYPE, status, len(body)) + body)
    except OSError:
        return False
    return True
