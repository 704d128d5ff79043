"""What is the same in every driver: it connects on entry and closes on exit."""

from __future__ import annotations

from types import TracebackType
from typing import Self


class ContextDevice:
    """Base of a driver that has ``connect`` and ``close``: the context manager of both. ``close`` is called whatever the block raised."""

    def connect(self) -> object:
        raise NotImplementedError

    def close(self) -> None:
        raise NotImplementedError

    def __enter__(self) -> Self:
        self.connect()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()
