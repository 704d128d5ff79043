"""The control channel of the fake GoPxL sensor: frames off the socket, answers in order."""

from __future__ import annotations

import socket
import struct
import threading
import time
from collections.abc import Callable
from typing import Any

import msgpack

from mbcacq_fakes.protocols.faults import Faults
from mbcacq_fakes.protocols.gocator.channel import receive_exactly
from mbcacq_fakes.protocols.gopxl.resources import OK, RequestRefused

_REQUEST, _REPLY = struct.Struct("<IHI"), struct.Struct("<IHiI")
_TYPE, _MAX = 0xB000, 32 * 2**20
_STREAM_S = 0.5  # between two messages of a stream

Handler = Callable[[str, str, dict[str, Any], dict[str, Any]], dict[str, Any]]


class Watchers:
    """Whoever wants to hear of changes, or a stream of values. read: gives the payload of a path."""

    def __init__(self, read: Callable[[str], dict[str, Any]]) -> None:
        self._read = read
        self._lock = threading.Lock()
        self._subscribed: set[tuple[ControlClient, str]] = set()
        self._streams: dict[tuple[ControlClient, str], int] = {}
        self._numbers, self._next = 0, 0.0

    def ask(self, client: ControlClient, method: str, path: str) -> None:
        """A request that was answered: sub, unSub, stream and cancelStream count from now on."""
        key = client, path.rstrip("/")
        with self._lock:
            if method == "sub":
                self._subscribed.add(key)
            elif method.lower() == "unsub":
                self._subscribed.discard(key)
            elif method == "stream":
                self._numbers += 1
                self._streams[key] = self._numbers
                self._next = 0.0
            elif method == "cancelStream":
                self._streams.pop(key, None)

    def leave(self, client: ControlClient) -> None:
        with self._lock:
            self._subscribed = {key for key in self._subscribed if key[0] is not client}
            self._streams = {key: number for key, number in self._streams.items() if key[0] is not client}

    def tell(self, path: str, payload: dict[str, Any]) -> None:
        """Something has changed at a path."""
        with self._lock:
            listeners = [client for client, at in self._subscribed if at == path]
        for client in listeners:
            client.send(OK, {"type": "notification", "eventType": "updated", "path": path, "payload": payload})

    def stream(self) -> None:
        """Send what is streamed, if it is time."""
        if time.monotonic() < self._next:
            return
        self._next = time.monotonic() + _STREAM_S
        with self._lock:
            streams = list(self._streams.items())
        for (client, path), number in streams:
            content = {"streamId": number, "streamStatus": "active", "payload": self._read(path)}
            client.send(OK, {"type": "stream", "path": path, "status": OK, **content})


class ControlClient:
    """One connection; replies and what comes between them leave one at a time."""

    def __init__(self, sock: socket.socket, watchers: Watchers) -> None:
        self.sock, self.watchers = sock, watchers
        self._one = threading.Lock()

    def send(self, status: int, content: dict[str, Any]) -> bool:
        with self._one:
            return _send(self.sock, status, content)


def serve(client: ControlClient, handle: Handler, faults: Faults) -> None:
    """Answer requests until either side closes."""
    try:
        _serve(client, handle, faults)
    finally:
        client.watchers.leave(client)


def _serve(client: ControlClient, handle: Handler, faults: Faults) -> None:
    while (asked := _request(client.sock)) is not None:
        method, path = str(asked.get("method", "")), str(asked.get("path", ""))
        if faults.use("close_control", path.rstrip("/")):
            return
        if faults.use("silent", path.rstrip("/")):
            continue
        for number in range(int(faults.get("notifications") or 0)):
            client.send(OK, _between(number))
        status = faults.use("status", path.rstrip("/"))
        try:
            if status is not None:
                raise RequestRefused(status, "as the fault says")
            payload, status = handle(method, path, asked.get("payload") or {}, asked.get("args") or {}), OK
        except RequestRefused as error:
            payload, status = {"errors": [{"status": error.status, "description": str(error)}]}, error.status
        if not client.send(status, {"type": "response", "status": status, "path": path, "payload": payload}):
            return
        if status == OK:
            client.watchers.ask(client, method, path)


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
