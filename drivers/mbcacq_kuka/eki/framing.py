"""Cuts a TCP byte stream into EKI telegrams. A telegram ends with the closing tag of its root; nothing else marks its end."""

from __future__ import annotations

import re

MAX_TELEGRAM = 65536


class FramingError(ValueError):
    """The stream cannot be read any more."""


class Cutter:
    """``feed`` bytes as they come, get whole telegrams with this root. Bytes between telegrams are thrown away."""

    def __init__(self, root: str) -> None:
        name = re.escape(root.encode())
        self._open = re.compile(rb"<" + name + rb"(?=[\s/>])")
        self._empty = re.compile(rb"<" + name + rb"(?:\s[^<>]*)?/>")
        self._close = re.compile(rb"</" + name + rb"\s*>")
        self._keep = len(root) + 1
        self._buffer = b""
        self._searched = 0

    def feed(self, data: bytes) -> list[bytes]:
        """Raises FramingError for a telegram beyond 64 KiB or one that declares a document type."""
        self._buffer += data
        telegrams = []
        while (telegram := self._next()) is not None:
            telegrams.append(telegram)
        return telegrams

    def _next(self) -> bytes | None:
        start = self._open.search(self._buffer)
        if start is None:
            self._buffer = self._buffer[-self._keep :]  # perhaps the beginning of a tag
            return None
        if start.start():
            self._buffer, self._searched = self._buffer[start.start() :], 0
        end = self._empty.match(self._buffer) or self._close.search(self._buffer, self._searched)
        if end is None:
            if len(self._buffer) > MAX_TELEGRAM:
                raise FramingError(f"a telegram is longer than {MAX_TELEGRAM} bytes")
            self._searched = max(0, len(self._buffer) - 128)
            return None
        telegram, self._buffer, self._searched = self._buffer[: end.end()], self._buffer[end.end() :], 0
        if len(telegram) > MAX_TELEGRAM:
            raise FramingError(f"a telegram is longer than {MAX_TELEGRAM} bytes")
        if b"<!" in telegram or b"<?" in telegram:
            raise FramingError("a telegram contains a declaration")
        return telegram
