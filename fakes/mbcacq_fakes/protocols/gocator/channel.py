"""One control connection of the fake: frames in, exactly one reply for each, in order."""

from __future__ import annotations

import logging
import socket
import struct

from mbcacq_fakes.protocols.gocator.commands import HANDLERS, STREAMED, WITHOUT_LOGIN
from mbcacq_fakes.protocols.gocator.replies import BAD_PARAMETER, INVALID_STATE, NOT_LOGGED_IN, OK, UNKNOWN_COMMAND, CommandRefused
from mbcacq_fakes.protocols.gocator.state import SensorState

MAX_REQUEST = 64 * 2**20
_CHUNK, _PIECE = 0x5000, 64 * 1024
_PROBE_ID = 0
_log = logging.getLogger("mbcacq.fakes.gocator")


def converse(state: SensorState, sock: socket.socket) -> None:
    """Answer requests until the client closes, sends nonsense, or the sensor stops. Never raises. A new client is not logged in."""
    state.settings["login"] = 0
    try:
        while (request := _receive(sock)) is not None:
            identifier, payload = request
            if state.faults.use("close_control", identifier):
                return
            if state.faults.use("silent", identifier):
                continue
            sock.sendall(reply_to(state, identifier, payload))
    except OSError:
        pass


def reply_to(state: SensorState, identifier: int, payload: bytes) -> bytes:
    """All bytes that answer one request."""
    if identifier == _PROBE_ID and state.generation < 5:
        return struct.pack("<IIQqQQ", 40, 0, 0x1100, OK, *(state.faults.get("protocol_version") or state.protocol))
    answered = identifier ^ 1 if state.faults.use("wrong_reply", identifier) else identifier
    status = state.faults.use("status", identifier)
    if status is not None:
        return _frame(answered, status)
    try:
        return _executed(state, identifier, answered, payload)
    except CommandRefused as refused:
        status = refused.status
    except struct.error:
        status = BAD_PARAMETER
    except Exception:
        _log.exception("command 0x%04X", identifier)
        status = INVALID_STATE
    return _frame(answered, status)


def _executed(state: SensorState, identifier: int, answered: int, payload: bytes) -> bytes:
    """The reply of the command's handler, under the number ``answered``. Raises what the handler raises."""
    if state.options.password and not state.settings["login"] and identifier not in WITHOUT_LOGIN:
        raise CommandRefused(NOT_LOGGED_IN)
    if identifier in STREAMED:
        return _streamed(identifier, STREAMED[identifier](state, payload))
    handler = HANDLERS.get(identifier)
    return _frame(answered, UNKNOWN_COMMAND) if handler is None else _frame(answered, OK, handler(state, payload))


def _frame(identifier: int, status: int, payload: bytes = b"") -> bytes:
    return struct.pack("<IHi", 10 + len(payload), identifier, status) + payload


def _streamed(identifier: int, data: bytes) -> bytes:
    frames = [_frame(identifier, OK, struct.pack("<II", len(data), 0))]
    for start in range(0, len(data) + _PIECE, _PIECE):  # the last piece is empty and says so
        piece = data[start : start + _PIECE]
        frames.append(_frame(_CHUNK, OK, struct.pack("<III", len(data), min(start + _PIECE, len(data)), len(piece)) + piece))
    return b"".join(frames)


def _receive(sock: socket.socket) -> tuple[int, bytes] | None:
    header = receive_exactly(sock, 6)
    if header is None:
        return None
    length, identifier = struct.unpack("<IH", header)
    if not 6 <= length <= MAX_REQUEST:
        return None
    payload = receive_exactly(sock, length - 6)
    return None if payload is None else (identifier, payload)


def receive_exactly(sock: socket.socket, size: int) -> bytes | None:
    """None if the other side closes before."""
    data = bytearray()
    while len(data) < size:
        part = sock.recv(min(size - len(data), 2**20))
        if not part:
            return None
        data += part
    return bytes(data)
