"""A fake serial sensor, on a pseudo-terminal or on a TCP port as behind a serial server."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from mbcacq_fakes.protocols.bus.serial_line import SerialLine


class FakeSerialSensor(SerialLine):
    """Says a line again and again; answers what ``answers`` knows. ``silent``: says nothing unasked. settings: of SerialLine."""

    def __init__(self, line: Callable[[], str], period_s: float = 0.02, answers: dict[str, str] | None = None, **settings: Any) -> None:
        super().__init__((answers or {}).get, lambda: None if self.silent else line(), period_s=period_s, **settings)

    @property
    def _muted(self) -> bool:
        return False
