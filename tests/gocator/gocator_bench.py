"""Helpers of these tests: the recorded conversation, frames off a socket, options that reach a fake."""

from __future__ import annotations

import re
import socket
from pathlib import Path
from typing import Any, NamedTuple

from mbcacq_fakes.protocols.gocator import FakeGocator

TRACE = Path(__file__).parent / "data" / "gocator-trace.txt"


class Line(NamedTuple):
    """One line of the trace: what it says, the announced size, and the bytes (cut for long frames)."""

    direction: str
    text: str
    size: int | None
    data: bytes

    @property
    def whole(self) -> bool:
        return self.size == len(self.data)


def read_trace() -> list[Line]:
    lines = []
    for row in TRACE.read_text().splitlines():
        match = re.match(r"[\d.]+ (<-|->|=>) (.*)", row)
        if not match:
            continue
        text = match[2].removesuffix(" ...")
        hexes = re.search(r"((?:(?<=\s)|^)[0-9a-f]{2}(?: [0-9a-f]{2})+)$", text)
        size = re.search(r"size[= ](\d+)", text)
        lines.append(Line(match[1], text, int(size[1]) if size else None, bytes.fromhex(hexes[1]) if hexes else b""))
    return lines


def options(sensor: FakeGocator, **more: Any) -> dict[str, Any]:
    return {
        "address": "127.0.0.1",
        "control_port": sensor.ports.control,
        "health_port": sensor.ports.health,
        "data_port": sensor.ports.data,
        **more,
    }


def read_frame(sock: socket.socket) -> bytes:
    data = b""
    while len(data) < 4 or len(data) < int.from_bytes(data[:4], "little"):
        want = int.from_bytes(data[:4], "little") if len(data) >= 4 else 4
        part = sock.recv(want - len(data))
        if not part:
            raise EOFError(f"closed after {data!r}")
        data += part
    return data
