"""Faults that a running fake device can be given."""

from __future__ import annotations

import threading
from collections.abc import Iterable, Mapping
from typing import Any


def refuse_unknown(faults: Iterable[str], known: Mapping[str, str]) -> None:
    """Raises ValueError for faults that there are none of."""
    if unknown := sorted(set(faults) - set(known)):
        raise ValueError(f"unknown faults {', '.join(unknown)}; known are {', '.join(known)}")


class Faults:
    """Settable from any thread while the device runs. known: name of each fault, and what it does; ``inject`` sets one that does it to
    "that many" for so many uses.

    ``set("stall")`` stays until ``clear("stall")``; ``set("stall", times=1)`` wears off after one use.
    """

    def __init__(self, known: Mapping[str, str]) -> None:
        self._known, self._lock = known, threading.Lock()
        self._active: dict[str, tuple[Any, int | None]] = {}

    def set(self, fault: str, value: Any = True, times: int | None = None) -> None:
        """Raises ValueError for a fault that there is none of."""
        if fault not in self._known:
            raise ValueError(f"there is no fault '{fault}' (known: {', '.join(self._known)})")
        with self._lock:
            self._active[fault] = (value, times)

    def inject(self, values: Mapping[str, float]) -> None:
        """Set each to its number; 0 takes it back. Raises ValueError for a fault that there is none of."""
        for fault, value in values.items():
            if not value:
                self.clear(fault)
            elif self._known.get(fault, "").startswith("that many"):
                self.set(fault, times=int(value))
            else:
                self.set(fault, value)

    def clear(self, fault: str | None = None) -> None:
        """One fault, or all."""
        with self._lock:
            for name in [fault] if fault else list(self._active):
                self._active.pop(name, None)

    def get(self, fault: str) -> Any:
        """The value while the fault is active, else None. Does not wear it off."""
        with self._lock:
            return self._active.get(fault, (None, None))[0]

    def use(self, fault: str, of: Any = None) -> Any:
        """As ``get``, and count it down. of: a command or a path; then only if the fault concerns that one."""
        with self._lock:
            value, times = self._active.get(fault, (None, None))
            if value is None or (of is not None and of not in value):
                return None
            if times is not None:
                self._active[fault] = (value, times - 1)
                if times <= 1:
                    del self._active[fault]
            return value[of] if of is not None and isinstance(value, dict) else value
