"""What is the same in every driver: it connects on entry, closes on exit, and may have facts that are watched."""

from __future__ import annotations

from types import TracebackType
from typing import Self

from mbcacq.devices.protocols import Fact


class ContextDevice:
    """Base of a driver that has ``connect`` and ``close``: the context manager of both. ``close`` is called whatever the block raised."""

    def connect(self) -> object:
        raise NotImplementedError

    def close(self) -> None:
        raise NotImplementedError

    def facts(self) -> tuple[Fact, ...]:
        """What results depend on, as far as the device reports it (``Fact``): none before it is connected. A driver refreshes it as often
        as its protocol gives it; the call itself asks nobody, comes from any thread, and never raises."""
        return ()

    def __enter__(self) -> Self:
        self.connect()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()
